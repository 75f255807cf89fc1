"""A real spinning camera: do two images of JunoCam tell the same spin, and do pairs of strips agree?

Run: python benchmarks/junocam.py [FOLDER]

Three raw images of Jupiter from ``$SIGHTLINE_DATA/junocam_spin_scan`` (SOURCE.md there): the ellipsoid with
the spacecraft's motion for the two with metadata, and infinity, its parallax owned by the sigma, for all.
There is no attitude truth: agreement within the claimed sigmas is what can be shown. Every figure is printed
beside what is asked of it. FOLDER keeps the acquisitions.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter

from sightline import write_junocam_acquisition
from sightline.applications.spin_attitude import SpinAttitude, recover_spin_attitude
from sightline.imaging.source import ArrayImage
from sightline.io.acquisition.load import load_acquisition
from sightline.matching.match_images import match_images
from sightline.motion.measure.windows import window_grid
from sightline.motion.spin.report import at_camera
from sightline.motion.spin.solve import SPIN_NAMES, SpinEstimate
from sightline.products.frame_mosaic import frame_mosaic

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))
IMAGES = DATA / "junocam_spin_scan"
LOCATED, ALONE = ("44C00030", "44C00032"), "36C00061"
#: px, rad per exposure: what is asked.
MEAN, CLOSURE, FRAMES, RED_GREEN, OTHERS = 0.05, 0.1, 0.1, 0.25, 0.35
RATE_SIGMA, RATE_DIFFERENCE, SIGMAS = 2e-5, 4e-5, 3.0
NEES = (0.8, 1.25)
#: px; of the windows that compare colours of the registered picture.
PICTURE_WINDOW = (48, 48)


def recovered(folder: Path, name: str, *, infinity: bool) -> tuple[SpinAttitude, tuple[str, ...]]:
    """Recover one image; names of its strips."""
    image = next(IMAGES.glob(f"*{name}*-raw.png"))
    metadata = sorted(IMAGES.glob("*-Metadata.json")) if name in LOCATED else []
    out = folder / f"{name}{'-infinity' if infinity else ''}"
    acquired = load_acquisition(write_junocam_acquisition(image, out, metadata=metadata, infinity=infinity))
    assert acquired.spin is not None
    begin = time.process_time()
    result = recover_spin_attitude(
        acquired.frames,
        acquired.surface,
        acquired.spin,
        lens=acquired.lens,
        chip=acquired.chip,
        attitude_sigma=acquired.attitude_sigma,
        parallax_sigma=acquired.parallax_sigma,
    )
    what = "infinity" if infinity or not metadata else "ellipsoid, two-body arc"
    changes = ", ".join(f"{change:.2f}" for change in result.changes)
    print(f"\n## {name}: {what} ({time.process_time() - begin:.0f} s; changes per pass, sigma: {changes})\n")
    return result, acquired.chip.names


def verdict(good: bool) -> str:
    """A word for a table."""
    return "yes" if good else "NO"


def print_spin(result: SpinAttitude) -> None:
    """Rate with its sigmas, rank, constants, departures."""
    found, dt, focal = result.found, result.found.interval, result.cameras[0].detector.focal_length_px
    parts = found.rate_sigma_images, found.rate_sigma_camera, found.rate_sigma_parallax
    images, camera, parallax = (value * dt for value in parts)
    print(
        f"rate {found.rate * dt:.7f} rad per exposure; sigma {images:.1e} from the images "
        f"(<= {RATE_SIGMA:.0e}: {verdict(images <= RATE_SIGMA)}), {camera:.1e} from the camera, "
        f"{parallax:.1e} from the parallax; rate x focal length {found.rate_times_focal * dt:.4f} "
        f"+- {found.rate_times_focal_sigma * dt:.4f} px"
    )
    rank = found.rank
    print(
        f"rank {rank.rank} of {len(rank.names)} constants known better than beforehand, {rank.blind} not at "
        f"all; weakest direction: {rank.weakest}"
    )
    for static in result.statics:
        before = f"(before {static.prior_sigma:.2g})"
        print(f"  {static.name:22} {static.value:+.4g} +- {static.sigma:.2g} {before} {static.unit}")
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        rms, sigma = focal * found.departure_rms[k], focal * found.departure_sigma[k]
        limit = focal * found.departure_limit[k]
        print(f"  departures about {axis}: {rms:.3f} px rms, sigma {sigma:.3f}; 95 %: <= {limit:.3f} px rms")


def print_strips(result: SpinAttitude, names: tuple[str, ...]) -> None:
    """What the pairs of strips left over."""
    print(
        "\n| pair, exposures | windows | mean line px | <= .05 | rms line, column px | <= .25 / .35 "
        "| per-exposure means line, column px | <= .1 | their NEES "
        "| scale | NEES | .8-1.25 | odd exposures by even |"
    )
    print("|---" * 13 + "|")
    for strip in result.found.strips:
        pair = {names[strip.hub], names[strip.partner]}
        limit = RED_GREEN if pair == {"red", "green"} else OTHERS
        asked = strip.lag == 1 and pair in ({"red", "green"}, {"green", "blue"})
        bands = len(pair) == 2
        means, nees = strip.frame_means_px, float(np.mean(strip.nees))
        crossed = crossed_nees(result.estimate, (strip.hub, strip.partner, strip.lag))
        cells = [
            f"{names[strip.hub]}-{names[strip.partner]} {strip.lag}",
            f"{strip.kept}/{strip.tried}",
            f"{strip.mean_px[0]:+.3f} +- {strip.mean_sigma_px[0]:.3f}",
            verdict(abs(strip.mean_px[0]) <= MEAN) if bands else "",
            f"{strip.rms_px[0]:.3f}, {strip.rms_px[1]:.3f}",
            verdict(max(strip.rms_px) <= limit),
            f"{means[0]:.3f}, {means[1]:.3f}",
            verdict(max(means) <= FRAMES) if asked else "",
            f"{np.mean(strip.frame_nees):.2f}",
            f"{strip.scale[0]:.2f}, {strip.scale[1]:.2f}",
            f"{nees:.2f}",
            verdict(NEES[0] <= nees <= NEES[1]),
            f"{crossed:.2f}",
        ]
        print(f"| {' | '.join(cells)} |")
    print("\n| closure | line px | column px | <= .1 px and 3 sigma |\n|---|---|---|---|")
    for closure in result.found.closures:
        value, sigma = np.array(closure.value_px), np.array(closure.sigma_px)
        good = bool((np.abs(value) <= CLOSURE).all() and (np.abs(value) <= SIGMAS * sigma).all())
        (a, b, c), (first, second) = closure.strips, closure.lags
        name = f"{names[a]}-{names[b]} {first}, {names[b]}-{names[c]} {second}, less {names[a]}-{names[c]}"
        line, column = (f"{v:+.3f} +- {s:.3f}" for v, s in zip(value, sigma, strict=True))
        print(f"| {name} | {line} | {column} | {verdict(good)} |")


def crossed_nees(estimate: SpinEstimate, which: tuple[int, int, int]) -> float:
    """Mean square of the residuals of odd exposures in the sigma that the even ones ask for."""
    rows = estimate.rows
    number = [(pair.hub, pair.partner, pair.lag) for pair in estimate.pairs].index(which)
    of = (rows.pair == number) & estimate.kept
    sigma = np.sqrt(np.einsum("mii->mi", estimate.noise.covariance(rows)))
    square = (rows.residual / sigma) ** 2
    odd = np.array([estimate.unknowns.frames[hub].exposure % 2 == 1 for hub in rows.hub])
    even_level = square[of & ~odd].mean(axis=0)
    return float((square[of & odd] / even_level).mean())


def print_picture(result: SpinAttitude, names: tuple[str, ...], out: Path) -> None:
    """How far the colours of the registered picture lie apart, nominal and recovered cameras."""
    acquired = load_acquisition(out / "acquisition.toml", look=False)
    unknowns = result.estimate.unknowns
    heights = unknowns.heights(result.estimate.x).tolist() if unknowns.layers else None
    nominal = [frame.camera for frame in acquired.frames]
    print(
        "\n| registered picture | windows | mean line, column px | rms line, column px |\n|---|---|---|---|"
    )
    for what, cameras, layers in (("nominal", nominal, None), ("recovered", result.cameras, heights)):
        made = frame_mosaic(
            acquired.frames, cameras, acquired.surface, names=names, heights=layers, masked=True
        )
        for colour in ("red", "blue"):
            hub, other = (made.pixels[made.names.index(name)] for name in ("green", colour))
            whole = np.isfinite(hub) & np.isfinite(other)
            share = uniform_filter(whole.astype(float), PICTURE_WINDOW)
            points = window_grid(hub.shape, PICTURE_WINDOW, PICTURE_WINDOW[0]).centres
            at = np.rint(points).astype(int)
            points = points[share[at[:, 0], at[:, 1]] > 0.9]
            found = match_images(
                ArrayImage(hub), ArrayImage(other), points, points, window=PICTURE_WINDOW,
                search_px=(6, 6), whitening=None,
            )  # fmt: skip
            apart = (found.b - found.a)[found.kept]
            apart = apart[(np.abs(apart - np.median(apart, axis=0)) < 1.0).all(axis=1)]
            mean, rms = apart.mean(axis=0), np.sqrt((apart**2).mean(axis=0))
            print(
                f"| green-{colour}, {what} cameras | {len(apart)} | {mean[0]:+.3f}, {mean[1]:+.3f} "
                f"| {rms[0]:.3f}, {rms[1]:.3f} |"
            )


def fused_camera(first: SpinEstimate, second: SpinEstimate) -> np.ndarray:
    """The constants of lens and chip that both images together ask for (they are one camera)."""
    own_parallax = sum(parameter.name.startswith("parallax") for parameter in first.unknowns.statics)
    rows = slice(len(SPIN_NAMES), len(SPIN_NAMES) + len(first.unknowns.statics) - own_parallax)
    weight = -np.diag(first.unknowns.prior_sigma[rows] ** -2.0)
    right = np.zeros(len(weight))
    for estimate in (first, second):
        own = np.linalg.inv(estimate.covariance[rows, rows])
        weight += own
        right += own @ estimate.x[rows]
    return np.asarray(np.linalg.solve(weight, right))


def print_agreement(first: SpinAttitude, second: SpinAttitude, what: str) -> None:
    """Rates of two images of one orbit, as each has it and with one camera for both."""
    dt = first.found.interval
    camera = fused_camera(first.estimate, second.estimate)
    (a, sigma_a), (b, sigma_b) = (at_camera(result.estimate, camera) for result in (first, second))
    alone = (first.found.rate - second.found.rate) * dt
    difference, sigma = (a - b) * dt, float(np.hypot(sigma_a, sigma_b)) * dt
    good = abs(difference) <= RATE_DIFFERENCE and abs(difference) <= SIGMAS * sigma
    print(
        f"{what}: rates differ by {alone:+.1e} as each has it, {difference:+.1e} +- {sigma:.1e} rad per "
        f"exposure with one camera for both (<= {RATE_DIFFERENCE:.0e} and 3 sigma: {verdict(good)})"
    )


def main() -> None:
    """Recover all, print all."""
    if not IMAGES.is_dir():
        print(f"no images in {IMAGES}; set SIGHTLINE_DATA to the folder of real data")
        return
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="junocam-"))
    found = {}
    for name, infinity in [*((n, False) for n in LOCATED), *((n, True) for n in (*LOCATED, ALONE))]:
        result, names = recovered(folder, name, infinity=infinity)
        print_spin(result)
        print_strips(result, names)
        if not infinity:
            print_picture(result, names, folder / name)
        found[name, infinity] = result
    print("\n## Two images, 19 minutes apart\n")
    for infinity, what in ((False, "ellipsoid"), (True, "infinity")):
        print_agreement(*(found[name, infinity] for name in LOCATED), what)


if __name__ == "__main__":
    main()
