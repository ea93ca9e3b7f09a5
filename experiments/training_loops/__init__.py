"""Measure whether one compiled program lasts a training loop, and what a batch costs."""
