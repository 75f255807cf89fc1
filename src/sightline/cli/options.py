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
    bool, typer.Option("--overwrite", help="Replace an earlier result in DIR; other files stay.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON on stdout.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same scene, bit for bit.")]
ExecutorName = Annotated[
    str,
    typer.Option("--executor", metavar="NAME", help="serial, process, or dask:ADDRESS of a scheduler."),
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", min=1, help="Processes, for --executor process; default: every processor."),
]
