"""Static parameters of an instrument as unknowns: band offsets, strip rotations, camera constants.

Each is a small change of the cameras with a prior sigma (``predict.StaticParameter``).

Not here: their estimation (``motion/strip/joint.py``, ``motion/frames/solve.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Band
from sightline.motion.measure.predict import MovingCamera, StaticParameter

Array = NDArray[np.float64]


def band_statics(bands: Sequence[Band]) -> list[StaticParameter]:
    """Offsets along and across, rotation and scale of each detector line; those with sigma 0 are left out.

    Parameters
    ----------
    bands : sequence of Band
        In the order of the cameras.

    Notes
    -----
    The scale of all bands together is the height of the platform: the first band is the others' measure.
    """
    out = []
    for image, band in enumerate(bands):
        known = [
            ("offset along", "line_px", "px", band.offset_sigma_px, 0.1),
            ("offset across", "column_px", "px", band.offset_sigma_px, 0.1),
            ("rotation", "rotation", "rad", band.rotation_sigma, 1e-4),
            ("scale", "scale", "", band.scale_sigma if image else 0.0, 1e-4),
        ]
        out += [
            StaticParameter(f"{band.name} {name}", unit, float(sigma), step, _adjust(image, key), (image,))
            for name, key, unit, sigma, step in known
            if sigma > 0.0
        ]
    return out


def _adjust(image: int, key: str) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    def apply(cameras: Sequence[MovingCamera], value: float) -> list[MovingCamera]:
        out = list(cameras)
        camera = out[image]
        if isinstance(camera, PushbroomCamera):
            out[image] = camera.with_detector(camera.detector.adjusted(**{key: value}))
        return out

    return apply


def frame_statics(
    names: Sequence[str],
    *,
    focal_length_sigma_px: float = 0.0,
    principal_point_sigma_px: tuple[float, float] = (0.0, 0.0),
    distortion_sigma: Sequence[float] = (),
) -> list[StaticParameter]:
    """Focal length, principal point and distortion of the one camera that took all frames.

    Parameters
    ----------
    names : sequence of str
        Of the frames (all are touched).
    focal_length_sigma_px, principal_point_sigma_px, distortion_sigma
        1-sigma of what is believed beforehand; 0 keeps the value as given.
    """
    every = tuple(range(len(names)))
    out = []
    if focal_length_sigma_px > 0.0:
        change = _replace_detector("focal_length_px")
        out.append(StaticParameter("focal length", "px", focal_length_sigma_px, 1.0, change, every))
    for k, axis in enumerate(("line", "column")):
        sigma = principal_point_sigma_px[k]
        if sigma > 0.0:
            change = _replace_detector("principal_point_px", k)
            out.append(StaticParameter(f"principal point {axis}", "px", sigma, 0.5, change, every))
    for k, sigma in enumerate(distortion_sigma):
        if sigma > 0.0:
            label, change = ("k1", "k2", "p1", "p2", "k3")[k], _replace_detector("distortion", k)
            out.append(StaticParameter(f"distortion {label}", "", sigma, 1e-3, change, every))
    return out


def _replace_detector(
    field: str, part: int | None = None
) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    def apply(cameras: Sequence[MovingCamera], value: float) -> list[MovingCamera]:
        out = list(cameras)
        for k, camera in enumerate(cameras):
            if isinstance(camera, FrameCamera):
                old = getattr(camera.detector, field)
                if part is None:
                    new = old + value
                else:
                    padded = list(old) + [0.0] * (part + 1 - len(old))
                    padded[part] += value
                    new = tuple(padded)
                out[k] = replace(camera, detector=replace(camera.detector, **{field: new}))
        return out

    return apply


def apply_statics(
    cameras: Sequence[MovingCamera], parameters: Sequence[StaticParameter], values: Array
) -> list[MovingCamera]:
    """The cameras with every static parameter `values` (Q,) away from nominal."""
    out = list(cameras)
    for parameter, value in zip(parameters, values, strict=True):
        if value != 0.0:
            out = parameter.apply(out, float(value))
    return out


def recovered_cameras(
    bands: Sequence[Band], motion: Motion, statics: Mapping[str, float]
) -> tuple[PushbroomCamera, ...]:
    """Cameras that carry a recovered motion and recovered statics.

    Parameters
    ----------
    bands : sequence of Band
        With their nominal cameras.
    motion : Motion
        Departure from the reference attitude; lines outside its span will have no place.
    statics : mapping
        Name of a static parameter to its value; names of other things than these bands' are passed over.
    """
    moved = [band.camera.with_trajectory(band.camera.trajectory.with_motion(motion)) for band in bands]
    parameters = band_statics(bands)
    values = np.array([statics.get(parameter.name, 0.0) for parameter in parameters])
    return tuple(c for c in apply_statics(moved, parameters, values) if isinstance(c, PushbroomCamera))
