"""This stage reads scenes from SVG files and writes scenes as SVG files.

Its folders are in this order. Each imports from those before it, never from those after it:

- `xml`: parses a document into a tree of elements, and collects notices of what is not drawn.
- `values`: parses the text of attributes: numbers, units, colours, path data, transforms.
- `css`: collects the declarations that apply to each element, and computes its style.
- `canvas`: collects painted shapes in draw order, composites groups, and triangulates all shapes.
- `elements`: computes where elements lie: paths, transforms, viewports, bounds and clip paths.
- `painting`: fills and strokes paths, and divides gradients into pieces that are affine.
- `reading`: draws a document in one of two dialects, and returns a scene. It has `read_svg`.
- `writing`: writes scenes and films, with additions for browsers. It has `write_svg`.

`elements.element_kinds` says how to add an element, and `css.property_values` how to add a
property.

These terms have the same meaning in all folders:

- *User units* are the units of an element's coordinates, *px* are CSS pixels of the document, and
  *pixels* are those of the canvas.
- A fault is *noted* or *reported* if a notice about it is added to the warning about the document.
  If the reader is strict, the notice raises an error instead.
- The *course* is a rasterizer course whose subset of SVG is the dialect `"course"`.
- The *draw order* of shapes is back to front, and indices in draw order begin with 0.
- The *budget* limits the work that a document may cause (`io/budget.py`). Work is *charged* to it
  before it is done, or in bounded blocks, which raises `BudgetError` beyond a limit.
"""
