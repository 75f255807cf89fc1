"""S1: render a strip with known motion, recover its line of sight, compare with the truth.

Run: python examples/recover_a_strip.py
"""

from __future__ import annotations

import numpy as np

import sightline
from sightline.simulate.scenarios import line_of_sight_case


def main() -> None:
    """Print, per axis, the error against the truth beside the sigma that the estimate claims, in pixels."""
    scene = line_of_sight_case("nominal", seed=2, lines=400, columns=200)
    bands = [
        sightline.Band(
            name=band.name,
            image=sightline.ArrayImage(scene.image(number).astype(np.float32)),
            camera=scene.nominal_cameras[number],
        )
        for number, band in enumerate(scene.bands)
    ]
    result = sightline.recover_line_of_sight(bands, sightline.Plane(0.0))
    estimate = result.motion

    # What the images cannot see (a constant, what free offsets imitate) is left out of the comparison.
    score = sightline.score_motion(
        estimate.t,
        estimate.angles,
        result.sigma,
        estimate.t,
        scene.motion.at(estimate.t),
        hidden=result.hidden,
        ifov=scene.options.ifov,
        half_field_px=scene.options.half_field_px,
    )
    for name, axis in score.axes.items():
        print(
            f"{name:5}  error {axis.rms:.4f} px rms,  claimed sigma {axis.sigma:.4f},  NEES {axis.nees:.2f}"
        )


if __name__ == "__main__":
    main()
