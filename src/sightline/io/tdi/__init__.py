"""TDI.toml."""
