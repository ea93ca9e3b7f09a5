"""Measure what each effect of a scene costs in time and memory."""
