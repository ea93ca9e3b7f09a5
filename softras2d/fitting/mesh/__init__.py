"""The fit family `mesh`: triangles that share vertices and tile the canvas without overlap.

To *collapse* a vertex is to move it onto a neighbour, which removes it. An *exchange* collapses
vertices whose removal raises the error least, and inserts as many where the error is large.
"""
