"""This stage finds how the image of hard coverage changes with vertex positions and depth.

The boundary term is due to edges, and to lines where triangles interpenetrate, that move over the
samples. The interior term is due to colours that move with the vertices.
"""
