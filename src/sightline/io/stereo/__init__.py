"""STEREO.toml."""
