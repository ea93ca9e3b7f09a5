"""This stage collects the declarations that apply to an element, and computes its style."""
