"""Gradient and memory of images whose colours are computed by the caller."""
