"""The fit family `mesh`: triangles that share vertices and tile the canvas without overlap.

An *exchange* collapses vertices that matter little, and inserts as many where the error is large.
"""
