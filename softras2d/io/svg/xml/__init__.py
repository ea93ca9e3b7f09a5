"""This stage parses a document into a tree of elements, and collects notices about it."""
