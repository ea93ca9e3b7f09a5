"""What the experiments share: scenes, a reference image, timing, the record of a run."""
