"""How bands of real strips fit when their motion lays them on each other: Sentinel-2 L1B, sensor geometry.

    python validation/real_strips.py
    python validation/real_strips.py --scenes 02 06

The crops of ``s2_l1b_bands`` (SIGHTLINE_DATA names the folder of real data), with the ground known, and known
to 100 m. B02, B03, B04 give the motion. Every pair of them, registered, is matched again (`fit_bands`, with
windows of 16 x 48 px that the estimate never saw): rms beside the noise that the matches state, along /
across, px. B02-B04 across also by OpenCV's maximum of the correlation coefficient (ECC) on 64 x 64 px,
another matcher. Then offsets, turns, magnifications and the mean turn in yaw in units of their a priori
sigma, and between the two grounds in units of their own. B08 has no part in the motion: what is left of it
across, by that motion, with its offset, turn and scale fitted, in means over 44 lines. The same with all lags
the other way round: whether lags of the wrong sign show in it.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import gates
import numpy as np
from numpy.typing import NDArray
from withheld import DATA, MAIN, SIGNS, scene_file

from sightline.applications.lag_sign import LIKELIER, Placed, placed_by
from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.applications.registration import fit_every_pair, register_bands
from sightline.imaging.source import ImageSource
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.acquisition.load import load_acquisition
from sightline.motion.results import LineOfSight
from sightline.motion.strip.hyper import ATTITUDE_SIGMA
from sightline.products.band_fit import BandFit
from sightline.products.register_bands import values_of_lines

Array = NDArray[np.float64]
HEIGHTS = (0.0, 100.0)
#: px, B02-B04 along and across, of ground that is bare or flat, and of woods and hills.
BARE, WOODS = (0.035, 0.025), (0.055, 0.045)
MOST = {"02": BARE, "04": BARE, "06": WOODS, "09": WOODS}
#: px of ECC windows, and from one to the next; least correlation of one that counts. Nothing is smoothed
#: before: OpenCV's usual 5 px leave gradients of brightness, which colours do not share (.04 to .11 px).
SIDE, STEP, CORRELATED, SMOOTHED = 64, 32, 0.5, 1


@dataclass(frozen=True)
class Fitted:
    """A scene with its ground known to some sigma: result, fits of pairs, B02-B04 across by ECC (px)."""

    found: LineOfSight
    pairs: list[BandFit]
    ecc: float
    ecc_windows: int


def by_ecc(a: ImageSource, b: ImageSource) -> Array:
    """Offsets across (px) of one image to another, by ECC windows."""
    first, second = (values_of_lines(image, 0, image.shape[0]) for image in (a, b))
    out = []
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-6)
    for line in range(0, first.shape[0] - SIDE + 1, STEP):
        for column in range(0, first.shape[1] - SIDE + 1, STEP):
            place = np.s_[line : line + SIDE, column : column + SIDE]
            if not (np.isfinite(first[place]).all() and np.isfinite(second[place]).all()):
                continue
            try:
                value, shift = cv2.findTransformECC(
                    first[place],
                    second[place],
                    np.eye(2, 3, dtype=np.float32),
                    cv2.MOTION_TRANSLATION,
                    ends,
                    np.ones((SIDE, SIDE), dtype=np.uint8),
                    SMOOTHED,
                )
            except cv2.error:  # did not converge
                continue
            if value > CORRELATED:
                out.append(float(shift[0, 2]))
    return np.array(out)


def of_crop(scene: str, names: tuple[str, ...] = MAIN, sign: float = 1.0) -> Acquisition:
    """Bands of one crop."""
    with tempfile.TemporaryDirectory() as folder:
        return load_acquisition(scene_file(scene, Path(folder), names, sign))


def fitted(scene: str, height_sigma: float) -> Fitted:
    """One crop, recovered, registered and matched again."""
    acquired = of_crop(scene)
    found = recover_line_of_sight(acquired.bands, acquired.surface, height_sigma=height_sigma)
    statics = {one.name: one.value for one in found.statics}
    laid = register_bands(acquired.bands, acquired.surface, found.motion, statics, relief=found.relief)
    off = by_ecc(laid.after[0], laid.after[2])
    return Fitted(found, fit_every_pair(laid.after), float(np.sqrt((off**2).mean())), len(off))


def constants(found: LineOfSight) -> dict[str, tuple[float, float, float]]:
    """Value, sigma and a priori sigma of every static, and of the mean turn in yaw."""
    out = {one.name: (one.value, one.sigma, one.prior_sigma) for one in found.statics}
    mean = np.zeros((len(found.motion.t), 3, 1))
    mean[:, 2] = 1.0 / len(mean)
    assert found.functional_covariance is not None
    own = float(np.sqrt(found.functional_covariance(mean)[0, 0]))
    out["yaw"] = float(np.mean(np.asarray(found.motion.angles)[:, 2])), own, ATTITUDE_SIGMA
    return out


def infrared(scene: str, found: LineOfSight, sign: float = 1.0) -> Placed:
    """How well B08 lies beside B03 by the motion of the others."""
    acquired = of_crop(scene, (*MAIN, "B08"), sign)
    placed = placed_by(found, acquired.bands, acquired.surface, 1, 3)
    if placed is None:
        raise SystemExit(f"scene {scene}: B08 matches B03 in too few windows")
    return placed


def of_scene(scene: str) -> float:
    """The lines and figures of a crop; what is left of B08 (px)."""
    both = {sigma: fitted(scene, sigma) for sigma in HEIGHTS}
    for sigma, one in both.items():
        words = [f"scene {scene}, height to {sigma:3.0f} m:"]
        for fit in one.pairs:
            pair = f"{MAIN[fit.images[0]]}-{MAIN[fit.images[1]]}"
            rms, noise = fit.rms_px, fit.noise_px
            words.append(f"{pair} {rms[0]:.3f}/{rms[1]:.3f} (noise {noise[0]:.3f}/{noise[1]:.3f})")
            for axis, name in enumerate(("along", "across")):
                label = f"{scene}, {sigma:.0f} m, {pair}, {name}: rms, px"
                most = 1.5 * noise[axis] + 0.015
                if fit.images == (0, 2):
                    most = min(most, MOST[scene][axis])
                gates.check(label, rms[axis], 0.0, most, ".3f")
        print(*words, f"ECC {one.ecc:.3f} of {one.ecc_windows} windows", flush=True)
        gates.check(f"{scene}, {sigma:.0f} m: B02-B04 across by ECC, px", one.ecc, 0.0, 0.055, ".3f")
    known, unknown = both.values()
    for a, b in zip(known.pairs, unknown.pairs, strict=True):
        ratio = max(np.divide(b.rms_px, a.rms_px))
        pair = f"{MAIN[a.images[0]]}-{MAIN[a.images[1]]}"
        gates.check(f"{scene}, {pair}: rms with the ground known to 100 m over known", ratio, 0.0, 1.1, ".2f")
    before, after = constants(known.found), constants(unknown.found)
    most_prior, most_apart = 0.0, 0.0
    for name, (value, sigma, prior) in after.items():
        other, other_sigma, _ = before[name]
        if prior > 0.0:
            most_prior = max(most_prior, abs(value) / prior, abs(other) / prior)
        if sigma > 0.0 or other_sigma > 0.0:
            most_apart = max(most_apart, abs(value - other) / np.hypot(sigma, other_sigma))
    right = infrared(scene, known.found)
    print(
        f"scene {scene}: constants up to {most_prior:.2f} a priori sigma, {most_apart:.2f} sigma between the "
        f"grounds; B08 {in_words(right)}",
        flush=True,
    )
    turned = of_crop(scene, sign=-1.0)
    wrong = infrared(scene, recover_line_of_sight(turned.bands, turned.surface), -1.0)
    print(f"scene {scene}: lags the other way round: B08 {in_words(wrong)}", flush=True)
    less_likely = wrong.less_likely(right)
    gates.check(f"{scene}: deviance of B08 with lags reversed less as they are", less_likely, LIKELIER)
    gates.check(f"{scene}: constants, a priori sigmas", most_prior, 0.0, 3.0, ".2f")
    gates.check(f"{scene}: constants between the grounds, sigmas", most_apart, 0.0, 3.0, ".2f")
    gates.check(f"{scene}: B08 across, px", right.left_px, 0.0, 0.09, ".3f")
    return right.left_px


def in_words(b08: Placed) -> str:
    """What is left of B08, and what of that is to be expected."""
    return (
        f"{b08.left_px:.3f}, noise of its matches {b08.noise_px:.3f}, "
        f"stated by the motion {b08.stated_px:.3f} px"
    )


def main() -> None:
    """All scenes asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="*", default=list(SIGNS), choices=list(SIGNS))
    given = parser.parse_args()
    np.seterr(all="ignore")
    if not DATA.is_dir():
        gates.note(
            "s2_l1b_bands (set SIGHTLINE_DATA to the folder of real data)", "not found", "found", False
        )
        return
    left = [of_scene(scene) for scene in given.scenes]
    gates.check("B08 across, median of the scenes, px", float(np.median(left)), 0.0, 0.075, ".3f")


if __name__ == "__main__":
    gates.run(main, __file__)
