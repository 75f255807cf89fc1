"""Sub-pixel matching against its bounds and against other tools, on the same windows in one run.

Texture 1/f^2, contrast 0.2, system MTF 0.15 at Nyquist, with the aliasing of a real sensor (made four times
finer and decimated), SNR = mean / noise; cross band: an independent layer of the same spectrum (rho 0.95),
gamma 0.8, gain 0.8; whole images shifted by up to 1.5 px per axis by Fourier phase. Every method starts from
shift zero.

    python benchmarks/matching.py            the whole table, several minutes
    python benchmarks/matching.py --quick    fewer windows and cases, under a minute
    python benchmarks/matching.py --jitter   only pairs with jitter of every line, by `sightline match`

Columns: rms error along lines and columns (errors above 1 px are counted as lost and left out); the rms over
both axes divided by the gradient bound, by the coherence bound, and by the coherence bound with aliasing as
noise; claimed sigma / rms; windows per second of CPU on one thread. For Sightline the time includes the
whole-pixel search, the whitening filter, the fit and the covariance.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "matching"), str(ROOT / "src")]

from fourier_textures import information_bounds, shifted_pair  # noqa: E402

from sightline.imaging.source import ArrayImage  # noqa: E402
from sightline.matching.match_images import match_images  # noqa: E402
from sightline.matching.matches import Matches  # noqa: E402
from sightline.matching.select import grid_points  # noqa: E402
from sightline.matching.whitening import Whitening, estimate_whitening  # noqa: E402

Array = np.ndarray
REACH = 3
MARGIN = 24


def cuts(a: Array, b: Array, points: Array, window: tuple[int, int]) -> tuple[list[Array], list[Array]]:
    """Copies of the windows of a, and of b with REACH px more on every side."""
    h, w = window
    corners = np.rint(points - 0.5 * (np.array(window) - 1)).astype(int)
    first = [a[i : i + h, j : j + w].copy() for i, j in corners]
    second = [b[i - REACH : i + h + REACH, j - REACH : j + w + REACH].copy() for i, j in corners]
    return first, second


def inner(region: Array) -> Array:
    return np.ascontiguousarray(region[REACH:-REACH, REACH:-REACH])


def skimage_phase(a: Array, b: Array, points: Array, window: tuple[int, int]) -> Array:
    """Phase correlation, upsampled 100 times (means removed)."""
    from skimage.registration import phase_cross_correlation

    found = []
    for t, r in zip(*cuts(a, b, points, window), strict=True):
        moved = inner(r)
        shift, *_ = phase_cross_correlation(t - t.mean(), moved - moved.mean(), upsample_factor=100)
        found.append(-shift)
    return np.array(found)


def skimage_cross(a: Array, b: Array, points: Array, window: tuple[int, int]) -> Array:
    """The same without normalisation, after alignment to whole pixels by matchTemplate."""
    from skimage.registration import phase_cross_correlation

    whole = np.rint(opencv_template(a, b, points, window))
    found = []
    for t, r, s in zip(*cuts(a, b, points, window), whole.astype(int), strict=True):
        i, j = REACH + np.clip(s, -REACH, REACH)
        moved = r[i : i + window[0], j : j + window[1]]
        shift, *_ = phase_cross_correlation(
            t - t.mean(), moved - moved.mean(), upsample_factor=100, normalization=None
        )
        found.append(s - shift)
    return np.array(found)


def opencv_phase(a: Array, b: Array, points: Array, window: tuple[int, int]) -> Array:
    """cv2.phaseCorrelate with a Hanning window; it changes its arguments, so they are copies."""
    import cv2

    hann = cv2.createHanningWindow((window[1], window[0]), cv2.CV_32F)
    found = []
    for t, r in zip(*cuts(a, b, points, window), strict=True):
        moved = inner(r)
        (x, y), _ = cv2.phaseCorrelate(t - t.mean(), moved - moved.mean(), hann.copy())
        found.append((y, x))
    return np.array(found)


def opencv_template(a: Array, b: Array, points: Array, window: tuple[int, int]) -> Array:
    """Normalised correlation at whole pixels and a parabola through its peak."""
    import cv2

    found = []
    for t, r in zip(*cuts(a, b, points, window), strict=True):
        surface = cv2.matchTemplate(r, t, cv2.TM_CCOEFF_NORMED)
        i, j = np.unravel_index(surface.argmax(), surface.shape)
        i, j = min(max(i, 1), surface.shape[0] - 2), min(max(j, 1), surface.shape[1] - 2)
        y, x = surface[i - 1 : i + 2, j], surface[i, j - 1 : j + 2]
        bend = [min(v[0] + v[2] - 2 * v[1], -1e-9) for v in (y, x)]
        found.append((i - REACH + 0.5 * (y[0] - y[2]) / bend[0], j - REACH + 0.5 * (x[0] - x[2]) / bend[1]))
    return np.array(found)


def opencv_lucas_kanade(a: Array, b: Array, points: Array, window: tuple[int, int]) -> Array:
    """Pyramidal Lucas-Kanade on 8-bit images, all points at once, one pyramid level; from 3 lines on."""
    import cv2

    if min(window) < 3:
        return np.full(points.shape, np.nan)
    bytes_a, bytes_b = (
        np.clip((i - i.mean()) / i.std() * 36 + 127.5, 0, 255).round().astype(np.uint8) for i in (a, b)
    )
    start = np.ascontiguousarray(points[:, None, ::-1], dtype=np.float32)
    end, *_ = cv2.calcOpticalFlowPyrLK(
        bytes_a, bytes_b, start, None, winSize=(window[1], window[0]), maxLevel=1,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.001),
    )  # fmt: skip
    return (end - start)[:, 0, ::-1].astype(float)


def opencv_ecc(a: Array, b: Array, points: Array, window: tuple[int, int]) -> Array:
    """Enhanced correlation coefficient, translation, its smallest smoothing."""
    import cv2

    found = []
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-5)
    for t, r in zip(*cuts(a, b, points, window), strict=True):
        warp = np.array([[1, 0, REACH], [0, 1, REACH]], np.float32)
        try:
            _, warp = cv2.findTransformECC(t, r, warp, cv2.MOTION_TRANSLATION, criteria, None, 1)
            found.append((warp[1, 2] - REACH, warp[0, 2] - REACH))
        except cv2.error:
            found.append((np.nan, np.nan))
    return np.array(found, dtype=float)


RIVALS: dict[str, Callable[[Array, Array, Array, tuple[int, int]], Array]] = {
    "skimage phase u100": skimage_phase,
    "skimage cross u100": skimage_cross,
    "cv2 phaseCorrelate": opencv_phase,
    "cv2 NCC + parabola": opencv_template,
    "cv2 PyrLK": opencv_lucas_kanade,
    "cv2 ECC": opencv_ecc,
}


def whitening_of(a: Array, b: Array) -> Whitening:
    points = grid_points((a.shape[0] - 64, a.shape[1] - 160), window=(16, 64)) + np.array([32, 80])
    return estimate_whitening(ArrayImage(a), ArrayImage(b), points, points)


def sightline(a: Array, b: Array, points: Array, window: tuple[int, int], whitening: Whitening) -> Matches:
    return match_images(
        ArrayImage(a),
        ArrayImage(b),
        points,
        points,
        window=window,
        whitening=whitening,
        search_px=(2, 2),
        threads=1,
    )


def report(
    name: str, errors: Array, seconds: float, bounds: dict[str, float], claimed: float = np.nan
) -> None:
    """One line of the table."""
    good = np.isfinite(errors).all(axis=1) & (np.abs(errors) < 1).all(axis=1)
    rms = np.sqrt((errors[good] ** 2).mean(axis=0)) if good.any() else np.full(2, np.nan)
    both = float(np.sqrt((rms**2).mean()))
    ratios = "  ".join(f"{both / bounds[key]:6.2f}" for key in ("gradient", "coherence", "aliased"))
    honesty = f"{claimed / both:6.2f}" if np.isfinite(claimed) else "     -"
    rate = f"{len(errors) / seconds:9.0f}" if seconds > 0 else "        -"
    lost = 100 * (1 - good.mean())
    print(f"  {name:22s} {rms[0]:7.4f} {rms[1]:7.4f}  {ratios}  {honesty} {lost:6.1f} {rate}", flush=True)


def accuracy(
    size: int, seeds: int, most: int, snrs: tuple[int, ...], windows: tuple[tuple[int, int], ...]
) -> None:
    """The table of all methods."""
    for cross in (False, True):
        for snr in snrs:
            pairs = []
            for seed in range(seeds):
                shift = np.random.default_rng(1000 + seed).uniform(-1.5, 1.5, 2)
                a, b = shifted_pair((size, size), tuple(shift), snr=snr, seed=seed, cross=cross)
                pairs.append((a, b, shift, whitening_of(a, b)))
            for window in windows:
                table_of_case(pairs, window, snr, cross, most)


def table_of_case(
    pairs: list[tuple[Array, Array, Array, Whitening]],
    window: tuple[int, int],
    snr: int,
    cross: bool,
    most: int,
) -> None:
    size = pairs[0][0].shape
    bounds = information_bounds(size, window[0] * window[1], snr=snr, cross=cross)
    limits = ", ".join(f"{key} {value:.4f}" for key, value in bounds.items())
    print(
        f"\n{window[0]} x {window[1]}  SNR {snr}  {'cross' if cross else 'same'} band   bounds px: {limits}"
    )
    print("  method                   rms y   rms x   /grad   /cohe  /alias   claim  lost% windows/s")
    points = grid_points((size[0] - 2 * MARGIN, size[1] - 2 * MARGIN), window=window) + MARGIN
    few = points[np.unique(np.linspace(0, len(points) - 1, most).astype(int))]
    for name, method in RIVALS.items():
        errors, seconds = [], 0.0
        for a, b, shift, _ in pairs:
            begin = time.process_time()
            errors.append(method(a, b, few, window) - shift)
            seconds += time.process_time() - begin
        report(name, np.concatenate(errors), seconds, bounds)
    for name, off in (("Sightline, not whitened", True), ("Sightline", False)):
        errors, variances, seconds = [], [], 0.0
        for a, b, shift, whitening in pairs:
            begin = time.process_time()
            found = sightline(a, b, points, window, None if off else whitening)  # type: ignore[arg-type]
            seconds += time.process_time() - begin
            errors.append(np.where(found.kept[:, None], found.b, np.nan) - points - shift)
            variances.append(found.sigma_px[found.kept] ** 2)
        report(
            name, np.concatenate(errors), seconds, bounds, float(np.sqrt(np.concatenate(variances).mean()))
        )


def bias(size: int, phases: int, most: int) -> None:
    """Largest mean error over sub-pixel phases."""
    for cross, snr in ((False, 200), (True, 100)):
        means: dict[str, list[Array]] = {}
        for k in range(phases):
            shift = np.array([k / phases, k / phases])
            a, b = shifted_pair((size, size), tuple(shift), snr=snr, seed=50, cross=cross)
            window = (10, 100)
            points = grid_points((size - 2 * MARGIN, size - 2 * MARGIN), window=window) + MARGIN
            found = sightline(a, b, points, window, whitening_of(a, b))
            error = (found.b - points - shift)[found.kept]
            means.setdefault("Sightline", []).append(error.mean(axis=0))
            spread = float(error.std() / np.sqrt(len(error)))
            few = points[:most]
            for name in ("cv2 NCC + parabola", "cv2 PyrLK", "cv2 ECC", "skimage phase u100"):
                error = RIVALS[name](a, b, few, window) - shift
                good = np.isfinite(error).all(axis=1) & (np.abs(error) < 1).all(axis=1)
                means.setdefault(name, []).append(error[good].mean(axis=0))
        print(
            f"\nBias over {phases} sub-pixel phases, 10 x 100, SNR {snr}, {'cross' if cross else 'same'} band"
        )
        for name, values in means.items():
            varying = np.array(values) - np.mean(values, axis=0)
            print(
                f"  {name:22s} largest |mean error| {np.abs(values).max():.4f} px, varying with phase by up "
                f"to {np.abs(varying).max():.4f}"
                + (f"  (standard error of each mean {spread:.4f})" if name == "Sightline" else "")
            )


def speed(size: int) -> None:
    """Windows per second of CPU: refinement with and without the search, and the whitening estimate."""
    a, b = shifted_pair((size, size), (0.3, -0.4), snr=100, seed=3, cross=True)
    a, b = np.tile(a, (2, 2)), np.tile(b, (2, 2))
    begin = time.process_time()
    whitening = whitening_of(a, b)
    print(f"\nSpeed, one thread, {a.shape[0]} x {a.shape[1]} px, prediction good to 0.1 px")
    print(f"  whitening estimated once per pair: {time.process_time() - begin:.2f} s")
    rng = np.random.default_rng(0)
    for window in ((10, 100), (32, 32), (16, 16), (4, 100), (2, 100)):
        points = grid_points(a.shape, window=window)
        near = points + np.array([0.3, -0.4]) + rng.normal(0, 0.1, points.shape)
        best = np.inf
        for _ in range(3):
            begin = time.process_time()
            match_images(
                ArrayImage(a), ArrayImage(b), points, near, window=window, whitening=whitening, threads=1
            )
            best = min(best, time.process_time() - begin)
        print(f"  {window[0]:2d} x {window[1]:3d}: {len(points) / best:9.0f} windows/s")


def neighbours(size: int) -> None:
    """Correlation of the errors of windows that touch."""
    print("\nCorrelation of errors of touching windows (line, column component), SNR 100")
    for cross in (False, True):
        a, b = shifted_pair((size, size), (0.3, 0.7), snr=100, seed=9, cross=cross)
        whitening = whitening_of(a, b)
        for height in (2, 4, 10):
            points = grid_points((size - 2 * MARGIN, size - 2 * MARGIN), window=(height, 100)) + MARGIN
            found = sightline(a, b, points, (height, 100), whitening)
            e = np.where(found.kept[:, None], found.b - points - np.array([0.3, 0.7]), 0.0)
            e = e.reshape(len(np.unique(points[:, 0])), -1, 2)
            e -= e.mean(axis=(0, 1))
            power = (e**2).mean(axis=(0, 1))
            below = (e[1:] * e[:-1]).mean(axis=(0, 1)) / power
            beside = (e[:, 1:] * e[:, :-1]).mean(axis=(0, 1)) / power
            print(
                f"  {'cross' if cross else 'same '} {height:2d} x 100  next lines {below.round(3)}  "
                f"next columns {beside.round(3)}  (standard error {1 / np.sqrt(e[..., 0].size):.3f})"
            )


def line_motion(lines: int, seed: int) -> Array:
    """px of each line, lines and columns: slow motion and microvibration, .4 px rms."""
    rng, t = np.random.default_rng([seed, 7]), np.arange(lines)
    motion = np.zeros((lines, 2))
    for period, size in ((900.0, 0.4), (310.0, 0.25), (130.0, 0.2), (61.0, 0.1), (33.0, 0.05)):
        motion += size * np.sin(2 * np.pi * t[:, None] / period + rng.uniform(0, 2 * np.pi, 2))
    return motion


def mean_motion(motion: Array, lines: Array, height: int) -> Array:
    """Means over the lines of windows: line i of the second image shows what lies motion[i] before it."""
    out, rows = np.zeros((len(lines), 2)), np.arange(len(motion))
    for offset in np.arange(height) - 0.5 * (height - 1):
        at = lines + offset
        for _ in range(30):
            at = lines + offset + np.interp(at, rows, motion[:, 0])
        out += np.stack([np.interp(at, rows, motion[:, k]) for k in (0, 1)], axis=1) / height
    return out


def row_means(points: Array, shifts: Array, good: Array) -> tuple[Array, Array]:
    """Lines, and the means of the shifts of their windows."""
    lines = np.unique(points[good, 0])
    return lines, np.array([shifts[good & (points[:, 0] == line)].mean(axis=0) for line in lines])


def jitter(size: int, seeds: int, window: tuple[int, int] = (10, 100)) -> None:
    """Whole pairs whose second image jitters line by line: rms of row means, NEES of single shifts, CPU."""
    from sightline.applications.raster_matches import match_rasters

    print("AROSICS is not run: it needs the Python bindings of GDAL itself, built against the system")
    for cross in (False, True):
        print(f"\nJitter, {size} x {size} px, {'cross' if cross else 'same'} band, SNR 100, {window} windows")
        print("  method                  rms of row means y, x     of windows y, x      NEES   lost%   CPU s")
        for seed in range(seeds):
            motion = line_motion(size, seed)
            a, b = shifted_pair((size, size), (0.0, 0.0), snr=100, seed=seed, cross=cross, motion=motion)
            begin = time.process_time()
            found = match_rasters(ArrayImage(a), ArrayImage(b), threads=1)
            seconds = time.process_time() - begin
            points, kept = found.matches.a, found.matches.kept
            error = (found.shift_px - mean_motion(motion, points[:, 0], window[0]))[kept]
            inverse = np.linalg.inv(found.matches.covariance_px[kept])
            nees = np.einsum("ni,nij,nj->n", error, inverse, error).mean() / 2.0
            profile = found.row_means
            there = np.isfinite(profile.shift_px).all(axis=1)
            means = (profile.shift_px - mean_motion(motion, profile.place, window[0]))[there]
            line_of_jitter("sightline match", means, error, 1.0 - kept.mean(), seconds, nees)
            if seed:
                continue
            inner = points[(np.abs(points - 0.5 * (size - 1)) < 0.5 * size - 60).all(axis=1)]
            for name in ("cv2 ECC", "cv2 PyrLK", "cv2 NCC + parabola", "skimage phase u100"):
                begin = time.process_time()
                shift = RIVALS[name](a, b, inner, window)
                seconds = (time.process_time() - begin) * len(points) / len(inner)
                truth = mean_motion(motion, inner[:, 0], window[0])
                good = np.isfinite(shift).all(axis=1) & (np.abs(shift - truth) < 1.0).all(axis=1)
                lines, mean = row_means(inner, shift, good)
                means = mean - mean_motion(motion, lines, window[0])
                line_of_jitter(name, means, (shift - truth)[good], 1.0 - good.mean(), seconds)


def match_compiled(a: Array, b: Array) -> None:
    """Have the kernels of `match_rasters` compiled before anything is timed."""
    from sightline.applications.raster_matches import match_rasters

    match_rasters(ArrayImage(a), ArrayImage(b), threads=1)


def line_of_jitter(
    name: str, means: Array, error: Array, lost: float, seconds: float, nees: float = np.nan
) -> None:
    """One line of the table of jitter."""
    rows, single = (np.sqrt((e**2).mean(axis=0)) for e in (means, error))
    said = f"{nees:6.3f}" if np.isfinite(nees) else "     -"
    print(
        f"  {name:22s}  {rows[0]:9.5f} {rows[1]:9.5f}           {single[0]:8.4f} {single[1]:8.4f}       "
        f"{said}  {100 * lost:6.1f}  {seconds:6.2f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer windows and cases")
    parser.add_argument("--jitter", action="store_true", help="only pairs with jitter of every line")
    given = parser.parse_args()
    quick = given.quick
    import cv2

    cv2.setNumThreads(1)
    a, b = shifted_pair((256, 512), (0.1, 0.2), snr=100, seed=0)  # compile before anything is timed
    sightline(a, b, grid_points((200, 400)) + MARGIN, (10, 100), whitening_of(a, b))
    if given.jitter:
        match_compiled(a, b)
        jitter(2000, 2)
        return
    if quick:
        accuracy(512, 1, 150, (100,), ((32, 32), (10, 100)))
        bias(512, 4, 150)
        speed(512)
        neighbours(512)
    else:
        match_compiled(a, b)
        jitter(2000, 2)
        accuracy(1024, 3, 300, (30, 100, 200), ((16, 16), (32, 32), (10, 100), (4, 100), (2, 100)))
        bias(1024, 8, 400)
        speed(1024)
        neighbours(1024)


if __name__ == "__main__":
    main()
