"""The options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

#: Cases of strips, and those of instruments over a real orbit: said in --help, which must not wait for the
#: import of the cases themselves.
STRIP_CASES = ("nominal", "relief", "clouds", "hard", "real", "other-family", "pan-xs")
ORBIT_CASES = (
    "pushbroom", "spin-leo", "spin-geo", "mirror-leo", "mirror-geo", "staggered", "every-line",
    "dedicated-matrix", "dedicated-strip", "multi-line",
)  # fmt: skip
#: Photographs of a matrix instrument in place of a strip.
FRAMES_CASE = "frames"
#: Raw images of a spinning camera, which `init` reads.
SPINNING_CASES = ("junocam", "junocam-pole", "junocam-overexposed")
#: What `--acquisition` stands for in a SCENE.toml.
ACQUISITION_CASE = "acquisition"
#: Cases of synchronous cameras.
STEREO_CASES = (
    "A_paper_T6_K64", "B_paper_T7_K64", "C_paper_T8_K64_128s", "D_paper_T6_K128", "E_modern_4k_sep40",
    "F_oblique_cross120_off20", "G_good_orbit_K32", "H_equator_iss_sep90", "A_random_relief_400", "A_drift",
    "A_three_cameras",
)  # fmt: skip
#: Cases of flights of filter cameras.
SEQUENCE_CASES = (
    "lvf", "stepwise", "mosaic", "rgb", "pan", "small", "cube-60", "two-lines", "long", "rig", "aircraft",
    "cubesat",
)  # fmt: skip
#: What stands at the end of --help of each command: it can be typed as it stands, in this order; `layout`,
#: `noise`, `match` and `tie` take files of the user's own.
EXAMPLES = {
    "demo": ("demo", "demo --case clouds --seed 2 --out clouds"),
    "simulate line-of-sight": (
        "simulate line-of-sight --out strip --lines 2000 --columns 400",
        "simulate line-of-sight --out spin --case spin-leo",
        "simulate line-of-sight --out tried --acquisition strip.toml",
    ),
    "simulate stereo": ("simulate stereo --out pass --shots 8 --points 60",),
    "simulate frames": ("simulate frames --out flight --case small",),
    "init": (
        "init --template strip --out mine",
        "init B02.tif B03.tif B04.tif --preset sentinel-2-msi --out scene",
    ),
    "check": ("check strip/acquisition.toml", "check flight/sequence.toml --json"),
    "recover": (
        "recover strip/acquisition.toml --out result",
        "recover strip/acquisition.toml --out filtered --method kalman",
    ),
    "score": ("score result strip/truth.csv", "score located flight/poses-truth.csv --json"),
    "register": ("register strip/acquisition.toml --motion result --out registered",),
    "export": (
        "export result --to quaternions --out quaternions",
        "export result --to shifts --acquisition strip.toml --out moved",
    ),
    "layout": ("layout instrument.toml --passband 40 150 --out layouts",),
    "orient": ("orient pass/stereo.toml --out oriented", "orient pass/stereo.toml --predict --out bound"),
    "georeference": (
        "georeference flight/sequence.toml --out located",
        "georeference flight/sequence.toml --out poses --poses-only",
    ),
    "tdi": (
        "tdi demo/tdi.toml --out settings",
        "tdi demo/tdi.toml --motion demo/result --out moved",
    ),
    "noise": ("noise raw.tif --dark dark.tif --out noise",),
    "match": (
        "match before.tif after.tif --out shifts",
        "match scene.tif --bands all --out shifts",
    ),
    "tie": ("tie strip.toml --reference ortho.tif --dem dem.tif --out tied",),
    "batch": (
        "batch strips/*.toml --out results --workers 8",
        "batch @today.txt --out results --workers dask:local --resume",
    ),
    "schema": ("schema acquisition",),
    "version": ("version",),
    "warm-up": ("warm-up",),
}


def examples(command: str) -> str:
    """The examples of a command, as the end of its --help."""
    return "\n\n".join(["Examples:", *(f"  sightline {words}" for words in EXAMPLES[command])])


def _let_network(allowed: bool) -> bool:
    if allowed:
        from sightline.access import let_network

        let_network()
    return allowed


AllowNetwork = Annotated[
    bool,
    typer.Option(
        "--allow-network",
        help="Let rasters ask servers for their pixels; without it no request leaves the machine.",
        callback=_let_network,
    ),
]
Out = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder to write; made if missing, refused if it holds files."),
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Write into DIR though it holds files: an earlier result is replaced, other files stay.",
    ),
]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Go on from the finished stages of a run that was stopped, also with --overwrite, which "
        "alone begins anew.",
    ),
]


def _use_threads(word: str | None) -> str | None:
    """So many threads until the command ends; one that asks for another process was sent there before."""
    if word is not None:
        from sightline.execution import Workers, give_threads

        give_threads(Workers.read(word).count)
    return word


Workers = Annotated[
    str | None,
    typer.Option(
        "--workers",
        metavar="N|process:N|dask:ADDRESS|dask:local",
        help="N: so many threads; process:N: in a process of its own, with so many; dask: on a worker of a "
        "cluster. One that is stopped is replaced. The result is the same, bit for bit.",
        callback=_use_threads,
    ),
]


def file_of_mask(name: str, size: str) -> Any:
    """The option of a mask's file, of the size of what it hides."""
    return typer.Option(name, metavar="FILE", help=f"Of {size} size; non-zero: do not use.")


def size_of_window(help: str) -> Any:
    """The option of a window's size."""
    return typer.Option("--window", metavar="LINES COLUMNS", help=help)


def farthest_shift(help: str) -> Any:
    """The option of how far is searched."""
    return typer.Option("--search", metavar="PX", help=help)


Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON on stdout.")]
Seed = Annotated[
    int, typer.Option("--seed", min=0, max=2**63 - 1, help="Same seed, same scene, bit for bit.")
]
