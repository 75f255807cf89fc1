"""``sightline version``: what is installed."""

from __future__ import annotations

from sightline.version import VERSION


def version() -> None:
    """Print the version of Sightline."""
    print(VERSION)
