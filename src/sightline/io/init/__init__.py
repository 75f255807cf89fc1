"""First files of one's own: templates of every TOML file, and acquisitions of bands without metadata."""
