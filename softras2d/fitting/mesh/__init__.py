"""The fit family `mesh`: triangles that share vertices and tile the canvas without gaps."""
