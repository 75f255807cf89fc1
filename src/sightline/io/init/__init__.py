"""First files of one's own: templates of every TOML file, acquisitions of products and of bare bands."""
