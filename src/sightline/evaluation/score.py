"""A recovered motion against its truth: errors, NEES, coverage, per axis and in px.

What the images cannot show is left out of the comparison: the hidden directions are removed from
estimate and truth by one unweighted least-squares fit over all lines. The sigmas of a result are
those of the motion less its hidden part already, and are used as they are given.

Not here: reading the files (``io/results/hidden.py``, ``io/formats/tables.py``), printing (``cli/score.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError, SpanError, computes
from sightline.evaluation.consistency import consistency
from sightline.execution import slices
from sightline.geometry.checks import as_points, as_times, same_length
from sightline.geometry.trajectory import Motion
from sightline.result import Result, makes_result
from sightline.writing import let_go

if TYPE_CHECKING:  # reading a folder's score needs none of what made it
    from sightline.motion.results import LineOfSight

Array = NDArray[np.float64]

AXES = ("roll", "pitch", "yaw")

#: Part of a hidden direction from which what it brings on another axis is named; of its power that a straight
#: line, or a parabola, must explain to be called so.
NAMED_SHARE, CURVED_SHARE = 0.01, 0.95

#: Instants at which directions are fitted at a time.
AT_ONCE = 16384
#: Autocorrelation is summed up to this many of its own correlation times (Sokal's rule).
WINDOW_OF_CORRELATION = 5.0


@dataclass(frozen=True)
class AxisScore:
    """How one axis did, hidden part left out.

    Attributes
    ----------
    unit : str
        Of `rms`, `max` and `sigma`: "px", "px at the field edge", or "urad" without an ifov.
    rms, max : float
        Of the error.
    sigma : float
        Root mean square of the stated sigma.
    nees : float
        Mean over the lines of (error / sigma)^2: 1 when the sigma is true.
    effective_samples : float
        Independent samples that the mean of `nees` is worth.
    nees_low, nees_high : float
        Where `nees` falls 95 times in 100 when the sigma is true.
    coverage_95 : float
        Part of the lines whose error is within 1.96 sigma.
    """

    unit: str
    rms: float
    max: float
    sigma: float
    nees: float
    effective_samples: float
    nees_low: float
    nees_high: float
    coverage_95: float


@dataclass(frozen=True, repr=False)
class Score(Result):
    """A motion against its truth.

    Attributes
    ----------
    roll, pitch, yaw : AxisScore
    lines : int
        Compared.
    hidden, left_out : tuple of str
        Names of the directions that were removed, and these with what each brings on other axes.
    absolute : dict
        Axis -> score of the whole angle against its absolute sigma, where that is finite.
    """

    roll: AxisScore
    pitch: AxisScore
    yaw: AxisScore
    lines: int
    hidden: tuple[str, ...]
    left_out: tuple[str, ...]
    absolute: dict[str, AxisScore]

    @property
    def axes(self) -> dict[str, AxisScore]:
        """The three axes by name."""
        return {"roll": self.roll, "pitch": self.pitch, "yaw": self.yaw}

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and words, for JSON."""
        numbers = {name: dict(vars(axis)) for name, axis in self.axes.items()}
        whole = {name: dict(vars(axis)) for name, axis in self.absolute.items()}
        return {
            "lines": self.lines,
            "hidden_directions_removed": list(self.hidden),
            "left_out": list(self.left_out),
            **numbers,
            "absolute": whole,
        }


