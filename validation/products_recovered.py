"""Strips seen through the cameras of real products, with look angles of bands added, and recovered.

    python validation/products_recovered.py
    python validation/products_recovered.py --seeds 1 2 3 --lines 3000

Of SPOT 5 (its look table) and of WorldView-2 (its attitudes and orbit): `init` writes the acquisition of the
product, three bands of a part of its image are given look angles of their own, `simulate --acquisition`
renders them with a motion that is known, `recover` finds it, `score` compares. The part is the middle of the
field of WorldView-2; of SPOT 5 the metadata at hand hold 300 columns alone.

Printed, per axis: rms of the error over the sigma that was stated, and the normalised error squared (NEES),
mean of the seeds.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import tempfile
from pathlib import Path

import gates
import numpy as np

from sightline.cli.main import run

SHARED = gates.ROOT.parent / "shared" / "data"
DATA = Path(os.environ.get("SIGHTLINE_DATA", SHARED)) / "vendor_models"
AXES = ("roll", "pitch", "yaw")
#: Metadata, where the part of their image begins, its columns, and tangents by which bands look further
#: ahead: some 90 and 230 lines.
PRODUCTS = {
    "SPOT 5": ("spot_example1.xml", (48000, 0), 300, (0.0, 5e-4, 1.3e-3)),
    "WorldView-2": ("wv_test1.xml", (9000, 17270), 640, (0.0, 5.5e-5, 1.4e-4)),
}
MEASURES = ("sightline.applications.line_of_sight", "sightline.io.formats.products.worldview")


def said(*words: object) -> str:
    """What a command prints; stops where it fails."""
    out, wrong = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(wrong):
        status = run([str(word) for word in words])
    if status:
        raise SystemExit(f"{' '.join(map(str, words))}: {wrong.getvalue()}")
    return out.getvalue()


def acquisition(name: str, folder: Path) -> Path:
    """ACQUISITION.toml of a product with three bands, by `init` and the look angles."""
    metadata, begin, _, ahead = PRODUCTS[name]
    said("init", DATA / metadata, "--out", folder / "init")
    head, _, rest = (folder / "init" / "acquisition.toml").read_text().partition("[[band]]")
    # the ground that is rendered lies at one height, so that nothing about it is unknown
    surface = re.sub(r"height_sigma = \d+", "height_sigma = 0", rest[rest.index("[surface]") :])
    bands = "".join(
        f'[[band]]\nname = "B{k}"\nimage = "B{k}.tif"\nfirst_pixel = [{begin[0]}, {begin[1]}]\n'
        f"look_ahead = {angle!r}\n\n"
        for k, angle in enumerate(ahead)
    )
    path = folder / "init" / "bands.toml"
    path.write_text(head + bands + surface)
    return path


def one(name: str, seed: int, lines: int) -> dict[str, dict[str, float]]:
    """Score of a seed, axis by axis."""
    with tempfile.TemporaryDirectory() as held:
        folder = Path(held)
        file = acquisition(name, folder)
        size = ("--lines", lines, "--columns", PRODUCTS[name][2])
        simulate = ("simulate", "line-of-sight", "--acquisition", file, "--seed", seed, *size)
        said(*simulate, "--out", folder / "sim")
        said("recover", folder / "sim" / "acquisition.toml", "--out", folder / "result")
        score = json.loads(said("score", folder / "result", folder / "sim" / "truth.csv", "--json"))
    return {axis: score[axis] for axis in AXES}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1, 11)))
    parser.add_argument("--lines", type=int, default=2000)
    parser.add_argument("--products", nargs="+", default=list(PRODUCTS))
    given = parser.parse_args()
    for name in given.products:
        scores = [one(name, seed, given.lines) for seed in given.seeds]
        for axis in AXES:
            rms, sigma, nees, count = (
                np.array([score[axis][key] for score in scores])
                for key in ("rms", "sigma", "nees", "effective_samples")
            )
            ratio = float(np.sqrt((rms**2).sum() / (sigma**2).sum()))
            # each strip counts the same: what is unseen of SPOT 5, a turn about the line of sight, is a drift
            # and some tones, a handful of numbers, whatever the samples of its error seem to be worth
            pooled = float(nees.mean())
            each = ", ".join(f"{a / b:.2f}" for a, b in zip(rms, sigma, strict=True))
            print(
                f"{name} {axis:5}: rms {np.sqrt((rms**2).mean()):.4f} px, sigma "
                f"{np.sqrt((sigma**2).mean()):.4f} px, each seed {each}; {count.sum():.0f} independent errors"
            )
            gates.check(f"{name}, {axis}: rms over sigma", ratio, 0.0, 1.25)
            gates.check(f"{name}, {axis}: pooled NEES", pooled, 0.8, 1.25)


if __name__ == "__main__":
    gates.run(main, __file__)
