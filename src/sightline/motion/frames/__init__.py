"""Attitudes of the frames of a matrix instrument."""
