"""Rendering runs the stages of the pipeline in order: from a scene and a plan to an image."""
