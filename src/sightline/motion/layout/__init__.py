"""Where detectors should stand."""
