"""This stage chooses on the host the capacities of a render, and simplifies and pads scenes."""
