"""A pair of bands left out, predicted by the others, compared with its own matches: real strips and rendered.

    python validation/withheld.py
    python validation/withheld.py --seeds 100 101 --scenes 02 06

The scenes are the crops of Sentinel-2 L1B in sensor geometry of ``s2_l1b_bands``: SIGHTLINE_DATA names the
folder of real data. Of each, B02-B04 is left out (``recover --withhold``), and the pair that a run of all
three does without is looked at (B03-B04). Rendered strips (``nominal``) take turns. One line per pair and
axis: windows, independent ones that they are worth, rms of measured less predicted, its stated sigma and that
of the prediction alone (px), NEES (1 where sigmas are true), share within 1.96 sigma. Pooled over windows.
"""

from __future__ import annotations

import argparse
import math
import os
import tempfile
from pathlib import Path

import gates
import numpy as np

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.geometry.surface import Plane
from sightline.io.acquisition.load import load_acquisition
from sightline.motion.strip.strip import RecoverOptions
from sightline.motion.strip.withheld import WithheldAxis
from sightline.simulate.scenarios import line_of_sight_case

MEASURES = ("sightline.motion.strip.withheld",)

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA")) / "s2_l1b_bands"
#: Of the crops: order of the file's bands, seconds after B02 (or before it, in scenes of the other sign).
BANDS = {"B02": (1, 0.0), "B03": (2, 0.527), "B04": (3, 1.005), "B08": (4, 0.264)}
MAIN = ("B02", "B03", "B04")
SIGNS = {"02": 1.0, "04": -1.0, "06": -1.0, "09": 1.0}
SPEED, ALTITUDE, PERIOD = 10.0 / 1.5e-3, 786e3, 1.5e-3
SEEDS = tuple(range(100, 120))


def scene_file(scene: str, folder: Path, names: tuple[str, ...] = MAIN, sign: float = 1.0) -> Path:
    """The acquisition of bands of one crop: level flight, 10 m pixels, nominal lags, offsets to 3 px.

    `sign`: -1 for lags the other way round.
    """
    text = (
        f'[acquisition]\nname = "scene {scene}"\n[platform]\nkind = "level-flight"\naltitude = {ALTITUDE}\n'
        f"ground_speed = {SPEED}\n[surface]\nheight = 0.0\n"
    )
    for name in names:
        number, seconds = BANDS[name]
        lag = sign * SIGNS[scene] * seconds
        text += (
            f'[[band]]\nname = "{name}"\nimage = "{DATA / f"{scene}.tif"}"\nimage_band = {number}\n'
            f"columns = 352\nifov = {10.0 / ALTITUDE}\nline_period = {PERIOD}\n"
            f"look_ahead = {-math.atan(lag * SPEED / ALTITUDE)}\nfirst_line_time = {lag}\n"
            "offset_sigma_px = 3.0\nrotation_sigma = 3e-3\n"
        )
    path = folder / f"{scene}.toml"
    path.write_text(text)
    return path


def of_scene(scene: str, withhold: tuple[tuple[str, str], ...]) -> tuple[WithheldAxis, ...]:
    """Left-out pairs of one crop."""
    with tempfile.TemporaryDirectory() as name:
        acquired = load_acquisition(scene_file(scene, Path(name)))
    options = RecoverOptions(withhold=withhold)
    return recover_line_of_sight(acquired.bands, acquired.surface, options=options).withheld


def of_rendered(seed: int, lines: int, columns: int) -> tuple[WithheldAxis, ...]:
    """Left-out pairs of one rendered strip: one on demand of even seeds, those not needed of odd ones."""
    bands = line_of_sight_case("nominal", seed, lines=lines, columns=columns).as_given()
    withhold = () if seed % 2 else ((bands[0].name, bands[2].name),)
    return recover_line_of_sight(bands, Plane(0.0), options=RecoverOptions(withhold=withhold)).withheld


def show(label: str, found: tuple[WithheldAxis, ...]) -> None:
    """One line per pair and axis, with its gate."""
    for one in found:
        pair = "-".join(one.pair)
        print(
            f"{label:12s} {pair:8s} {one.axis:6s} windows {one.count:4d} worth {one.samples:4.0f} "
            f"rms {one.rms_px:.4f} sigma {one.sigma_px:.4f} prediction {one.prediction_sigma_px:.4f} "
            f"NEES {one.nees:.2f} within {100.0 * one.coverage:.1f} %",
            flush=True,
        )
        gates.check(f"{label} {pair}, {one.axis}: NEES", one.nees, 0.5, 1.7, ".2f")


def pooled(label: str, found: list[WithheldAxis]) -> None:
    """NEES and coverage of all windows of each axis."""
    for axis in ("along", "across"):
        own = [one for one in found if one.axis == axis]
        if not own:
            continue
        count = [one.count for one in own]
        nees = float(np.average([one.nees for one in own], weights=count))
        coverage = 100.0 * float(np.average([one.coverage for one in own], weights=count))
        samples = sum(one.samples for one in own)
        print(
            f"{label}, {axis}: NEES {nees:.2f} of {samples:.0f} independent windows, within {coverage:.1f} %"
        )
        gates.check(f"{label}, {axis}: pooled NEES", nees, 0.8, 1.25, ".2f")
        gates.check(f"{label}, {axis}: coverage, %", coverage, 92.0, 98.0, ".1f")


def main() -> None:
    """All scenes and seeds asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="*", default=list(SIGNS), choices=list(SIGNS))
    parser.add_argument("--seeds", nargs="*", type=int, default=list(SEEDS))
    parser.add_argument("--lines", type=int, default=600)
    parser.add_argument("--columns", type=int, default=640)
    given = parser.parse_args()
    np.seterr(all="ignore")
    every: list[WithheldAxis] = []
    real: list[WithheldAxis] = []
    if given.scenes and not DATA.is_dir():
        gates.note(
            "s2_l1b_bands (set SIGHTLINE_DATA to the folder of real data)", "not found", "found", False
        )
        given.scenes = []
    for scene in given.scenes:
        for withhold in ((), (("B02", "B04"),)):
            found = of_scene(scene, withhold)
            show(f"scene {scene}", found)
            real += found
    rendered: list[WithheldAxis] = []
    for seed in given.seeds:
        found = of_rendered(seed, given.lines, given.columns)
        show(f"rendered {seed}", found)
        rendered += found
    pooled("scenes", real)
    pooled("rendered strips", rendered)
    every = real + rendered
    if real and rendered:
        pooled("all", every)


if __name__ == "__main__":
    gates.run(main, __file__)
