"""The fit family `layers`: independent triangles, opaque or translucent, drawn over each other."""
