"""The systems, one file each: what a user calls."""
