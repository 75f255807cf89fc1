"""The options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
