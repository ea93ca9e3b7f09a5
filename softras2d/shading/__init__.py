"""This stage finds the colours of triangles at the samples or pixels that show them."""
