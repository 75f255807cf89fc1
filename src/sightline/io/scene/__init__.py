"""SCENE.toml."""
