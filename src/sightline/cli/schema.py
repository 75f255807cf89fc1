"""``sightline schema``: the JSON Schema of a TOML file that a command reads, or of what they write."""

from __future__ import annotations

from typing import Annotated

import typer


def schema(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="One of: acquisition, instrument, scene, sequence, stereo, tdi; summary.",
        ),
    ],
) -> None:
    """Print the JSON Schema of one of the TOML files, or of every summary.json."""
    from sightline.cli.terminal import print_json
    from sightline.io.config import json_schema

    print_json(json_schema(name))
