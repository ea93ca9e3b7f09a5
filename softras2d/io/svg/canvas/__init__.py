"""This stage collects painted shapes in draw order, composites groups, and triangulates shapes."""
