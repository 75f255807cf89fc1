"""A real scene without motion: registered Landsat 7 bands cut so that they start at different lines.

    python validation/null.py
    python validation/null.py --layouts          other lags and another first band too, two minutes
    python validation/null.py --mask-saturated   without the saturated third of the pixels

Row i of band k is row i + start of the scene, as if a push-broom camera whose detector lines look that far
ahead had flown over it with no motion at all: the truth is zero. The bands went through the matcher and the
estimator like any strip, with offsets (1 px) and rotations (3e-4) of the detector lines unknown. Printed:
share of lines whose motion is beyond 2 sigma (after the hidden directions are fitted away), tones above a
false-alarm level of 1e-3, and the median sigma; before it, how well "no motion" is true: what is left of the
registration of the bands, by ECC (OpenCV) of tiles without saturated pixels.

The errors of a strip of 600 lines are alike over some fifty lines, so that the share of one strip holds about
ten independent samples: `--layouts` pools twelve.

The data are `landsat7_everest` (RGB and band 4, 30 m, 8 bits) in the folder that SIGHTLINE_DATA names. A
third of the scene is saturated snow.
"""

from __future__ import annotations

import argparse
import os
import warnings
from pathlib import Path

import gates
import numpy as np

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Trajectory
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Band
from sightline.motion.results import LineOfSight
from sightline.motion.strip.joint import less_directions
from sightline.motion.tones import detect_tones

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))
FOLDER = "landsat7_everest"
SCENE = "LE71400412000304SGS00"

#: Pixels of 30 m from 705 km; the speed over the ground gives the line period.
ALTITUDE, PIXEL, SPEED = 705e3, 30.0, 6750.0
#: Lines by which the bands start later than the first: the emulated lags.
STARTS = (0, 12, 25, 47)
LAYOUTS = (STARTS, (0, 7, 19, 30), (0, 30, 41, 50), (0, 20, 33, 60), (47, 25, 12, 0), (0, 5, 11, 18))
ORDERS = ((0, 1, 2, 3), (3, 0, 1, 2))
SATURATED = 255
#: px; tiles by which it is seen how well the bands are registered.
TILE = 48
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


def tile_shift(first: np.ndarray, second: np.ndarray) -> tuple[float, float] | None:
    """Line and column (px) by which a tile lies elsewhere in another band; None if it does not say (ECC)."""
    import cv2

    one, other = (cv2.GaussianBlur(tile.astype(np.float32), (0, 0), 0.8) for tile in (first, second))
    enough = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)
    begin = np.eye(2, 3, dtype=np.float32)
    try:
        # without a mask; smoothed by one pixel, not at all
        alike, found = cv2.findTransformECC(one, other, begin, cv2.MOTION_TRANSLATION, enough, None, 1)  # type: ignore[call-overload]
    except cv2.error:
        return None
    line, column = float(found[1, 2]), float(found[0, 2])
    return (line, column) if alike > 0.9 and max(abs(line), abs(column)) < 1.0 else None


