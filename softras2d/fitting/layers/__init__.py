"""The fit family `layers`: independent triangles, opaque or translucent, drawn over each other.

A *new* triangle is one that the fit adds where the error is large. An *exchange* removes triangles
and adds as many new ones.
"""
