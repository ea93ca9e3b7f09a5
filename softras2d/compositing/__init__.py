"""This stage combines the colours of all triangles in a pixel into one."""
