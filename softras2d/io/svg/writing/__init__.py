"""This stage writes scenes and films as SVG files, with additions for browsers."""
