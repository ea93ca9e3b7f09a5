"""This stage combines the colours of all triangles that cover a pixel into the pixel's colour."""
