"""One external file format each."""
