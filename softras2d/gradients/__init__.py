"""This stage finds how the image of hard coverage changes with vertex positions and depth.

The boundary term is the part of this change that comes from edges, and from lines where triangles
interpenetrate, as they move over the samples. The interior term comes from the colours inside
triangles, which move with the vertices.

`boundary_term` adds up all crossings. In an opaque scene, `color_jumps` compares the triangles that
are visible on both sides of the edge. In a translucent scene, `edge_gains` visits the layers in
front of the edge's triangle and those behind it.

Terms in this folder: a *line* is a row or a column of samples, and a *crossing* is a point where an
edge crosses a line. A *run* is up to eight successive crossings of one edge. The *inside* of a
crossing is the side on which the edge's triangle lies. A *layer* of a sample is a triangle that
covers it and passes the depth test there. A *lane* is one index of arrays of a fixed length; all
lanes are computed at once, whether they are used or not.
"""
