"""Estimates against truth: errors, NEES, coverage."""
