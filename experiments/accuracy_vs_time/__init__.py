"""Measure error against time for every way to draw a scene and to differentiate it."""
