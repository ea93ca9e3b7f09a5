"""Measure how time and memory grow with a scene, and the cost of triangle traversal."""
