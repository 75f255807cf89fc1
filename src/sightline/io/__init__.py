"""Files to types and back, one file per format."""
