"""Poses of the frames of a flight (S4)."""
