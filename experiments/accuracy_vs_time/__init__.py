"""Error against time for every way of drawing one scene, and of differentiating it."""
