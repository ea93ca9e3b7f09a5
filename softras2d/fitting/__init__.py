"""This stage fits triangles to a picture: it moves and colours them until they look like it.

Words that all files of this folder use:

- The *target* is the picture. The *size of the fit* is the size in pixels at which the solver draws
  the triangles; it is often smaller than the target (see `frame.Frame`). *Pixels of the fit* and
  *pixels of the target* are units of length.
- The *unknowns* are the arrays that the solver changes: positions, colours, and perhaps opacities.
  The *data* are all other arrays that the loss depends on, such as the target.
- A *chunk* is a number of solver steps that run as one compiled program. Between two chunks, Python
  code on the host may change the unknowns, the data and the number of triangles.
- The *share* of a fit is a number in 0..1 that says how much of the fit is done, by its limit of
  steps or seconds (see `budget.Budget.share`).
- *Spare triangles* fill up arrays whose length does not change. They are not visible. The other
  triangles are *in use*.
- A *family* is a kind of fit: `"layers"`, free triangles that are drawn over each other, or
  `"mesh"`, triangles that share vertices and tile the canvas (see `family`).
- An *exchange* removes the triangles or vertices that matter least, and adds as many where the
  error is large.
"""
