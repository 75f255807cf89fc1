"""Bands that are not alike: pixels of several sizes, short lags, focal lengths of their own.

    python validation/unlike_bands.py
    python validation/unlike_bands.py --cases "4:1" "short lags" --seeds 7 8

Rendered strips of the nominal motion (tones of 47, 83, 121 Hz), SNR 100:

    4:1             a panchromatic band and three colours of four times its pixels and lines (lags 150, 157.4,
                    172.2 ms), offsets of 0.8 of its own pixels unknown; "colour first": the first band, whose
                    lines the result has, is a colour
    1.5:1 ... 6:1   the same with other ratios
    TDI             4:1, each band of 4 stages of its own lines, lines of .1 ms: the colours average over
                    1.6 ms
    six bands       of three resolutions
    focal length    4:1, each colour's focal length some 2 % off: said (`scale_sigma`), and not said, where a
                    band may be named instead, in a warning or an error
    short lags      the colours of such a camera alone: pairs of 7.4, 14.8, 22.2 ms, lines of 2 ms
    magnification   bands of which each has one of its own, to 6e-4; the ground known, and unknown by 100 m;
                    beside the same strips without it

One line per strip: rms error, in px of its finest band, and NEES of roll / pitch / yaw (yaw: px at the
field's edge), after the hidden directions are fitted away, and the share of windows kept.
An axis whose error is some ten slow numbers has a NEES that scatters by .3 and more from strip to strip:
where that shows, ten strips are pooled.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import gates
import numpy as np
from numpy.typing import NDArray

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import EstimationError
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.motion.band import Band
from sightline.simulate.scenarios import line_of_sight_case

MEASURES = ("sightline.motion.strip.warnings",)

Array = NDArray[np.float64]
AXES = ("roll", "pitch", "yaw")
LAGS = (0.0, 0.150, 0.1574, 0.1722)
THREE, FIVE, TEN = tuple(range(3)), tuple(range(5)), tuple(range(10))
NARROW = {"lines": 1200, "columns": 480}
#: Strips at a time.
AT_ONCE = 2


def coarse(ratio: float, *, colour_first: bool = False) -> dict[str, Any]:
    """A panchromatic band and three colours of pixels `ratio` times as large."""
    ratios, lags = (1.0, ratio, ratio, ratio), LAGS
    if colour_first:
        ratios, lags = ratios[::-1], tuple(LAGS[-1] - lag for lag in LAGS[::-1])
    return {"pixel_ratios": ratios, "lags": lags, "snr": 100.0, "offset_sigma_px": 0.8}


@dataclass(frozen=True)
class Case:
    """Options of the strips, their seeds, and what is asked: NEES, largest rms, least share of windows."""

    options: dict[str, Any]
    seeds: tuple[int, ...] = THREE
    nees: tuple[float, float] = (0.8, 1.25)
    rms: tuple[float, float, float] | None = None
    kept: float | None = None
    size: dict[str, int] = field(default_factory=lambda: {"lines": 1600, "columns": 700})
    height_sigma: float = 0.0
    said: bool = True


PAN = (0.06, 0.06, 0.08)
SHORT = {
    "names": ("A", "B", "C"), "lags": (0.0, 0.0074, 0.0222), "gains": (1.0, 0.9, 0.8),
    "gammas": (1.0, 1.0, 1.0), "pixel_ratios": (4.0, 4.0, 4.0), "snr": 100.0,
}  # fmt: skip
SIX = {
    "names": ("PAN", "B1", "B2", "B3", "S1", "S2"), "lags": (0.0, 0.14, 0.15, 0.1574, 0.1722, 0.19),
    "gains": (1.0, 0.85, 0.9, 0.8, 0.9, 0.85), "gammas": (1.0, 0.9, 1.0, 0.8, 1.0, 0.9),
    "pixel_ratios": (1.0, 2.0, 2.0, 2.0, 4.0, 4.0), "snr": 100.0, "offset_sigma_px": 0.8,
}  # fmt: skip
FAST = {**coarse(4.0), "stages": (4,), "ifov": 1e-6, "line_period": 1e-4}
MAGNIFIED = {"scale_sigma": 6e-4, "snr": 100.0}
CASES = {
    "4:1": Case(coarse(4.0), FIVE, rms=PAN, kept=0.9),
    "4:1, colour first": Case(coarse(4.0, colour_first=True), TEN, rms=PAN, kept=0.9),
    "1.5:1": Case(coarse(1.5), TEN),
    "2:1": Case(coarse(2.0), TEN),
    "3:1": Case(coarse(3.0), TEN),
    "6:1": Case(coarse(6.0)),
    "4:1, TDI": Case(FAST, FIVE, size={"lines": 3000, "columns": 640}),
    "six bands": Case(SIX, TEN),
    "focal length, said": Case({**coarse(4.0), "scale_sigma": 0.02}, TEN),
    "focal length, not said": Case({**coarse(4.0), "scale_sigma": 0.02}, said=False),
    "short lags": Case(
        SHORT, FIVE, nees=(0.7, 1.4), rms=(0.033,) * 3, kept=0.95, size={"lines": 4000, "columns": 1200}
    ),
    "no magnification": Case({"snr": 100.0}, TEN, size=NARROW),
    "magnification": Case(MAGNIFIED, TEN, size=NARROW),
    "no magnification, unknown ground": Case({"snr": 100.0}, TEN, size=NARROW, height_sigma=100.0),
    "magnification, unknown ground": Case(MAGNIFIED, TEN, size=NARROW, height_sigma=100.0),
}


@dataclass(frozen=True)
class Found:
    """A strip's row, and what it says: none of it where a band that was not said to differ is named."""

    row: str
    rms: Array | None = None
    nees: Array | None = None
    kept: float = 1.0
    settled: bool = True


