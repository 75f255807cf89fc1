"""What a recovery of a spinning camera adds to ``summary.json``: the entry ``spin``.

Not here: what all recoveries say (``line_of_sight.py``).
"""

from __future__ import annotations

from typing import Any

from sightline.applications.spin_attitude import SpinAttitude
from sightline.io.formats.tables import ANGLES


def spin_summary(result: SpinAttitude, names: tuple[str, ...]) -> dict[str, Any]:
    """The entry ``spin``; angles in rad, lengths in px.

    Parameters
    ----------
    result : SpinAttitude
    names : tuple of str
        Of the strips.
    """
    found = result.found
    axes = {
        "rms": found.departure_rms,
        "rms_sigma": found.departure_sigma,
        "size": found.departure_size,
        "limit_95": found.departure_limit,
    }
    return {
        "rate": found.rate,
        "rate_sigma": {
            "images": found.rate_sigma_images,
            "camera": found.rate_sigma_camera,
            "parallax": found.rate_sigma_parallax,
        },
        "rate_per_exposure": found.rate * found.interval,
        "interval": found.interval,
        "rate_times_focal_length": found.rate_times_focal,
        "rate_times_focal_length_sigma": found.rate_times_focal_sigma,
        "axis": found.axis.tolist(),
        "axis_sigma": found.axis_sigma.tolist(),
        "rank": found.rank.rank,
        "unknown_constants": len(found.rank.names),
        "weakest_direction": found.rank.weakest,
        "strips": [
            {**vars(strip), "hub": names[strip.hub], "partner": names[strip.partner]}
            for strip in found.strips
        ],
        "closures": [
            {**vars(closure), "strips": [names[strip] for strip in closure.strips]}
            for closure in found.closures
        ],
        "departures": {key: dict(zip(ANGLES, values.tolist(), strict=True)) for key, values in axes.items()},
        "exposures": [
            {
                "t": float(t),
                "departure": dict(zip(ANGLES, departure.tolist(), strict=True)),
                "sigma": dict(zip(ANGLES, sigma.tolist(), strict=True)),
            }
            for t, departure, sigma in zip(
                result.motion.t, result.estimate.departures, result.estimate.departure_sigmas, strict=True
            )
        ],
    }
