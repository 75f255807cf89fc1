"""INSTRUMENT.toml."""
