"""The options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

#: Cases of strips, and those of instruments over a real orbit: said in --help, which must not wait for the
#: import of the cases themselves.
STRIP_CASES = ("nominal", "relief", "clouds", "hard", "real", "other-family")
ORBIT_CASES = (
    "pushbroom", "spin-leo", "spin-geo", "mirror-leo", "mirror-geo", "staggered", "every-line",
    "dedicated-matrix", "dedicated-strip", "multi-line",
)  # fmt: skip

Out = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder to write; made if missing, refused if it holds files."),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace files of the same names in DIR; `recover` removes all of an earlier result.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON on stdout.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same scene, bit for bit.")]
