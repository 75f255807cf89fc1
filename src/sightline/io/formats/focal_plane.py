"""Focal planes of USGS CSM sensor models: from pixels of an image to directions, lens distortion removed.

Formulas as the library ``usgscsm`` (file Distortion.cpp) computes them, and that of THEMIS-IR as ISIS does
(ThemisIrDistortionMap.cpp): coordinates in the focal plane in mm, d with the lens' distortion, u without.

Not here: times, positions and attitudes (``isd.py``), detectors (``geometry/instrument.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError, InputError
from sightline.io.formats.csm_keys import CsmKeys

Array = NDArray[np.float64]

#: Turns of an iteration that undoes a distortion, and mm below which it has come to its end.
_TURNS, _CLOSE = 60, 1e-12
#: Terms of a transverse distortion, and coefficients of the others.
_TRANSVERSE = 10


@dataclass(frozen=True)
class Distortion:
    """One of the distortions of CSM.

    Attributes
    ----------
    number : int or None
        By which model states know it.
    keys : tuple of (str, int)
        Keys of an ISD with as many numbers, in the order of a model state.
    undistorted : callable
        From x, y (mm), coefficients and focal length (mm) to x, y without distortion.
    """

    number: int | None
    keys: tuple[tuple[str, int], ...]
    undistorted: Callable[[Array, Array, Array, float], tuple[Array, Array]]

    @property
    def count(self) -> int:
        """How many coefficients there are."""
        return sum(size for _, size in self.keys)


def _radial(x: Array, y: Array, k: Array, _: float) -> tuple[Array, Array]:
    """u = d (1 - k0 - k1 r^2 - k2 r^4), r of d."""
    r2 = x**2 + y**2
    keep = 1.0 - (k[0] + r2 * (k[1] + r2 * k[2]))
    return x * keep, y * keep


def _lrolrocnac(x: Array, y: Array, k: Array, _: float) -> tuple[Array, Array]:
    """u_y = d_y / (1 + k d_y^2)."""
    return x, y / (1.0 + k[0] * y**2)


def _kaguyalism(x: Array, y: Array, k: Array, _: float) -> tuple[Array, Array]:
    """u = d + boresight + a0 + a1 r + a2 r^2 + a3 r^3, r of d; order: boresight x, x, boresight y, y."""
    r = np.hypot(x, y)
    powers = np.stack([np.ones_like(r), np.ones_like(r), r, r**2, r**3])
    return x + k[:5] @ powers, y + k[5:] @ powers


def _cahvor(x: Array, y: Array, k: Array, focal: float) -> tuple[Array, Array]:
    """Radial about a centre (k3, k4)."""
    u, v = _radial(x - k[3], y - k[4], k[:3], focal)
    return u + k[3], v + k[4]


def _themisir(x: Array, y: Array, k: Array, _: float) -> tuple[Array, Array]:
    """d_x = k u_x; d_y = (1 + alpha1) u_y + alpha2 u_y^2."""
    alpha1, alpha2, scale = k
    inside = (1.0 + alpha1) ** 2 + 4.0 * alpha2 * y
    if scale == 0.0 or (inside < 0.0).any():
        raise InputError("distortion 'themisir' has no inverse with these coefficients")
    return x / scale, 2.0 * y / (1.0 + alpha1 + np.sqrt(inside))


def _dawnfc(x: Array, y: Array, k: Array, _: float) -> tuple[Array, Array]:
    """d = u (1 + k r^2), r of u."""
    return _inverse(
        lambda u, v: (u * (1.0 + k[0] * (u * u + v * v)), v * (1.0 + k[0] * (u * u + v * v))), x, y
    )


def _transverse(x: Array, y: Array, k: Array, _: float) -> tuple[Array, Array]:
    """d = polynomials of u of degree 3: 1, x, y, x^2, xy, y^2, x^3, x^2 y, x y^2, y^3; for x, then for y."""

    def distorted(u: Array, v: Array) -> tuple[Array, Array]:
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3])
        return k[:_TRANSVERSE] @ terms, k[_TRANSVERSE:] @ terms

    return _inverse(distorted, x, y)


def _radtan(x: Array, y: Array, k: Array, focal: float) -> tuple[Array, Array]:
    """Brown-Conrady in tangents, order k1, k2, p1, p2, k3, as of OpenCV: d of u."""
    k1, k2, p1, p2, k3 = k

    def distorted(u: Array, v: Array) -> tuple[Array, Array]:
        r2 = u * u + v * v
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
            v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
        )

    u, v = _inverse(distorted, x / focal, y / focal)
    return u * focal, v * focal


def _inverse(
    distorted: Callable[[Array, Array], tuple[Array, Array]], x: Array, y: Array
) -> tuple[Array, Array]:
    """What `distorted` takes to x, y: Newton's method, derivatives by differences."""
    u, v, h = x.copy(), y.copy(), 1e-6
    for _ in range(_TURNS):
        a, b = distorted(u, v)
        (ax, bx), (ay, by) = distorted(u + h, v), distorted(u, v + h)
        jxx, jxy, jyx, jyy = (ax - a) / h, (ay - a) / h, (bx - b) / h, (by - b) / h
        with np.errstate(all="ignore"):
            det = jxx * jyy - jxy * jyx
            du = (jyy * (x - a) - jxy * (y - b)) / det
            dv = (jxx * (y - b) - jyx * (x - a)) / det
        if not (np.isfinite(du).all() and np.isfinite(dv).all()):
            break
        u, v = u + du, v + dv
        if max(np.abs(du).max(), np.abs(dv).max()) < _CLOSE * max(
            1.0, float(np.abs(x).max()), np.abs(y).max()
        ):
            return u, v
    raise InputError("the distortion has no inverse over the whole image; are its coefficients in mm?")


