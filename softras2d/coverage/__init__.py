"""This stage finds which samples, or how much of each pixel, every triangle covers."""
