"""This family of fits has triangles that share vertices and tile the canvas without gaps."""