#: Distortions by their names in ISDs.
DISTORTIONS = {
    "radial": Distortion(0, (("coefficients", 3),), _radial),
    "transverse": Distortion(1, (("x", _TRANSVERSE), ("y", _TRANSVERSE)), _transverse),
    "kaguyalism": Distortion(2, (("boresight_x", 1), ("x", 4), ("boresight_y", 1), ("y", 4)), _kaguyalism),
    "dawnfc": Distortion(3, (("coefficients", 1),), _dawnfc),
    "lrolrocnac": Distortion(4, (("coefficients", 1),), _lrolrocnac),
    "cahvor": Distortion(5, (("coefficients", 5),), _cahvor),
    "radtan": Distortion(7, (("coefficients", 5),), _radtan),
    "themisir": Distortion(None, (("p_alpha1", 1), ("p_alpha2", 1), ("p_k", 1)), _themisir),
}
#: Why a distortion cannot be read though its name is known.
_UNREADABLE = {
    "legendre": "the file holds neither the half widths of the focal plane that its polynomials are scaled "
    "by, nor the residuals that complete them",
    "lunarorbiter": "it is that of a film camera, not of a detector line",
}


@dataclass(frozen=True, eq=False)
class CsmFocalPlane:
    """Where detector pixels lie behind the lens (mm), after CSM.

    Attributes
    ----------
    focal_length : float
        mm.
    lines_from_x, samples_from_x : (3,)
        Detector line, sample = a + b x + c y.
    centre, starting : (float, float)
        Detector line and sample of the principal point, and of the image's first.
    sample_summing, line_summing : float
        Detector pixels in one of the image.
    distortion : str
        A key of DISTORTIONS, or "none".
    coefficients : (n,)
    z_direction : float
        1, or -1 where the focal plane is seen from behind.
    """

    focal_length: float
    lines_from_x: Array
    samples_from_x: Array
    centre: tuple[float, float]
    starting: tuple[float, float]
    sample_summing: float = 1.0
    line_summing: float = 1.0
    distortion: str = "none"
    coefficients: Array = None  # type: ignore[assignment]
    z_direction: float = 1.0

    def mm(self, line: Array, sample: Array) -> tuple[Array, Array]:
        """Focal-plane coordinates x, y (mm), with distortion, of detector lines and samples."""
        matrix = np.array([self.lines_from_x[1:], self.samples_from_x[1:]])
        if abs(np.linalg.det(matrix)) <= 1e-12 * np.abs(matrix).max() ** 2:
            raise InputError(
                f"focal2pixel_lines {self.lines_from_x.tolist()} and focal2pixel_samples "
                f"{self.samples_from_x.tolist()} leave pixels no place of their own in the focal plane"
            )
        shift = np.stack(
            [line - self.centre[0] - self.lines_from_x[0], sample - self.centre[1] - self.samples_from_x[0]]
        )
        x, y = np.linalg.solve(matrix, shift.reshape(2, -1))
        return x, y

    def directions(self, line: Array, sample: Array) -> Array:
        """(N, 3) looking directions, sensor axes, z = 1, of detector lines and samples (N,)."""
        x, y = self.mm(line, sample)
        if self.distortion != "none":
            x, y = DISTORTIONS[self.distortion].undistorted(x, y, self.coefficients, self.focal_length)
        scale = self.z_direction / self.focal_length
        return np.column_stack([x * scale, y * scale, np.ones(len(x))])

    def row(self, samples: int) -> Array:
        """(samples, 3) directions of the columns of a line scanner's image.

        The centre of the first pixel is sample 0.5; the detector line of a line scanner is the starting one.
        """
        return self.directions(np.full(samples, self.starting[0]), self._samples(samples))

    def _samples(self, samples: int) -> Array:
        """Detector samples of the columns of an image."""
        columns = np.arange(samples, dtype=np.float64)
        return (columns + 0.5) * self.sample_summing + self.starting[1]

    def turned_over(self, samples: int) -> tuple[float, float] | None:
        """mm of a pixel from the axis before and after its distortion, if that takes it across the axis."""
        x, y = self.mm(np.full(samples, self.starting[0]), self._samples(samples))
        seen = self.row(samples)[:, :2] * self.focal_length * self.z_direction
        across = x * seen[:, 0] + y * seen[:, 1] < 0.0
        if self.distortion != "radial" or not across.any():
            return None
        worst = int(np.argmax(across * np.hypot(x, y)))
        return float(np.hypot(x, y)[worst]), float(np.linalg.norm(seen[worst]))


