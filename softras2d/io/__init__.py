"""This stage reads and writes images, animations, SVG drawings and compact scene files."""
