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
    from sightline.cli.terminal import complain, print_json, progress, say

    with output_folder(out, overwrite=overwrite) as folder, progress() as report:
        summary = recover_into(folder, acquisition, report)
    if as_json:
        print_json(summary)
        return
    for warning in summary["warnings"]:
        complain("warning", warning)
    for axis in ("roll", "pitch", "yaw"):
        motion, sigma = 1e6 * summary["rms_motion"][axis], 1e6 * summary["rms_sigma"][axis]
        say(f"{axis:5}  {motion:10.4f} urad rms, sigma {sigma:.4f} urad")
    say(f"wrote {out / 'motion.csv'} and what else docs/formats.md names")


def recover_into(folder: Path, acquisition: Path, report: Progress) -> dict[str, Any]:
    """Recover the strip of `acquisition`, write every file of the result into `folder`, give the summary."""
    import time

    from sightline.applications.line_of_sight import RecoverOptions, recover_line_of_sight
    from sightline.io.acquisition import load_acquisition
    from sightline.io.results import write_result

    begin = time.perf_counter()
    report("reading the acquisition")
    acquired = load_acquisition(acquisition)
    result = recover_line_of_sight(
        acquired.bands,
        acquired.surface,
        height_sigma=acquired.height_sigma,
        options=RecoverOptions(**acquired.matching),
        progress=report,
    )
    report("writing the result")
    return write_result(folder, result, acquired, wall_seconds=time.perf_counter() - begin)
