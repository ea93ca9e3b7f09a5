"""This stage finds how the image of hard coverage changes with vertex positions and depth.

The boundary term is the part of this change that comes from edges, and from lines where triangles
interpenetrate, as they move over the samples. The interior term comes from the colours inside
triangles, which move with the vertices (`interior_term`).

`boundary_term` adds up all crossings: `edge_motion` multiplies the speed of each by the jump of
colour there. In an opaque scene, `color_jumps` compares the triangles that are visible on both
sides of the edge. In a translucent scene, `edge_gains` computes the colour that the edge's triangle
adds between the layers in front of it and those behind it. It reads from `layer_masks` which layers
the samples have, and visits them tile by tile (`part_groups`, `layer_visits`).

Terms in this folder:

- *Line*: a row or a column of samples of the canvas.
- *Crossing*: a point where an edge crosses a line. The *edge's triangle* is the triangle to which
  the edge belongs.
- *Sample inside*, *sample outside*: the two neighbouring samples of the line between which the edge
  passes. The sample inside is on the side on which the edge's triangle lies.
- *Side k* of a triangle: its edge from corner k to the next, where corners 1 and 2 are exchanged in
  triangles of negative area. Edges are numbered 3 triangle + side.
- *Run*: up to eight successive lines that one edge crosses (`runs.Runs`). Arrays `[lines,
  runs]` have one entry for each line of each run.
- *Part* of a run: those of its samples outside that lie in one tile (`run_parts`). Arrays `[lines,
  parts]` have one entry for each line of each part.
- *Layer* of a sample: a triangle that covers the sample and passes the depth test there.
- *Lane*: one index of arrays of a fixed length. All lanes are computed at once, whether they are
  used or not.

Slots and chunks are defined in `binning.lists`, coverage words in `coverage.sampled`, and edge
values in `geometry.fixed_point`.
"""