def print_registration(scene: list[tuple[str, np.ndarray]]) -> None:
    """What bands are apart beyond a shift and a trend, row of tiles by row: mean of lines and columns, slope.

    rms px with its noise, as tiles of a row scatter; the slope of lines across, a yaw, at the field's edge.
    """
    print("registration of the bands           lines   noise   columns   noise   slope   noise   px rms")
    for k in range(1, len(scene)):
        (name, first), (other, second) = scene[0], scene[k]
        rows = []
        for line in range(0, first.shape[0] - TILE + 1, TILE // 2):
            at, shifts = [], []
            for column in range(0, first.shape[1] - TILE + 1, TILE // 2):
                tiles = [band[line : line + TILE, column : column + TILE] for band in (first, second)]
                if max((tile >= SATURATED).mean() for tile in tiles) > 0.02:
                    continue
                shift = tile_shift(*tiles)
                if shift is not None:
                    at.append(2.0 * (column + 0.5 * TILE) / first.shape[1] - 1.0)
                    shifts.append(shift)
            if len(at) < 5:
                continue
            terms = np.stack([np.ones(len(at)), at], axis=1)
            fit, *_ = np.linalg.lstsq(terms, np.array(shifts), rcond=None)
            scatter = (np.array(shifts) - terms @ fit).std(axis=0)
            unit = np.sqrt(np.diag(np.linalg.inv(terms.T @ terms)))
            rows.append([line, *fit[0], fit[1, 0], *(scatter * unit[0]), scatter[0] * unit[1]])
        table = np.array(rows)
        said = ""
        for value, sigma in zip(table[:, 1:4].T, table[:, 4:].T, strict=True):
            trend = np.polynomial.Polynomial.fit(table[:, 0], value, 1, w=1.0 / sigma)
            rms = np.sqrt(np.average((value - trend(table[:, 0])) ** 2, weights=sigma**-2.0))
            said += f"{rms:9.3f}{np.mean(sigma**-2.0) ** -0.5:8.3f}"
        print(f"{name} - {other}".ljust(32) + said)


def as_strip(bands: list[tuple[str, np.ndarray]], starts: tuple[int, ...], mask: bool) -> list[Band]:
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
        strip.append(Band(name, ArrayImage(image, image >= SATURATED if mask else None), camera))
    return strip


def recovered(starts: tuple[int, ...], mask: bool, order: tuple[int, ...] = ORDERS[0]) -> LineOfSight:
    """The strip through the estimator, band `order[k]` starting at `starts[k]`."""
    scene = scene_bands()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return recover_line_of_sight(as_strip([scene[k] for k in order], starts, mask), Plane(0.0))


def figures(result: LineOfSight) -> tuple[np.ndarray, np.ndarray]:
    """Motion and sigma, (lines, 3) px, hidden directions fitted away: errors, since there was no motion."""
    angles = less_directions(result.motion.angles, result.hidden, result.scale)
    return angles / result.scale, result.sigma / result.scale


def rows_see(result: LineOfSight) -> float:
    """Highest frequency (Hz) at which tones are named, as in summary.json: half the rate of rows."""
    star = result.records[0].star
    return float(0.5 / np.median(np.diff(star.t_hub.reshape(star.shape)[:, 0])))


def print_pairs(result: LineOfSight) -> None:
    """Highest frequency (Hz) that rows of windows sample: beyond it a spectrum shows slower motion again."""
    print("pair                          lag s   tried    kept   residual px   expected px")
    for pair in result.pairs:
        names = " - ".join(result.image_names[i] for i in pair.images)
        print(
            f"{names:28s} {pair.lag:6.3f} {pair.tried:7d} {pair.kept:7d} "
            f"{pair.rms_after_px:11.4f} {pair.sigma_px:13.4f}"
        )


def print_one(result: LineOfSight) -> None:
    """Figures of one strip, axis by axis, and whether they are what is asked for."""
    error, sigma = figures(result)
    beyond = np.abs(error) > 2.0 * sigma
    print("axis    rms px   median sigma px   mean (error/sigma)^2   lines beyond 2 sigma")
    for k, axis in enumerate(AXES):
        rms, nees = np.sqrt((error[:, k] ** 2).mean()), ((error[:, k] / sigma[:, k]) ** 2).mean()
        median, share = np.median(sigma[:, k]), 100 * beyond[:, k].mean()
        print(f"{axis:6s} {rms:8.4f} {median:12.4f} {nees:18.2f} {share:20.1f} %")
    found = detect_tones(result.motion, false_alarm=1e-3, highest=rows_see(result))
    for tone in found:
        size = tone.amplitude / result.scale[AXES.index(tone.axis)]
        print(f"tone in {tone.axis}: {tone.name}, {size:.4f} px, false alarm {tone.false_alarm:.1e}")
    share, median = 100 * float(beyond.mean()), float(np.median(sigma, axis=0).max())
    gates.check("lines beyond 2 sigma, all axes, %", share, 0.0, 7.0)
    gates.check("tones", len(found), 0, 0)
    gates.check("largest median sigma of an axis, px", median, 0.0, 0.02)


def print_layouts(mask: bool) -> None:
    """The same figures for other lags and another first band, a line each, and all together."""
    print("first band      starts              roll %  pitch %  yaw %   NEES roll pitch yaw   tones")
    shares, squares, tones = [], [], 0
    for starts in LAYOUTS:
        for order in ORDERS:
            result = recovered(starts, mask, order)
            error, sigma = figures(result)
            z = error / sigma
            found = len(detect_tones(result.motion, false_alarm=1e-3, highest=rows_see(result)))
            share, nees = 100 * (np.abs(z) > 2.0).mean(axis=0), (z**2).mean(axis=0)
            shares.append(share)
            squares.append(nees)
            tones += found
            print(
                f"{result.image_names[0]:15s} {starts!s:18s} {share[0]:7.1f} {share[1]:8.1f} {share[2]:6.1f} "
                f"{nees[0]:10.2f} {nees[1]:5.2f} {nees[2]:5.2f} {found:5d}",
                flush=True,
            )
    gates.check("twelve layouts: lines beyond 2 sigma, %", float(np.mean(shares)), 0.0, 7.0)
    gates.check("twelve layouts: mean (error / sigma)^2", float(np.mean(squares)), 0.5, 1.5)
    gates.check("twelve layouts: tones", tones, 0, 0)


def main() -> None:
    """Recover and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--starts", nargs=4, type=int, default=STARTS, help="first line of each band")
    parser.add_argument("--mask-saturated", action="store_true")
    parser.add_argument("--layouts", action="store_true", help="other lags and another first band too")
    arguments = parser.parse_args()
    print_registration(scene_bands())
    result = recovered(tuple(arguments.starts), arguments.mask_saturated)
    print_pairs(result)
    print(f"passes changed the motion by {', '.join(f'{c:.2f}' for c in result.changes)} sigma")
    print_one(result)
    for warning in result.warnings:
        print(f"warning: {warning}")
    if arguments.layouts:
        print_layouts(arguments.mask_saturated)


if __name__ == "__main__":
    gates.run(main, __file__)
