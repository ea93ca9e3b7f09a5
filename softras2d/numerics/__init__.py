"""These modules hold arithmetic and array helpers that know nothing of triangles."""
