"""S1: render a strip with known motion, recover its line of sight, compare with the truth.

Run: python examples/recover_a_strip.py
"""

from __future__ import annotations

import numpy as np

import sightline
from sightline.simulate.scenarios import line_of_sight_case


def main() -> None:
    """Print, per axis, the error against the truth beside the sigma that the estimate claims, in pixels."""
    scene = line_of_sight_case("nominal", seed=2, lines=1000, columns=300)
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

    # The images cannot see what `result.hidden` holds (a constant, what free offsets imitate): leave it out.
    error = estimate.angles - scene.motion.at(estimate.t)
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        hidden = result.hidden.reshape(-1, result.hidden.shape[2])
        fit, *_ = np.linalg.lstsq(hidden, error.reshape(-1), rcond=None)
        seen = error - result.hidden @ fit
        sigma = np.sqrt(estimate.covariance[:, axis, axis])
        pixel = scene.options.rad_per_px[axis]
        print(
            f"{name:5}  error {seen[:, axis].std() / pixel:.4f} px rms,"
            f"  claimed sigma {np.median(sigma) / pixel:.4f} px"
        )


if __name__ == "__main__":
    main()