def isd_plane(data: CsmKeys) -> CsmFocalPlane:
    """Focal plane of an ISD."""
    name, coefficients = _isd_distortion(data)
    return CsmFocalPlane(
        data.positive("focal_length_model.focal_length"),
        data.array("focal2pixel_lines", 3),
        data.array("focal2pixel_samples", 3),
        (data.number("detector_center.line"), data.number("detector_center.sample")),
        (data.number("starting_detector_line"), data.number("starting_detector_sample")),
        data.positive("detector_sample_summing"),
        data.positive("detector_line_summing") if data.has("detector_line_summing") else 1.0,
        name,
        coefficients,
    )


def _isd_distortion(data: CsmKeys) -> tuple[str, Array]:
    """Name and coefficients of an ISD's distortion; those that are left out at the end are 0."""
    table = data.value("optical_distortion", None) or {}
    if not isinstance(table, dict):
        raise data.refused("optical_distortion", "is no table")
    name = next(iter(table), "none")
    if name == "none":
        return name, np.empty(0)
    if name not in DISTORTIONS:
        why = f": {_UNREADABLE[name]}" if name in _UNREADABLE else ""
        raise FormatError(
            f"{data.path}: optical_distortion {name!r:.40} is not read{why}; "
            f"{', '.join(DISTORTIONS)} or none are"
        )
    parts = []
    for key, size in DISTORTIONS[name].keys:
        where = f"optical_distortion.{name}.{key}"
        given = data.numbers(where)
        short = name in ("transverse", "kaguyalism") and len(given) < size
        if len(given) != size and not short:
            raise data.refused(where, f"has {len(given)} coefficients, not {size}")
        parts.append(np.pad(given, (0, size - len(given))))
    return name, np.concatenate(parts)


def state_plane(data: CsmKeys) -> CsmFocalPlane:
    """Focal plane of a model state."""
    number = data.count("m_distortionType", 0, 1000)
    names = {d.number: name for name, d in DISTORTIONS.items() if d.number is not None}
    if number not in names:
        raise FormatError(
            f"{data.path}: m_distortionType {number} is not read; "
            f"{', '.join(f'{n} ({name})' for n, name in names.items())} are"
        )
    name = names[number]
    coefficients = data.numbers("m_opticalDistCoeffs")
    if len(coefficients) != DISTORTIONS[name].count:
        raise data.refused(
            "m_opticalDistCoeffs",
            f"has {len(coefficients)} coefficients; distortion {name!r} has {DISTORTIONS[name].count}",
        )
    z = data.number("m_zDirection") if data.has("m_zDirection") else 1.0
    if z not in (1.0, -1.0):
        raise data.refused("m_zDirection", f"is {z:g}, neither 1 nor -1")
    return CsmFocalPlane(
        data.positive("m_focalLength"),
        data.array("m_iTransL", 3),
        data.array("m_iTransS", 3),
        (data.number("m_detectorLineOrigin"), data.number("m_detectorSampleOrigin")),
        (data.number("m_startingDetectorLine"), data.number("m_startingDetectorSample")),
        data.positive("m_detectorSampleSumming"),
        data.positive("m_detectorLineSumming") if data.has("m_detectorLineSumming") else 1.0,
        name,
        coefficients,
        z,
    )
