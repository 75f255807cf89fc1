"""``sightline schema``: the JSON Schema of a TOML file that a command reads."""

from __future__ import annotations

from typing import Annotated

import typer


def schema(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="Which file: acquisition, instrument, scene, sequence, stereo or tdi."
        ),
    ],
) -> None:
    """Print the JSON Schema of one of the TOML files."""
    from sightline.cli.terminal import print_json
    from sightline.io.config import json_schema

    print_json(json_schema(name))
