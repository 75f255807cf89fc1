"""``sightline register``: the bands of a strip laid on one of them by the recovered line of sight."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite, Resume, Workers
from sightline.execution import Progress

if TYPE_CHECKING:
    from sightline.stages import Stages


class PixelType(StrEnum):
    """Types of pixels that may be asked for in place of those of the images."""

    UINT8 = "uint8"
    UINT16 = "uint16"
    INT16 = "int16"
    FLOAT32 = "float32"


def register(
    acquisition: Annotated[Path, typer.Argument(metavar="ACQUISITION.toml", help="What was acquired.")],
    out: Out,
    motion: Annotated[
        Path | None,
        typer.Option(
            "--motion",
            metavar="DIR",
            help="Folder that `recover` wrote for it; none of bands that hold no motion.",
        ),
    ] = None,
    onto: Annotated[
        str | None,
        typer.Option("--onto", metavar="BAND", help="Band whose grid is kept; the first if not given."),
    ] = None,
    pixels: Annotated[
        PixelType | None,
        typer.Option("--type", help="Type of the pixels written; that of the images if not given."),
    ] = None,
    stack: Annotated[bool, typer.Option("--stack", help="One file of all bands, not one for each.")] = False,
    workers: Workers = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Lay the bands of a strip on one of them, or the frames of a spinning camera into one picture."""
    from sightline.cli.output import finished_stages, output_folder
    from sightline.cli.terminal import answered, progress, say

    with (
        output_folder(out, overwrite=overwrite, resume=resume, writes=["summary.json"]) as folder,
        progress() as report,
    ):
        stages = finished_stages(out, refuse=resume and not overwrite)
        kind = pixels and pixels.value
        summary = register_into(
            folder, acquisition, motion, report, onto=onto, pixels=kind, stack=stack, stages=stages
        )
    if answered(summary, as_json):
        return
    if "pairs" not in summary:
        say(f"{summary['lines']} x {summary['columns']} px: {out / 'picture.tif'}, {out / 'picture.png'}")
        return
    for pair in summary["pairs"]:
        say(f"{' - '.join(pair['images']):16}  {_apart(pair['before'], pair['after'])}")
    for band in summary["bands"]:
        if band["placed_by"] == "motion":
            say(f"{band['name']:16}  placed by the recovered motion alone, not measured")
        if band["placed_by"] == "cameras":
            say(f"{band['name']:16}  placed by its camera as given")
    say(f"{', '.join(summary['files'])}, {out / 'report.html'}")


def _apart(before: dict[str, Any], after: dict[str, Any]) -> str:
    """How far apart a pair was and is, in words where too few windows match to know."""
    lengths = [math.hypot(*fit["rms_px"]) for fit in (before, after)]
    was, now = (f"{length:.4f} px" if math.isfinite(length) else "" for length in lengths)
    few_was, few_now = (f"{fit['kept']} of {fit['windows']} windows match" for fit in (before, after))
    if not now:
        return f"{was} apart, now not known: {few_now}" if was else f"how far apart is not known: {few_now}"
    return f"{was} apart, now {now} (rms)" if was else f"before not known: {few_was}; now {now} apart (rms)"


def register_into(
    folder: Path,
    acquisition: Path,
    motion: Path | None,
    report: Progress,
    *,
    onto: str | None = None,
    pixels: str | None = None,
    stack: bool = False,
    stages: Stages | None = None,
) -> dict[str, Any]:
    """Register what `acquisition` holds, write images, summary and report into `folder`; the summary."""
    import time

    from sightline.applications.registration import register_bands
    from sightline.errors import InputError, naming
    from sightline.inputs import will_write
    from sightline.io.acquisition.load import load_acquisition
    from sightline.io.results.recovered import as_given, read_recovered
    from sightline.io.results.registered_frames import frames_picture
    from sightline.kinds.registration import Picture, Registered

    begin = time.perf_counter()
    report("reading the acquisition and what was recovered of it")
    acquired = load_acquisition(acquisition)
    if motion is None and (not acquired.still or len(acquired.bands) < 2):
        raise InputError("Missing option '--motion': give the folder that `recover` wrote for it")
    if motion is not None and acquired.frames and acquired.spin is not None:
        if onto is not None or pixels is not None or stack:
            raise InputError(
                "--onto, --type and --stack are for bands of a strip; frames of a spinning camera become one "
                "picture: leave them out"
            )
        will_write(Picture.files)
        report("laying the frames together")
        with naming(acquisition):
            return Picture().render(frames_picture(acquired, motion), folder, report, begin)
    if not acquired.bands:
        raise InputError(
            f"{acquisition}: frames are given; `register` takes the bands of a strip ([[band]]), or frames "
            'of a camera that spins ([platform] kind = "spin")'
        )
    recovered = as_given(acquired) if motion is None else read_recovered(motion, acquired)
    if stages is not None:
        found = [recovered.motion, recovered.statics, recovered.relief]
        stages.depend([acquired.inputs, acquired.bands, acquired.surface, found, onto, pixels, stack])
    with naming(acquisition):
        registration = register_bands(
            acquired.bands,
            acquired.surface,
            recovered.motion,
            recovered.statics,
            relief=recovered.relief,
            onto=onto,
        )
    return Registered().render(registration, folder, report, begin, pixels=pixels, stack=stack, stages=stages)
