"""Measure what exceeds one device: a huge canvas in tiles, and a million triangles."""
