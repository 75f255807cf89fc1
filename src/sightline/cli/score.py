"""``sightline score``: a result against its truth."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork

if TYPE_CHECKING:
    from sightline.io.formats.tables import MotionTable


def score(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder that `recover`, `orient` or `georeference` wrote, or with a poses.csv.",
        ),
    ],
    truth: Annotated[
        Path,
        typer.Argument(
            metavar="TRUTH.csv",
            help="t,roll,pitch,yaw; of `orient` camera,roll,pitch,yaw; of poses poses-truth.csv.",
        ),
    ],
    table: Annotated[
        bool, typer.Option("--table", help="Print a table also where stdout is no terminal.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON also on a terminal.")] = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Print errors, NEES and coverage of a result against its truth: a table on a terminal, else JSON."""
    from sightline.cli.terminal import print_json, say
    from sightline.errors import InputError, failing_numbers
    from sightline.io.results.score_table import score_lines

    if table and as_json:
        raise InputError("--table and --json are two forms of one score: give one of them")
    with failing_numbers(f"{result}"):
        scored = score_folder(result, truth)
    if as_json or not (table or sys.stdout.isatty()):
        print_json(scored)
        return
    for line in score_lines(scored):
        say(line)


#: Table of each kind of result, and the form and name of its truth.
_RESULTS = {
    "poses.csv": ("frame,t,x,y,z,qx,qy,qz,qw", "poses-truth.csv"),
    "orientation.csv": ("camera,roll,pitch,yaw", "orientation-truth.csv"),
    "motion.csv": ("t,roll,pitch,yaw", "truth.csv"),
}


def score_folder(result: Path, truth: Path) -> dict[str, Any]:
    """Score of a folder with ``poses.csv``, ``orientation.csv``, or ``motion.csv``.

    Of a motion, hidden directions and pixel size are as its summary says; without a ``summary.json`` a
    constant per axis is hidden and errors are in urad.
    """
    from sightline.cli.terminal import complain
    from sightline.errors import FormatError
    from sightline.evaluation.score import score_motion
    from sightline.io.formats.tables import read_motion
    from sightline.io.results.hidden import pixel_scale, read_hidden, read_summary
    from sightline.io.results.pose_score import score_pose_folder
    from sightline.io.results.stereo_score import score_orientation_folder

    kind = next((name for name in _RESULTS if (result / name).is_file()), None)
    if kind is None:
        raise FormatError(
            f"{result}: DIR must be a folder that `recover`, `orient` or `georeference` wrote ("
            + ("it is a file" if result.is_file() else "motion.csv, orientation.csv or poses.csv is missing")
            + "); the truth is named after it"
        )
    if not truth.is_file():
        form, name = _RESULTS[kind]
        raise FormatError(f"{truth}: no such truth file; give a CSV file {form} (`simulate` writes {name})")
    if kind == "poses.csv":
        return score_pose_folder(result, truth)
    if kind == "orientation.csv":
        return score_orientation_folder(result, truth)
    motion, true = read_motion(result / "motion.csv"), read_motion(truth)
    if motion.sigma is None:
        raise FormatError(
            f"{result / 'motion.csv'}: no sigma columns, so it states no error to be scored; a result has "
            "sigma_roll, sigma_pitch, sigma_yaw and what else docs/formats.md names"
        )
    summary = read_summary(result)
    hidden = read_hidden(result, summary, len(motion.t))
    directions, names = hidden if hidden is not None else (None, None)
    scored = score_motion(
        motion.t,
        motion.angles,
        motion.sigma,
        true.t,
        true.angles,
        hidden=directions,
        hidden_names=names,
        absolute_sigma=motion.sigma_absolute,
        **pixel_scale(result, summary),
    ).as_dict()
    for doubt in _doubts(motion, true, truth):
        complain("warning", doubt)
    return scored


#: rad in other units of angle that a truth may be in by mistake.
_PER_RAD = {"degrees": 180.0 / math.pi, "arcsec": 648000.0 / math.pi, "mrad": 1e3, "urad": 1e6}
#: Lines of a result between two rows of the truth, from which on that is said.
WIDE_LINES = 4.0


def _doubts(found: MotionTable, true: MotionTable, truth: Path) -> list[str]:
    """What speaks against a table as the truth of a motion: gaps, it is the motion itself, or not in rad."""
    import numpy as np

    doubts = []
    after = np.clip(np.searchsorted(true.t, found.t), 1, len(true.t) - 1) if len(true.t) > 1 else None
    if after is not None and len(found.t) > 1:
        apart = (true.t[after] - true.t[after - 1]) / np.median(np.diff(found.t))
        between = (apart > WIDE_LINES) & (np.abs(found.t - true.t[after]) > 1e-9)
        if between.any():
            doubts.append(
                f"{truth}: {int(between.sum())} of the {len(found.t)} lines of the result lie where its rows "
                f"are up to {apart[between].max():.0f} lines apart: it is interpolated there, and what moves "
                "quicker counts as error; give a row for each line"
            )
    known = np.stack([np.interp(found.t, true.t, angles) for angles in true.angles.T], axis=1)
    if np.array_equal(known, found.angles):
        doubts.append(
            f"{truth}: the same angles as the result's, so that no error is told; the truth is what the "
            "images were made with (`simulate` writes truth.csv)"
        )
        return doubts
    about, other = (angles - angles.mean(axis=0) for angles in (found.angles, known))
    square, both = float((about**2).sum()), float((about * other).sum())
    # alike in shape, as a motion that was found and its truth in another unit are, and not by chance
    if both**2 < 0.8 * square * float((other**2).sum()) or square == 0.0:
        return doubts
    return doubts + [
        f"{truth}: angles {per_rad:.6g} times the result's, as if in {unit}; give roll, pitch, yaw in rad"
        for unit, per_rad in _PER_RAD.items()
        if abs(both / (square * per_rad) - 1.0) < 0.2
    ]
