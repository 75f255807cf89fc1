"""Truth: scenes, motions and rendered images. Never imported by estimation."""
