"""``sightline check``: what a file says, what is missing, what will be observable. Runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sightline.cli.options import AllowNetwork, Json


def check(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE.toml", help="An ACQUISITION, INSTRUMENT, SEQUENCE, STEREO or TDI.toml."),
    ],
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Say what was understood of a file, what is missing, and what will be observable; run nothing."""
    from sightline.cli.terminal import print_json, say
    from sightline.errors import failing_numbers
    from sightline.io.acquisition import load_acquisition
    from sightline.io.config import kind_of
    from sightline.io.describe import describe_acquisition
    from sightline.io.describe_sequence import describe_sequence
    from sightline.io.describe_stereo import describe_stereo
    from sightline.io.instrument import describe_instrument, load_instrument
    from sightline.io.sequence import read_sequence
    from sightline.io.stereo import read_stereo
    from sightline.io.stereo_plan import describe_plan, has_plan, read_plan
    from sightline.io.tdi import describe_tdi, load_tdi

    with failing_numbers(f"{file}"):
        match kind_of(file):
            case "instrument":
                description = describe_instrument(load_instrument(file))
            case "sequence":
                description = describe_sequence(read_sequence(file))
            case "stereo":
                description = (
                    describe_plan(read_plan(file))
                    if has_plan(file)
                    else describe_stereo(read_stereo(file, planned=True))
                )
            case "tdi":
                description = describe_tdi(load_tdi(file))
            case _:
                description = describe_acquisition(load_acquisition(file))
    if as_json:
        print_json(description)
        return
    for title in ("understood", "missing", "observable"):
        say(f"{title}:")
        for line in description[title] or ["nothing"]:
            say(f"  {line}")
