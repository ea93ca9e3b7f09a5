"""Code that the experiments share: scenes, a reference image, timing, and the record of a run."""
