"""Materials that are hard on purpose: what a scene can hold at its worst."""