@makes_result
@computes("the score")
def score_motion(
    t: ArrayLike,
    angles: ArrayLike,
    sigma: ArrayLike,
    truth_t: ArrayLike,
    truth_angles: ArrayLike,
    *,
    hidden: ArrayLike | None = None,
    hidden_names: tuple[str, ...] | None = None,
    absolute_sigma: ArrayLike | None = None,
    ifov: float | None = None,
    half_field_px: float | None = None,
) -> Score:
    """Score of an estimated motion.

    Parameters
    ----------
    t : (N,)
        s; lines of the result.
    angles, sigma : (N, 3)
        rad; roll, pitch, yaw and the sigma of each less the hidden part.
    truth_t, truth_angles : (M,), (M, 3)
        The true motion; it is interpolated to `t` by local cubics and must cover it.
    hidden : (N, 3, H), optional
        Motions that the images cannot see, at `t`, of any size. By default a constant per axis.
    hidden_names : tuple of str, optional
        One per direction.
    absolute_sigma : (N, 3), optional
        rad; of the whole angle, hidden part included. Axes where it is finite everywhere are scored so too.
    ifov : float, optional
        rad; with it errors are given in px, yaw in px at the field's edge.
    half_field_px : float, optional
        px from the centre to the edge of the field; needed with `ifov`.

    Raises
    ------
    SpanError
        If the truth does not cover the result.
    """
    times = as_times(t, "t", increasing=True)
    estimate, stated = as_points(angles, "angles"), as_points(sigma, "sigma")
    same_length(times, "t", estimate, "angles")
    same_length(times, "t", stated, "sigma")
    _check_numbers(estimate, stated)
    truth = Motion(as_times(truth_t, "truth_t"), as_points(truth_angles, "truth_angles"))
    directions, names = _directions(hidden, hidden_names, len(times))
    units = _units(ifov, half_field_px)
    raw = estimate - at_lines(truth, times)
    error = less_hidden(raw, directions, ifov=ifov, half_field_px=half_field_px)
    scored = [_score_axis(error[:, x], stated[:, x], *units[x]) for x in range(3)]
    absolute = {}
    if absolute_sigma is not None:
        whole = np.asarray(absolute_sigma, dtype=np.float64)
        tied = [x for x in range(3) if np.isfinite(whole[:, x]).all()]
        absolute = {AXES[x]: _score_axis(raw[:, x], whole[:, x], *units[x]) for x in tied}
    words = words_of_hidden(names, times, directions, ifov=ifov, half_field_px=half_field_px)
    return Score(scored[0], scored[1], scored[2], len(times), names, words, absolute)


def score_result(result: LineOfSight, truth_t: ArrayLike, truth_angles: ArrayLike) -> Score:
    """Score of a recovery as it stands in memory; truth as of `score_motion`."""
    return score_motion(
        result.motion.t,
        result.motion.angles,
        result.sigma,
        truth_t,
        truth_angles,
        hidden=result.hidden,
        hidden_names=result.hidden_names,
        absolute_sigma=result.absolute_sigma,
        ifov=result.ifov,
        half_field_px=result.half_field / result.ifov,
    )


def at_lines(truth: Motion, t: Array) -> Array:
    """The true angles (N, 3) rad at the lines of a result, `t` (N,) s; SpanError unless it covers them."""
    if truth.t[0] > t[0] + 1e-9 or truth.t[-1] < t[-1] - 1e-9:
        raise SpanError(
            f"the truth spans [{truth.t[0]:.6g}, {truth.t[-1]:.6g}] s, the result [{t[0]:.6g}, "
            f"{t[-1]:.6g}] s; give a truth that covers every line of the result"
        )
    return np.asarray(truth.at(np.clip(t, truth.t[0], truth.t[-1])))


def less_hidden(
    angles: Array, directions: Array, *, ifov: float | None = None, half_field_px: float | None = None
) -> Array:
    """`angles` (N, 3) rad less their hidden part, a least-squares fit by `directions` (N, 3, H).

    One fit over all lines, unweighted in px (yaw at the field's edge; without an `ifov` in rad): in rad, the
    far larger yaw alone would decide it.
    """
    per_rad = np.array([factor for _, factor in _units(ifov, half_field_px)])
    return np.asarray(remove_directions(angles * per_rad, directions * per_rad[:, None]) / per_rad)


