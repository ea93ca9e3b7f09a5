"""This stage finds how the image of hard coverage changes with vertex positions and depth.

The boundary term is due to edges, and to lines where triangles interpenetrate, that move over the
samples. The interior term is due to colours that move with the vertices.

Words of its files: a *line* is a row or a column of samples, and a *crossing* is a point where an
edge crosses a line. The *inside* of a crossing is the side of the edge's triangle. A *lane* is one
index of arrays of a fixed length, all of which are computed at once, used or not.
"""