def one(name: str, seed: int) -> Found:
    """A strip of a case, recovered."""
    case, words = CASES[name], f"{name:30} {seed:3d}  "
    scene = line_of_sight_case("nominal", seed, **{**case.size, **case.options})
    bands = scene.as_given()
    if not case.said:
        bands = [replace(band, scale_sigma=Band.scale_sigma) for band in bands]
    names = () if case.said else tuple(repr(band.name) for band in bands[1:])
    try:
        result = recover_line_of_sight(bands, Plane(0.0), height_sigma=case.height_sigma)
    except EstimationError as problem:
        if not any(band in str(problem) for band in names):
            raise
        return Found(f"{words}refused: {problem}")
    score = score_result(result, scene.truth[:, 0], scene.truth[:, 1:])
    in_finest = result.scale[0] / (scene.options.ifov * min(scene.options.pixel_ratios, default=1.0))
    rms = in_finest * np.array([score.axes[axis].rms for axis in AXES])
    nees = np.array([score.axes[axis].nees for axis in AXES])
    words += "  ".join(f"{r:.4f} ({n:.2f})" for r, n in zip(rms, nees, strict=True))
    if any(band in said for band in names for said in result.warnings):
        return Found(f"{words}  named in a warning")
    settled = not any("settle" in said for said in result.warnings)
    kept = sum(p.kept for p in result.pairs) / sum(p.tried for p in result.pairs)
    return Found(f"{words}  kept {kept:.3f}{'' if settled else '  not settled'}", rms, nees, kept, settled)


def judged(name: str, strips: Sequence[Found]) -> Array:
    """The figures of a case; rms (3,) of its strips."""
    case = CASES[name]
    rms = np.sqrt(np.mean([one.rms**2 for one in strips if one.rms is not None], axis=0))
    nees = np.mean([one.nees for one in strips if one.nees is not None], axis=0)
    for k, axis in enumerate(AXES):
        gates.check(f"{name}, {axis}: pooled NEES", nees[k], *case.nees)
        if case.rms:
            gates.check(f"{name}, {axis}: rms, px", rms[k], 0.0, case.rms[k])
    if case.kept:
        gates.check(f"{name}: least share of windows kept", min(one.kept for one in strips), case.kept)
        gates.check(f"{name}: strips that did not settle", sum(not one.settled for one in strips), 0, 0)
    return np.asarray(rms)


def main() -> None:
    """One row per strip, then the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--seeds", nargs="+", type=int, help="in place of those of each case")
    given = parser.parse_args()
    found = {}
    with ProcessPoolExecutor(AT_ONCE) as workers:
        jobs = {
            name: [workers.submit(one, name, seed) for seed in given.seeds or CASES[name].seeds]
            for name in given.cases
        }
        for name, each in jobs.items():
            strips = []
            for job in each:
                strips.append(job.result())
                print(strips[-1].row, flush=True)
            if any(one.rms is not None for one in strips):
                found[name] = judged(name, strips)
    for name in ("magnification", "magnification, unknown ground"):
        if name in found and f"no {name}" in found:
            for k, axis in enumerate(AXES):
                ratio = found[name][k] / found[f"no {name}"][k]
                gates.check(f"{name}, {axis}: rms over that without", ratio, 0.0, 1.1)


if __name__ == "__main__":
    gates.run(main, __file__)
