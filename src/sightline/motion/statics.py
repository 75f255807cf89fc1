"""Static parameters of an instrument as unknowns: band offsets, strip rotations, camera constants.

Each is a small change of the cameras with a prior sigma (``predict.StaticParameter``).

Not here: their estimation (``motion/strip/joint.py``, ``motion/frames/solve.py``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError
from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Band
from sightline.motion.measure.predict import MovingCamera, StaticParameter

Array = NDArray[np.float64]


#: Degrees of the Legendre polynomials of a bent line; those below are its offset, rotation and scale. Lenses
#: bend lines in the second, their distortion stretches them in the third, and both go on in fourth and fifth.
BEND_DEGREES = (2, 3, 4, 5)
#: What the offsets of a band along and across the track are called.
ALONG, ACROSS = "offset along", "offset across"
#: Columns within which steps of a line and of its measure are seen as one.
ONE_STEP = 16


def band_statics(bands: Sequence[Band], *, alone: bool = False) -> list[StaticParameter]:
    """Offsets, rotation, scale and shape of each detector line; those with sigma 0 are left out.

    Parameters
    ----------
    bands : sequence of Band
        In the order of the cameras.
    alone : bool
        Also what bands have only beside others: the measure may not be among them.

    Notes
    -----
    The scale of all bands together is the height of the platform: the first band is the others' measure. What
    bends all lines alike is seen by no pair: the first band that is a line is the measure of the shapes, the
    first of all where none is; its steps are then the others'.
    """
    out = []
    measure = -1 if alone else measure_of_shapes(bands)
    for image, band in enumerate(bands):
        known = [
            (ALONG, "line_px", "px", band.offset_sigma_px, 0.1),
            (ACROSS, "column_px", "px", band.offset_sigma_px, 0.1),
            ("rotation", "rotation", "rad", band.rotation_sigma, 1e-4),
            ("scale", "scale", "", band.scale_sigma if image or alone else 0.0, 1e-4),
        ]
        out += [
            StaticParameter(f"{band.name} {name}", unit, float(sigma), step, _adjust(image, key), (image,))
            for name, key, unit, sigma, step in known
            if sigma > 0.0
        ]
        if band.shape in ("polynomial", "pieces") and image != measure and band.shape_sigma_px > 0.0:
            others = bands[measure] if measure >= 0 and bands[measure].shape == "pieces" else None
            out += _shape_statics(band, image, others)
    return out


def measure_of_shapes(bands: Sequence[Band]) -> int:
    """Number of the band beside which the shapes of the others are found."""
    return next((image for image, band in enumerate(bands) if band.shape in (None, "line")), 0)


def _with_shape_of(band: Band, statics: Mapping[str, float]) -> Band:
    """A band with the shape, and the columns of its steps, that the names of its statics say."""
    said = re.compile(re.escape(band.name) + r" (?:step \w+ at column|bend \w+ of degree) (\d+)")
    named = {name: said.fullmatch(name) for name in statics}
    steps = {int(one[1]) for name, one in named.items() if one and " step " in name.removeprefix(band.name)}
    if steps:
        return replace(band, shape="pieces", pieces=tuple(sorted(steps)))
    return replace(band, shape="polynomial") if any(named.values()) else band


def _shape_statics(band: Band, image: int, measure: Band | None) -> list[StaticParameter]:
    """Departures of a line from its directions, along and across: bends, or steps between its CCDs.

    Of a band in pieces also where those of the `measure` meet, whose steps are seen as its own.
    """
    columns = band.camera.columns
    u = 2.0 * np.arange(columns) / (columns - 1) - 1.0
    if band.shape == "polynomial":
        profiles = {f"bend {{}} of degree {n}": np.polynomial.Legendre.basis(n)(u) for n in BEND_DEGREES}
    else:
        borders = set(band.pieces)
        if measure is not None:
            ratio = columns / measure.camera.columns
            others = {round(border * ratio) for border in measure.pieces}
            borders |= {b for b in others if all(abs(b - own) >= ONE_STEP for own in band.pieces)}
        profiles = {}
        for border in sorted(borders):
            # about the mean: the offset stays that of the whole line
            beyond = (np.arange(columns) >= border).astype(np.float64)
            profiles[f"step {{}} at column {border}"] = beyond - beyond.mean()
    out = []
    for axis, key in (("along", "line_px"), ("across", "column_px")):
        whole = StaticParameter(f"{band.name} {axis}", "px", 1.0, 0.1, _adjust(image, key), (image,))
        for words, profile in profiles.items():
            name, change = f"{band.name} {words.format(axis)}", _adjust(image, key, profile)
            sigma = float(band.shape_sigma_px)
            out.append(StaticParameter(name, "px", sigma, 0.1, change, (image,), whole, profile))
    return out


def _adjust(
    image: int, key: str, profile: Array | None = None
) -> Callable[[Sequence[MovingCamera], float], list[MovingCamera]]:
    def apply(cameras: Sequence[MovingCamera], value: float) -> list[MovingCamera]:
        out = list(cameras)
        camera = out[image]
        if isinstance(camera, PushbroomCamera):
            if profile is None:
                detector = camera.detector.adjusted(**{key: value})
            else:
                detector = _departed(camera.detector, key, value * profile)
            out[image] = camera.with_detector(detector)
        return out

    return apply


def _departed(detector: LineDetector, key: str, px: Array) -> LineDetector:
    """A detector line whose columns depart by so many px each; EstimationError where it would turn back."""
    try:
        return detector.adjusted(**{key: px})  # type: ignore[arg-type]
    except InputError:
        raise EstimationError(
            f"steps between the CCDs of {detector.name!r}, found up to {np.abs(np.diff(px)).max():.2g} px, "
            "would have its columns overlap: check `pieces` and `shape_sigma_px`, or give CCDs that overlap "
            "by a pixel or more as bands of their own"
        ) from None


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
    found = [_with_shape_of(band, statics) for band in bands]
    parameters = band_statics(found, alone=True)
    values = np.array([statics.get(parameter.name, 0.0) for parameter in parameters])
    return tuple(c for c in apply_statics(moved, parameters, values) if isinstance(c, PushbroomCamera))
