"""This stage reads scenes from SVG files, and writes them as such."""
