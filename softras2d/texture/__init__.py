"""This stage builds mip pyramids, chooses levels of detail and reads filtered texels."""
