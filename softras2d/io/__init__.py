"""This stage reads and writes images, animations and SVG drawings."""
