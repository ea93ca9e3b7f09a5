"""This stage turns the polygons, strokes and lines of a drawing into triangles and pixels."""
