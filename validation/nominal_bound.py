"""How far the nominal strip is from what its pixels allow: all columns of every line, four images.

    python validation/nominal_bound.py [--seeds 100 101]

The bound of one line against the same line of another image is the coherence form of the Cramer-Rao bound,
``J = N integral of (2 pi f)^2 c / (1 - c)``, c from the scene's own law (contrast, MTF, noise, coherence).
Over all lines and four images, with the true spectrum of the motion as prior, the error that remains is
``1 / (1 / S + J)``, integrated over frequency from one period per strip on; without ends, and without what
free offsets hide, so that a real strip cannot do better.

Seeds add the errors of recovered strips, by windows of four lines throughout, and of two (`[matching]
window`, `step`). Before that: by how much pairs are worse than all images against one texture that is
estimated with the motion.
"""

from __future__ import annotations

import argparse
import itertools

import gates
import numpy as np
from numpy.typing import NDArray

from sightline.applications.line_of_sight import RecoverOptions, recover_line_of_sight
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.motion.layout.information import RowNoise
from sightline.motion.layout.sigma import harmonic_sigma
from sightline.simulate.scenarios import line_of_sight_case
from sightline.simulate.scene import TextureLaw

Array = NDArray[np.float64]
#: Steps per cycle/px of the integral over the plane of frequencies.
STEPS = 1201
#: px; the motion of the nominal case (tones as narrow as a strip of 1.5 s can tell).
MOTION = Spectrum(
    (
        Matern(2.0, 1.0, "5/2"),
        Matern(0.1, np.sqrt(3.0) / (2.0 * np.pi * 30.0), "3/2"),
        *(Tone(rms, f, 0.05) for rms, f in ((0.30, 47.0), (0.15, 83.0), (0.08, 121.0))),
    )
)


def spectra() -> tuple[Array, Array, Array, float]:
    """Frequencies along and across (cycle/px), power of the texture at them, and of the noise at all."""
    options = line_of_sight_case("nominal", 0, lines=64, columns=64).options
    law = TextureLaw(options.contrast, (1.0, 1.0), options.mtf_nyquist)
    f = np.linspace(-0.5, 0.5, STEPS)
    fx, fy = np.meshgrid(f, f)
    return fy, fx, law.psd(fx, fy), options.snr**-2.0


def gain_of_one_texture(images: int) -> float:
    """Sigma of places across by pairs over that by all images against one texture that is estimated too.

    Of images of a common texture S, each with N of its own, the information on their places is, at one
    frequency and but for the square of it, ``S^2 / (N (N + K S)) (K I - 1 1')`` for K at once; differences of
    two (K = 2), taken for differences of errors of images, have ``2 S^2 / (N (N + 2 S)) (I - 1 1' / K)``.
    """
    coherence = line_of_sight_case("nominal", 0, lines=64, columns=64).options.coherence
    _, across, signal, noise = spectra()
    common, own = coherence * signal, (1.0 - coherence) * signal + noise
    square = (across * common) ** 2 / own
    pairs, one = (k / 2.0 * float((square / (own + k * common)).sum()) for k in (2, images))
    return float(np.sqrt(one / pairs))


def line_sigma() -> tuple[float, float]:
    """px; of one line of the nominal strip in one image, along and across, from all of its columns."""
    options = line_of_sight_case("nominal", 0, lines=64, columns=64).options
    columns = 1000
    fy, fx, signal, noise = spectra()
    coherence = (options.coherence * signal / (signal + noise)) ** 2
    density = coherence / (1.0 - coherence)
    step = (fx[0, 1] - fx[0, 0]) ** 2
    pair = [1.0 / np.sqrt(columns * float(((2.0 * np.pi * g) ** 2 * density).sum()) * step) for g in (fy, fx)]
    return pair[0] / np.sqrt(2.0), pair[1] / np.sqrt(2.0)


def main() -> None:
    """Print the bound, and how far recovered strips are from it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="*", type=int, default=[100, 101])
    np.seterr(all="ignore")
    along, across = line_sigma()
    options = line_of_sight_case("nominal", 0, lines=64, columns=64).options
    duration = 3000 * options.line_period
    print(f"one line of one image: {along:.4f} px along, {across:.4f} px across")
    print(f"sigma by pairs over that of four images against one texture: {gain_of_one_texture(4):.4f}")
    # yaw moves a column by its place in the field, -1 to 1: a third of the information
    per_axis = {"roll": across, "pitch": along, "yaw": along * np.sqrt(3.0)}
    bound = {}
    for axis, sigma in per_axis.items():
        noise = RowNoise((sigma,) * 4, options.line_period)
        band = (1.0 / duration, 0.5 / options.line_period)
        bound[axis] = harmonic_sigma(options.lags, noise, MOTION, duration, passband=band)
    print("| strip | " + " | ".join(f"{axis} px" for axis in bound) + " |")
    print("|---|---|---|---|")
    print("| bound | " + " | ".join(f"{value:.4f}" for value in bound.values()) + " |")
    for seed, lines in itertools.product(parser.parse_args().seeds, (4, 2)):
        scenario = line_of_sight_case("nominal", seed)
        options = RecoverOptions(window=(lines, 100), step=lines, asked=("window", "step"))
        result = recover_line_of_sight(scenario.as_given(), Plane(0.0), options=options)
        name_of = f"seed {seed}, windows of {lines} lines"
        truth = scenario.truth
        score = score_result(result, truth[:, 0], truth[:, 1:])
        for name, axis in score.axes.items():
            # nothing may be better than the bound, but by the chance of one strip
            gates.check(f"{name_of}, {name}: rms over bound", axis.rms / bound[name], 0.95, 1.5)
            gates.check(f"{name_of}, {name}: NEES", axis.nees, 0.75, 1.3)
        cells = [
            f"{axis.rms:.4f} = {axis.rms / bound[name]:.2f} x, NEES {axis.nees:.2f}"
            for name, axis in score.axes.items()
        ]
        print(f"| {name_of} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    gates.run(main, __file__)
