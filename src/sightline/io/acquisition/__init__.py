"""ACQUISITION.toml: a strip or frames and their cameras."""