def words_of_hidden(
    names: Sequence[str],
    t: Array,
    directions: Array,
    *,
    ifov: float | None = None,
    half_field_px: float | None = None,
) -> tuple[str, ...]:
    """Hidden directions with what they bring on other axes: "drift of yaw (with a parabola of roll)".

    Parameters
    ----------
    names : sequence of str
        One per direction; each names the axis it is of.
    t : (N,)
        s; of the lines.
    directions : (N, 3, H)
        rad.
    ifov, half_field_px : float, optional
        As of `score_motion`.

    Notes
    -----
    What changes along the strip on another axis is named where it is `NAMED_SHARE` or more of the direction,
    in px: constants are hidden anyway.
    """
    per_rad = np.array([factor for _, factor in _units(ifov, half_field_px)])
    words = []
    for name, direction in zip(names, np.moveaxis(directions * per_rad[:, None], 2, 0), strict=True):
        whole = np.sqrt((direction**2).mean(axis=0).max())
        others = [x for x in range(3) if AXES[x] not in name and "axes" not in name]
        changing = direction - direction.mean(axis=0)
        tied = [x for x in others if np.sqrt((changing[:, x] ** 2).mean()) >= NAMED_SHARE * whole > 0.0]
        brought = " and ".join(f"a {_shape(t, changing[:, x])} of {AXES[x]}" for x in tied)
        words.append(f"{name} (with {brought})" if brought else name)
    return tuple(words)


def _shape(t: Array, values: Array) -> str:
    """What a curve (N,) of mean zero is: "drift", "parabola", or "curve"."""
    u = (t - t.mean()) / max(float(np.abs(t - t.mean()).max()), 1e-300)
    degrees = np.polynomial.legendre.legvander(u, min(2, len(t) - 1))
    basis, _ = np.linalg.qr(degrees)
    power = (basis.T @ values)[1:] ** 2 / (values @ values)
    if power.sum() < CURVED_SHARE:
        return "curve"
    return "parabola" if len(power) > 1 and power[1] > 1.0 - CURVED_SHARE else "drift"


def remove_directions(values: Array, directions: Array, unit: ArrayLike = 1.0) -> Array:
    """`values` (N, 3) less their unweighted least-squares fit by `directions` (N, 3, H) in a `unit` (3,).

    Directions that depend on each other, or are nothing, do no harm.
    """
    each = np.broadcast_to(np.asarray(unit, dtype=np.float64), (3,))[:, None]
    if len(values) > AT_ONCE:
        return _less_many(values, directions, each)
    basis = (directions / each).reshape(values.size, -1)
    size = np.linalg.norm(basis, axis=0)
    basis = basis[:, size > 0.0] / size[size > 0.0]
    u, s, _ = np.linalg.svd(basis, full_matrices=False)
    u = u[:, s > 1e-9]
    flat = values.ravel()
    return np.asarray((flat - u @ (u.T @ flat)).reshape(values.shape))


def _less_many(values: Array, directions: Array, unit: Array) -> Array:
    """The same of many instants, some at a time: their singular vectors are those of their triangles."""
    parts = slices(len(values), AT_ONCE)

    def basis(some: slice) -> Array:
        # nothing may be hidden: of no directions numpy does not tell how many rows are meant
        return np.asarray((directions[some] / unit).reshape(3 * len(values[some]), directions.shape[2]))

    size = np.sqrt(np.sum([(basis(some) ** 2).sum(axis=0) for some in parts], axis=0))
    used = np.flatnonzero(size > 0.0)
    triangles = [np.linalg.qr(basis(some)[:, used] / size[used], mode="r") for some in parts]
    _, s, vh = np.linalg.svd(np.concatenate(triangles), full_matrices=False)
    good = s > 1e-9
    onto = vh[good].T / s[good] / size[used, None]
    count = int(good.sum())
    square, beside = np.zeros((count, count)), np.zeros(count)
    for some in parts:
        u = basis(some)[:, used] @ onto
        square += u.T @ u
        beside += u.T @ values[some].ravel()
        let_go()
    # one but for rounding, which small singular values enlarge
    held = np.linalg.solve(square, beside)
    left = np.empty(values.shape)
    for some in parts:
        left[some] = values[some] - (basis(some)[:, used] @ (onto @ held)).reshape(-1, 3)
        let_go()
    return left


