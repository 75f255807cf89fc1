"""A spinning camera with filter strips."""
