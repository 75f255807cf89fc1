"""How images are reached and resampled: the window protocol and the separable kernel."""
