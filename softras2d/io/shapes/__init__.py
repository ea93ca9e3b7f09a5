"""This stage triangulates the polygons and strokes of a drawing, and draws lines as pixels."""
