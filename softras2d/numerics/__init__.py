"""These modules help with numbers, arrays, devices and programs. Triangles do not occur in them."""
