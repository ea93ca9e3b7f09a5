"""This stage finds which triangles touch which tile of the canvas, and lists them."""
