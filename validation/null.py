"""A real scene without motion: registered Landsat 7 bands cut so that they start at different lines.

    python validation/null.py
    SIGHTLINE_DATA=/path/to/data python validation/null.py

Row i of band k is row i + start of the scene, as if a push-broom camera whose detector lines look that far
ahead had flown over it with no motion at all: the truth is zero. The bands went through the matcher and the
estimator like any strip, with offsets (1 px) and rotations (3e-4) of the detector lines unknown. Printed:
share of lines whose motion is beyond 2 sigma (after the hidden directions are fitted away), tones above a
false-alarm level of 1e-3, and the median sigma.

The data are `landsat7_everest` (RGB and band 4, 30 m, 8 bits) under SIGHTLINE_DATA, by default
`../shared/data` beside the repository. A third of the scene is saturated snow: those pixels are masked.
"""

from __future__ import annotations

import argparse
import os
import warnings
from pathlib import Path

import numpy as np

from sightline.applications.line_of_sight import Band, recover_line_of_sight
from sightline.applications.results import LineOfSight
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Trajectory
from sightline.imaging.source import ArrayImage
from sightline.motion.joint import remove_directions
from sightline.motion.tones import detect_tones

DATA = Path(os.environ.get("SIGHTLINE_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
FOLDER = "landsat7_everest"
SCENE = "LE71400412000304SGS00"

#: Pixels of 30 m from 705 km; the speed over the ground gives the line period.
ALTITUDE, PIXEL, SPEED = 705e3, 30.0, 6750.0
#: Lines by which the bands start later than the first: the emulated lags.
STARTS = (0, 12, 25, 47)
SATURATED = 255
AXES = ("roll", "pitch", "yaw")


def scene_bands() -> list[tuple[str, np.ndarray]]:
    """The four bands of the scene, (lines, columns) uint8 each, with their names."""
    import rasterio

    out = []
    for part, names in (("RGB", ("red", "green", "blue")), ("B4", ("near infrared",))):
        path = DATA / FOLDER / f"{SCENE}_{part}.tif"
        if not path.exists():
            raise SystemExit(f"{path} does not exist; set SIGHTLINE_DATA to the folder that holds {FOLDER}/")
        with rasterio.open(path) as image:
            out += list(zip(names, image.read(), strict=True))
    return out


def as_strip(bands: list[tuple[str, np.ndarray]], starts: tuple[int, ...]) -> list[Band]:
    """Bands cut to start at `starts`, each with a camera that looks so many lines ahead."""
    lines = bands[0][1].shape[0] - max(starts)
    ifov, period = PIXEL / ALTITUDE, PIXEL / SPEED
    duration = period * bands[0][1].shape[0]
    trajectory = Trajectory.level_flight(ALTITUDE, SPEED, -duration, 2.0 * duration)
    strip = []
    for (name, scene), start in zip(bands, starts, strict=True):
        image = scene[start : start + lines]
        detector = LineDetector.from_ifov(
            name, image.shape[1], ifov, period, look_ahead=float(np.arctan(start * ifov))
        )
        camera = PushbroomCamera(detector, trajectory, FixedMount(), 0.0, lines)
        strip.append(Band(name, ArrayImage(image, image >= SATURATED), camera))
    return strip


def report(result: LineOfSight) -> bool:
    """Print the figures; True where all are within what is asked for."""
    angles = remove_directions(result.motion.angles, result.hidden, result.scale) / result.scale
    sigma = result.sigma / result.scale
    beyond = np.abs(angles) > 2.0 * sigma
    print("axis    rms px   median sigma px   mean (error/sigma)^2   lines beyond 2 sigma")
    for k, axis in enumerate(AXES):
        rms = np.sqrt((angles[:, k] ** 2).mean())
        nees = ((angles[:, k] / sigma[:, k]) ** 2).mean()
        print(
            f"{axis:6s} {rms:8.4f} {np.median(sigma[:, k]):12.4f} {nees:18.2f} {100 * beyond[:, k].mean():18.1f} %"
        )
    tones = detect_tones(result.motion, false_alarm=1e-3)
    for tone in tones:
        size = tone.amplitude / result.scale[AXES.index(tone.axis)]
        print(f"tone in {tone.axis}: {tone.name}, {size:.4f} px, false alarm {tone.false_alarm:.1e}")
    if not tones:
        print("no tone above a false-alarm level of 1e-3")
    share, median = float(beyond.mean()), float(np.median(sigma, axis=0).max())
    print(f"all axes: {100 * share:.1f} % of lines beyond 2 sigma; largest median sigma {median:.4f} px")
    return share <= 0.07 and median <= 0.02 and not tones


def pair_table(result: LineOfSight) -> None:
    """What the pairs left over."""
    print("pair                          lag s   tried    kept   residual px   expected px")
    for pair in result.pairs:
        names = " - ".join(result.image_names[i] for i in pair.images)
        print(
            f"{names:28s} {pair.lag:6.3f} {pair.tried:7d} {pair.kept:7d} "
            f"{pair.rms_after_px:11.4f} {pair.sigma_px:13.4f}"
        )


def main() -> None:
    """Recover and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", nargs=4, type=int, default=STARTS, help="first line of each band")
    parser.add_argument("--save", type=Path, help="also keep angles, sigma and residuals in this .npz")
    arguments = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        result = recover_line_of_sight(as_strip(scene_bands(), tuple(arguments.starts)), Plane(0.0))
    pair_table(result)
    print(f"passes changed the motion by {', '.join(f'{c:.2f}' for c in result.changes)} sigma")
    within = report(result)
    for warning in result.warnings:
        print(f"warning: {warning}")
    if arguments.save:
        angles = remove_directions(result.motion.angles, result.hidden, result.scale) / result.scale
        np.savez(arguments.save, angles=angles, sigma=result.sigma / result.scale)
    print("within" if within else "NOT within", "what is asked for: 7 % of lines, no tone, sigma 0.02 px")


if __name__ == "__main__":
    main()
