"""How time and memory grow with a scene, and what it costs to find the samples it covers."""
