"""This stage writes scenes and films as SVG files, with additional elements for browsers."""
