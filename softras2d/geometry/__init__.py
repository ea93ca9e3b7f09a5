"""This stage puts triangles on the canvas: snapped to a grid, and bounded by edge functions."""
