"""This stage reads and writes images, SVG drawings and compact scenes, and writes animations."""
