"""This stage counts on the host what room a render needs, and simplifies and pads scenes."""
