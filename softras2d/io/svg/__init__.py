"""This stage reads scenes from SVG files and writes scenes as SVG files.

Its folders are in this order. Each imports from those before it, never from those after it:

- `xml`: parses a document into a tree of elements, and collects notices of what is not drawn.
- `values`: parses the text of attributes: numbers, units, colours, path data, transforms.
- `css`: finds the declarations of each element, and computes its style from them.
- `canvas`: collects painted shapes in draw order, composites groups, and triangulates all shapes.
- `elements`: computes where elements lie: paths, transforms, viewports, bounds and clip paths.
- `painting`: fills and strokes paths, and divides gradients into pieces that are affine.
- `reading`: draws a document in one of two dialects, and returns a scene. It has `read_svg`.
- `writing`: writes scenes and films, with additions for browsers. It has `write_svg`.
"""
