"""This stage interprets SVG documents in one of two dialects, and makes scenes of them."""
