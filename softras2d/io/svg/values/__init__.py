"""This stage parses the text of attributes: numbers, units, colours, path data, transforms."""
