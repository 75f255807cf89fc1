"""``sightline check``: what a file says, what is missing, what will be observable. Runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sightline.cli.options import Json


def check(
    file: Annotated[
        Path, typer.Argument(metavar="FILE.toml", help="An ACQUISITION.toml or INSTRUMENT.toml.")
    ],
    as_json: Json = False,
) -> None:
    """Say what was understood of a file, what is missing, and what will be observable; run nothing."""
    from sightline.cli.terminal import print_json, say
    from sightline.io.acquisition import load_acquisition
    from sightline.io.config import kind_of
    from sightline.io.describe import describe_acquisition
    from sightline.io.instrument import describe_instrument, load_instrument

    if kind_of(file) == "instrument":
        description = describe_instrument(load_instrument(file))
    else:
        description = describe_acquisition(load_acquisition(file))
    if as_json:
        print_json(description)
        return
    for title in ("understood", "missing", "observable"):
        say(f"{title}:")
        for line in description[title] or ["nothing"]:
            say(f"  {line}")
