"""Where things are and where they look: trajectories, detectors, surfaces, cameras. No image content."""
