"""This family of fits has independent translucent triangles, one layered over the other."""
