"""This stage finds how the image of hard coverage changes when vertices move."""
