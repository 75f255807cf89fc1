"""``sightline recover``: the motion of the line of sight of a strip, from its own images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sightline.cli.options import Json, Out, Overwrite
from sightline.cli.terminal import Progress


def recover(
    acquisition: Annotated[Path, typer.Argument(metavar="ACQUISITION.toml", help="What was acquired.")],
    out: Out,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Recover roll, pitch and yaw per line, with their sigma, from the bands of one strip."""
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import print_json, progress, say

    with output_folder(out, overwrite=overwrite) as folder, progress() as report:
        summary = recover_into(folder, acquisition, report)
    if as_json:
        print_json(summary)
    else:
        say(f"open {out / 'report.html'}")


def recover_into(folder: Path, acquisition: Path, report: Progress) -> dict[str, Any]:
    """Recover the strip of `acquisition`, write every file of the result into `folder`, give the summary."""
    from sightline.io.acquisition import load_acquisition

    report("reading the acquisition")
    load_acquisition(acquisition)
    raise NotImplementedError
