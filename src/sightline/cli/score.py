"""``sightline score``: a result against its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def score(
    result: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `recover` wrote.")],
    truth: Annotated[Path, typer.Argument(metavar="TRUTH.csv", help="t,roll,pitch,yaw of the true motion.")],
) -> None:
    """Print errors, NEES and coverage of a result against its truth, as JSON."""
    from sightline.cli.terminal import print_json
    from sightline.evaluation.score import score as score_against_truth

    print_json(score_against_truth(result, truth))
