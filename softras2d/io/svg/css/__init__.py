"""This stage finds the declarations of each element, and computes its style from them."""
