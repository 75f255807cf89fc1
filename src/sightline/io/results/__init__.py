"""Folders of results: written, and read again."""
