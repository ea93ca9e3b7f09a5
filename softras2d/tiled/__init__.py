"""Canvases too large for memory or for the fixed-point grid, drawn window by window.

A *window* is a square of the canvas that one call of the renderer draws; its side is the argument
`tile` of `plan_tiles`. Windows at the right and lower border of the canvas may be smaller. The
renderer divides each window into its own tiles, 2 to 32 pixels along a side, as in `binning`.
"""
