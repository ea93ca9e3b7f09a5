"""This stage joins all others: it makes an image from a scene and its plan."""
