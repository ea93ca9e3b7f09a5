"""Canvases larger than memory or than the exact grid, drawn tile by tile."""
