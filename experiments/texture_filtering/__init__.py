"""Measure the cost and the error of each texture filter."""
