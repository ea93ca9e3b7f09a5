"""This stage measures how much two images differ."""
