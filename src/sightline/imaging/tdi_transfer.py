"""What a TDI column makes of a sinusoidal scene that drifts against its clock.

Lengths are in pixels along the track, times in line periods, frequencies in cycles per pixel. A column sums
`stages` exposures one line period apart. The image moves `velocity` pixels per line period along the column
(1: in step with the clock) and `velocity tan(slip)` across it; the first `head_stages` lines integrate for
`head_ratio` of the line period, the others for `ratio`.

Not here: optics, pixel and diffusion (``mtf.py``), noise (``tdi_noise.py``).

Source: EP2733929, equations of the MTF; its drift per stage and its mean of the exposures are corrected here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Align = Literal["centre", "start", "end"]

#: Where in its line period a stage is exposed: `align` times half the exposure after the line's centre.
ALIGNMENTS: dict[str, float] = {"centre": 0.0, "start": 0.5, "end": -0.5}
#: Gauss-Legendre points per exposure; 8 suffice for motion that is smooth within a line period.
POINTS = 8


@dataclass(frozen=True)
class Exposure:
    """How the stages of a column are exposed.

    Attributes
    ----------
    head_stages : int
        First stages, whose integration ratio is fixed; their signal is what the others are set by. 0: none.
    head_ratio : float
        Integration time of each over the line period.
    align : str
        ``"centre"``, ``"start"`` or ``"end"``: where in the line period the exposures lie.
    """

    head_stages: int = 0
    head_ratio: float = 0.0
    align: str = "centre"

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.align not in ALIGNMENTS:
            raise InputError(f"`align` is {self.align!r}; allowed are {', '.join(ALIGNMENTS)}")
        if self.head_stages < 0:
            raise InputError(f"`head_stages` is {self.head_stages}; a number of stages is 0 or more")
        if self.head_stages and not 0.0 < self.head_ratio <= 1.0:
            raise InputError(
                f"`head_ratio` is {self.head_ratio:g}; it is a share of the line period, above 0 to 1"
            )

    def total(self, stages: ArrayLike, ratio: ArrayLike) -> Array:
        """Integration time of all stages together, line periods."""
        stages, ratio = np.asarray(stages, dtype=np.float64), np.asarray(ratio, dtype=np.float64)
        head = np.minimum(stages, self.head_stages)
        return np.asarray(head * self.head_ratio + (stages - head) * ratio)


def phases(velocity: ArrayLike, slip: ArrayLike, fx: float, fy: float) -> tuple[Array, Array]:
    """Cycles that the image of a sinusoid advances per line period: past a pixel at rest, and past the clock.

    Parameters
    ----------
    velocity : array_like
        Pixels per line period along the column.
    slip : array_like
        rad; angle of the motion to the column.
    fx, fy : float
        Cycles per pixel, across and along the column.
    """
    velocity = np.asarray(velocity, dtype=np.float64)
    across = velocity * np.tan(np.asarray(slip, dtype=np.float64))
    return np.asarray(across * fx + velocity * fy), np.asarray(across * fx + (velocity - 1.0) * fy)


def dirichlet(count: ArrayLike, phase: ArrayLike) -> Array:
    """Mean of `count` unit vectors `phase` cycles apart, seen from their middle: sin(pi n p) / (n sin(pi p)).

    At whole numbers p it is +1 or -1.
    """
    n, p = np.broadcast_arrays(np.asarray(count, dtype=np.float64), np.asarray(phase, dtype=np.float64))
    whole = np.round(p)
    rest = p - whole
    # sin(pi n p) = (-1)^(n whole) sin(pi n rest), sin(pi p) = (-1)^whole sin(pi rest)
    sign = 1.0 - 2.0 * np.mod(whole * (n - 1.0), 2.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.sinc(n * rest) / np.sinc(rest)
    return np.asarray(sign * ratio)


def _run(count: Array, phase: Array) -> Complex:
    """Sum over k = 0 .. count - 1 of exp(-2 pi i k phase)."""
    some = np.maximum(count, 1.0)
    total = some * dirichlet(some, phase) * np.exp(-1j * np.pi * (some - 1.0) * phase)
    return np.asarray(np.where(count > 0.0, total, 0.0))


def drift_transfer(
    stages: ArrayLike,
    ratio: ArrayLike,
    velocity: ArrayLike,
    slip: ArrayLike,
    fx: float,
    fy: float,
    exposure: Exposure | None = None,
) -> Complex:
    """Transfer function of a column under constant drift; its magnitude is the MTF of motion.

    Parameters
    ----------
    stages, ratio, velocity, slip : array_like
        Number of stages; integration ratio of those beyond the head; pixels per line period; rad. Broadcast
        against one another.
    fx, fy : float
        Cycles per pixel.
    exposure : Exposure, optional
        No head by default.

    Returns
    -------
    complex array
        1 at frequency 0. Its phase over 2 pi f is where the line is displaced to.

    Notes
    -----
    Exact for any mix of exposures: each stage integrates its own sinc of the motion past a pixel at rest,
    stages add with the phase they slip against the clock, weighted by their exposure.
    """
    exposure = exposure or Exposure()
    psi, phi = phases(velocity, slip, fx, fy)
    n, kt = np.asarray(stages, dtype=np.float64), np.asarray(ratio, dtype=np.float64)
    head = np.minimum(n, exposure.head_stages)
    shift = ALIGNMENTS[exposure.align]

    def stage(length: Array) -> Complex:
        return np.asarray(length * np.sinc(length * psi) * np.exp(-2j * np.pi * shift * length * psi))

    first = stage(np.asarray(exposure.head_ratio)) * _run(head, phi)
    rest = stage(kt) * np.exp(-2j * np.pi * head * phi) * _run(n - head, phi)
    return np.asarray((first + rest) / exposure.total(n, kt))


def patent_transfer(
    stages: ArrayLike,
    ratio: ArrayLike,
    velocity: ArrayLike,
    slip: ArrayLike,
    fx: float,
    fy: float,
    exposure: Exposure | None = None,
) -> Array:
    """MTF of motion and desynchronisation as EP2733929 has it, its misprints corrected; for comparison.

    Its drift per stage is multiplied by the mean integration ratio, which flatters short exposures
    (stages are a whole period apart, however long each integrates); arguments as of :func:`drift_transfer`.
    """
    exposure = exposure or Exposure()
    n = np.asarray(stages, dtype=np.float64)
    mean = exposure.total(n, ratio) / n
    across = np.tan(np.asarray(slip, dtype=np.float64)) * mean * fx
    along = (np.asarray(velocity, dtype=np.float64) - 1.0) * mean * fy
    return np.asarray(np.sinc(mean * fy) * np.abs(dirichlet(n, across) * dirichlet(n, along)))


def jitter_transfer(
    stages: ArrayLike,
    ratio: ArrayLike,
    velocity: ArrayLike,
    slip: ArrayLike,
    fx: float,
    fy: float,
    amplitude: tuple[float, float],
    frequency: float,
    phase: ArrayLike = 0.0,
) -> Complex:
    """Transfer function under constant drift and a sinusoidal jitter; centred exposures, no head.

    Parameters
    ----------
    stages, ratio, velocity, slip, fx, fy
        As of :func:`drift_transfer`.
    amplitude : (float, float)
        Pixels across and along the column.
    frequency : float
        Cycles per line period.
    phase : array_like
        rad of the jitter at the middle of stage 0.

    Notes
    -----
    Jacobi-Anger: the jitter spreads the sinusoid over orders m, each a drift of its own.
    """
    from scipy.special import jv

    psi, phi = phases(velocity, slip, fx, fy)
    n, kt, alpha = (np.asarray(v, dtype=np.float64) for v in (stages, ratio, phase))
    z = 2.0 * np.pi * (fx * amplitude[0] + fy * amplitude[1])
    orders = int(np.ceil(abs(z))) + 20
    total = np.zeros(np.broadcast_shapes(n.shape, kt.shape, psi.shape, alpha.shape), dtype=np.complex128)
    for m in range(-orders, orders + 1):
        step = phi + m * frequency
        turn = np.exp(-1j * (m * alpha + np.pi * (n - 1.0) * step))
        total = total + jv(m, z) * turn * np.sinc(kt * (psi + m * frequency)) * dirichlet(n, step)
    return total


def motion_transfer(
    stages: int,
    ratio: ArrayLike,
    velocity: float,
    slip: float,
    fx: float,
    fy: float,
    displacement: Array,
    start: float,
    exposure: Exposure | None = None,
) -> Complex:
    """Transfer functions under drift and a measured motion, for every number of stages up to `stages`.

    Parameters
    ----------
    stages : int
    ratio : (R,)
        Integration ratios.
    velocity, slip, fx, fy : float
        As of :func:`drift_transfer`.
    displacement : (M, 2)
        Pixels across and along the column beyond the drift, at line periods 0, 1, ... M - 1; linear between.
    start : float
        Line periods; when stage 0 of the line is centred.
    exposure : Exposure, optional

    Returns
    -------
    (R, stages) complex
        Entry [r, n - 1] is that of n stages.

    Raises
    ------
    InputError
        If the motion does not cover the stages.
    """
    exposure = exposure or Exposure()
    ratios = np.atleast_1d(np.asarray(ratio, dtype=np.float64))
    if start < 0.5 or start + stages > len(displacement) - 0.5:
        raise InputError(
            f"the motion covers line periods 0 to {len(displacement) - 1}, the stages need {start - 0.5:g} "
            f"to {start + stages - 0.5:g}; give a longer motion, or fewer stages"
        )
    node, weight = np.polynomial.legendre.leggauss(POINTS)
    k = np.arange(stages)
    lengths = np.where(k < exposure.head_stages, exposure.head_ratio, ratios[:, None])  # (R, stages)
    u = lengths[..., None] * (0.5 * node + ALIGNMENTS[exposure.align])  # (R, stages, points)
    across = velocity * np.tan(slip)
    at = start + k[:, None] + u
    moved = [np.interp(at, np.arange(len(displacement)), displacement[:, c]) for c in range(2)]
    x = across * (k[:, None] + u) + moved[0]
    y = (velocity - 1.0) * k[:, None] + velocity * u + moved[1]
    per_stage = lengths * (np.exp(-2j * np.pi * (fx * x + fy * y)) @ (0.5 * weight))
    return np.asarray(np.cumsum(per_stage, axis=1) / np.cumsum(lengths, axis=1))
