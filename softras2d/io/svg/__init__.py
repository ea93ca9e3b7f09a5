"""This stage reads scenes from SVG files and writes scenes as SVG files."""
