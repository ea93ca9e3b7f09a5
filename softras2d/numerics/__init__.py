"""These modules help with numbers, arrays, devices and compilation, and know no triangles."""
