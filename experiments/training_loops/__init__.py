"""Measure whether one program serves an entire training loop, and how long a batch takes."""
