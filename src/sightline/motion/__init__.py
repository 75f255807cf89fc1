"""Matches and cameras to motion: prediction, differences, observability, estimators."""