def constant_directions(lines: int) -> Array:
    """A constant per axis, (lines, 3, 3): what no difference of images can see."""
    return np.broadcast_to(np.eye(3), (lines, 3, 3)).copy()


def effective_samples(x: Array) -> float:
    """Independent samples that the mean of x^2 is worth, for a Gaussian series `x` (N,).

    Notes
    -----
    The autocorrelation of x^2 is the square of that of x: ``n / (1 + 2 sum of rho_k^2)``, summed up to the
    first k that exceeds five of the correlation times found so far (Sokal).
    """
    n = len(x)
    if n < 2 or not x.any():
        return float(n)
    spectrum = np.fft.rfft(x, 2 * n)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:n]
    rho = covariance / covariance[0]
    time = 1.0 + 2.0 * np.cumsum(rho[1:] ** 2)
    lag = np.arange(1, n)
    beyond = np.flatnonzero(lag >= WINDOW_OF_CORRELATION * time)
    return float(n / time[beyond[0] if len(beyond) else -1])


def _score_axis(error: Array, sigma: Array, unit: str, scale: float) -> AxisScore:
    normalised = error / sigma
    stated = consistency(normalised, effective_samples(normalised))
    return AxisScore(
        unit=unit,
        rms=float(np.sqrt(np.mean(error**2))) * scale,
        max=float(np.abs(error).max()) * scale,
        sigma=float(np.sqrt(np.mean(sigma**2))) * scale,
        nees=stated.nees,
        effective_samples=stated.samples,
        nees_low=stated.nees_low,
        nees_high=stated.nees_high,
        coverage_95=stated.coverage_95,
    )


def _units(ifov: float | None, half_field_px: float | None) -> list[tuple[str, float]]:
    """Name and factor from rad, of each axis."""
    if ifov is None:
        return [("urad", 1e6)] * 3
    if not (math.isfinite(ifov) and ifov > 0.0):
        raise InputError(f"`ifov` must be a positive angle of one pixel in rad, got {ifov}")
    if half_field_px is None or not half_field_px > 0.0:
        raise InputError(
            f"`half_field_px` must be a positive number of px, got {half_field_px}; yaw is scored at the "
            "field's edge: give half the number of columns, or leave `ifov` out to score in urad"
        )
    return [("px", 1.0 / ifov), ("px", 1.0 / ifov), ("px at the field edge", half_field_px)]


def _check_numbers(angles: Array, sigma: Array) -> None:
    for name, values in (("angles", angles), ("sigma", sigma)):
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise InputError(f"`{name}` must be finite on every line; line {row} is {values[row].tolist()}")
    if not (sigma > 0.0).all():
        row = int(np.flatnonzero((sigma <= 0.0).any(axis=1))[0])
        raise InputError(f"`sigma` must be positive on every line; line {row} is {sigma[row].tolist()}")


def _directions(
    hidden: ArrayLike | None, names: tuple[str, ...] | None, lines: int
) -> tuple[Array, tuple[str, ...]]:
    if hidden is None:
        return constant_directions(lines), tuple(f"constant {axis}" for axis in AXES)
    directions = np.asarray(hidden, dtype=np.float64)
    if directions.ndim != 3 or directions.shape[:2] != (lines, 3):
        raise InputError(
            f"`hidden` must have shape ({lines}, 3, H): lines, axes, directions; got {directions.shape}"
        )
    if not np.isfinite(directions).all():
        raise InputError("`hidden` must be finite on every line")
    if names is None:
        names = tuple(f"direction {k}" for k in range(directions.shape[2]))
    if len(names) != directions.shape[2]:
        raise InputError(f"`hidden_names` has {len(names)} names for {directions.shape[2]} directions")
    return directions, names
