"""``sightline score``: a result against its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def score(
    result: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `recover` or `orient` wrote.")],
    truth: Annotated[
        Path,
        typer.Argument(metavar="TRUTH.csv", help="t,roll,pitch,yaw, or of `orient` camera,roll,pitch,yaw."),
    ],
) -> None:
    """Print errors, NEES and coverage of a result against its truth, as JSON."""
    from sightline.cli.terminal import print_json

    print_json(score_folder(result, truth))


def score_folder(result: Path, truth: Path) -> dict[str, Any]:
    """Score of a folder with ``orientation.csv``, or with ``motion.csv``.

    Of a motion, hidden directions and pixel size are as its summary says; without a ``summary.json`` a
    constant per axis is hidden and errors are in urad.
    """
    from sightline.errors import FormatError
    from sightline.evaluation.score import score_motion
    from sightline.io.hidden import read_hidden, read_summary
    from sightline.io.stereo_score import score_orientation_folder
    from sightline.io.tables import read_motion

    oriented = (result / "orientation.csv").is_file()
    if not oriented and not (result / "motion.csv").is_file():
        raise FormatError(
            f"{result}: DIR must be a folder that `recover` or `orient` wrote (motion.csv or "
            "orientation.csv is "
            "missing)"
        )
    if not truth.is_file():
        form = "camera,roll,pitch,yaw" if oriented else "t,roll,pitch,yaw"
        name = "orientation-truth.csv" if oriented else "truth.csv"
        raise FormatError(f"{truth}: no such truth file; give a CSV file {form} (`simulate` writes {name})")
    if oriented:
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
    return score_motion(
        motion.t,
        motion.angles,
        motion.sigma,
        true.t,
        true.angles,
        hidden=directions,
        hidden_names=names,
        absolute_sigma=motion.sigma_absolute,
        ifov=summary.get("ifov"),
        half_field_px=summary.get("half_field_px"),
    ).as_dict()
