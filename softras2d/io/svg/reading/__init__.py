"""This stage interprets an SVG document in one of two dialects, and makes a scene of it."""
