"""This stage draws a document in one of two dialects, and returns a scene."""
