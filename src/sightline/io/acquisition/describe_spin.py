"""Frames of a spinning camera in plain words: behind ``sightline check``.

Geometry alone speaks: no image is matched.

Not here: strips of detector lines and frames that do not spin (``describe.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sightline.geometry.surface import Dem, Ellipsoid, Infinity, Plane, Surface
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.formats.instants import epoch_words
from sightline.motion.spin.matches import StripPair, strip_pairs


def ground_words(surface: Surface) -> str:
    """What the lines of sight meet, in words."""
    words = {Plane: "a plane", Ellipsoid: "an ellipsoid", Dem: "a DEM", Infinity: "infinitely far"}
    return words.get(type(surface), type(surface).__name__)


def describe_spin(acquisition: Acquisition) -> dict[str, Any]:
    """Frames of a spinning camera in words and numbers.

    Returns
    -------
    dict
        ``understood``, ``missing``, ``observable``: lists of sentences; ``pairs``: a, b (strips), exposures,
        lag (s), shared_lines.
    """
    pairs = strip_pairs(acquisition.frames)
    interval = exposure_interval(acquisition)
    return {
        "understood": _understood(acquisition, interval),
        "missing": _missing(acquisition, pairs),
        "observable": _observable(acquisition, pairs, interval),
        "pairs": [
            {
                "a": acquisition.chip.names[pair.hub],
                "b": acquisition.chip.names[pair.partner],
                "exposures": pair.lag,
                "lag": pair.lag * interval,
                "shared_lines": pair.lines,
            }
            for pair in pairs
        ],
    }


def exposure_interval(acquisition: Acquisition) -> float:
    """s between exposures, median."""
    t = sorted({frame.camera.t for frame in acquisition.frames})
    return float(np.median(np.diff(t)))


def _understood(acquisition: Acquisition, interval: float) -> list[str]:
    """What the file says."""
    spin = acquisition.spin
    assert spin is not None  # the caller looked
    frames = acquisition.frames
    times = sorted({frame.camera.t for frame in frames})
    epoch = epoch_words(acquisition.epoch)
    lines = [
        f"{acquisition.name}: {len(times)} exposures of {len(acquisition.chip.names)} strips on a spinning "
        f"platform, {epoch}",
        f"exposed from t = {times[0]:.4f} to {times[-1]:.4f} s, every {interval:.4f} s",
        f"spin: {spin.rate:.7g} rad/s ({60.0 * abs(spin.rate) / (2.0 * np.pi):.4g} turns a minute, "
        f"{spin.rate * interval:.6g} rad an exposure) about body axis "
        f"[{', '.join(f'{v:.4g}' for v in spin.axis)}], known to {spin.rate_sigma:.2g} rad/s and "
        f"{spin.axis_sigma:.2g} rad",
    ]
    lines += acquisition.sources
    detector = frames[0].camera.detector
    lines.append(f"one pixel is {1e6 / detector.focal_length_px:.4g} urad; {detector.shape[1]} columns")
    for strip, name in enumerate(acquisition.chip.names):
        camera = next(frame.camera for frame in frames if frame.strip == strip)
        lines.append(
            f"strip {name}: {camera.shape[0]} lines, the optical axis at line "
            f"{camera.detector.principal_point_px[0]:.2f} of it"
        )
    if isinstance(acquisition.surface, Infinity):
        drift = acquisition.parallax_sigma
        lines.append(f"ground: infinitely far; directions may drift by {drift:.2g} rad/s, which sigma owns")
    else:
        lines.append(f"ground: {ground_words(acquisition.surface)}")
    return lines


def _missing(acquisition: Acquisition, pairs: list[StripPair]) -> list[str]:
    """What would make the result better."""
    lens, chip = acquisition.lens, acquisition.chip
    known = [
        ("focal length", lens.focal_length_sigma_px, "px"),
        ("column of the axis", lens.principal_point_sigma_px, "px"),
        ("distortion k1", lens.distortion_sigma, ""),
        ("line of the axis", chip.common_line_sigma_px, "px"),
    ]
    for what, sigmas, unit in (
        ("place", chip.line_sigma_px, "px"),
        ("focal length, relative", chip.scale_sigma, ""),
        ("height of what it sees", chip.height_sigma, "m"),
    ):
        known += [(f"{name}: {what}", sigma, unit) for name, sigma in zip(chip.names, sigmas, strict=True)]
    lines = [
        f"{name}: known to {sigma:.4g} {unit}".rstrip() + ", will be estimated"
        for name, sigma, unit in known
        if sigma > 0.0
    ]
    if not pairs:
        lines.append("no strip sees again what another has seen; check rate, axis and the strips")
    several = {(pair.hub, pair.partner) for pair in pairs if pair.hub != pair.partner}
    if several and len(several) == len([pair for pair in pairs if pair.hub != pair.partner]):
        lines.append(
            "a second lag of any pair of strips: with one lag each, spin rate and places of the strips are "
            "confounded"
        )
    if lens.focal_length_sigma_px > 0.0:
        lines.append("the focal length: the images give rate x focal length, the rate only with it")
    return lines


def _observable(acquisition: Acquisition, pairs: list[StripPair], interval: float) -> list[str]:
    """Pairs of strips and what they show."""
    names = acquisition.chip.names
    return [
        f"{names[pair.hub]} - {names[pair.partner]}, {pair.lag} exposure{'s' if pair.lag > 1 else ''} later "
        f"({pair.lag * interval:.4g} s): {pair.lines} lines in common"
        for pair in pairs
    ]
