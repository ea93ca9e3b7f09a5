"""This stage fits triangles to a picture: it moves and colours them until they look like it."""
