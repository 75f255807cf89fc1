"""Matched windows as measurements of attitude."""
