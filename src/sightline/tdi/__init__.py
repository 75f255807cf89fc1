"""How many TDI stages, and how long each integrates, for every column and signal (S3)."""
