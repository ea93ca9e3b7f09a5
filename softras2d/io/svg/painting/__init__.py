"""This stage fills and strokes paths, and divides gradients into pieces that are affine."""
