"""SEQUENCE.toml."""
