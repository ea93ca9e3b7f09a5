"""This stage chooses array sizes of a render on the host, and simplifies and pads scenes."""
