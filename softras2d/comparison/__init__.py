"""This stage measures how much two images differ; one of them may be what a browser shows."""
