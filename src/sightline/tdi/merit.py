"""What every setting makes of the image: one factor by the column's MTF, one by the signal's SNR.

The merit of a setting is their product, and so are its allowances: a factor is zero where a limit forbids the
setting. That makes a choice over columns x signals x settings cheap.

Not here: the best setting of each cell (``choose.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.imaging.tdi_noise import summed_signal
from sightline.imaging.tdi_transfer import ALIGNMENTS, Exposure, phases
from sightline.tdi.kernels import exact_mtf, patent_mtf, snr_of_settings
from sightline.tdi.setting import ChoiceRules, Index, ScanColumns, TdiDetector, TdiGrid

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Draws of velocity and slip from their covariance (a power of two: a Sobol sequence).
DRAWS = 64
#: Columns whose draws are held at once.
DRAWN_COLUMNS = 16
#: Nodes of the signal's own uncertainty.
SIGNAL_NODES = 9
#: Without a quantile, a signal that high in its distribution must not saturate.
HIGH_SIGNAL = 0.95


class ColumnMtf(Protocol):
    """MTF of the motion of every setting, for some columns."""

    @property
    def columns(self) -> ScanColumns:
        """All columns."""
        ...

    def central(self, which: slice | Index) -> Array:
        """(c, P, 2) MTF of motion across and along, as expected."""
        ...

    @property
    def nodes_per_draw(self) -> int:
        """Nodes in a row that are lines of one and the same strip: its merit is their mean."""
        ...

    def drawn(self, which: slice | Index) -> Array | None:
        """(M, c, P, 2) MTF of motion as it may be, equally likely; None where it is known."""
        ...

    def robust_merit(self, which: slice | Index, rules: ChoiceRules) -> Array | None:
        """(c, P) factor of the merit by mean or quantile of what may be; None where all is known."""
        ...


@dataclass(frozen=True, eq=False)
class DriftMtf:
    """MTF of constant drift, by a column's velocity and slip.

    Attributes
    ----------
    columns : ScanColumns
    grid : TdiGrid
    exposure : Exposure
    rules : ChoiceRules
    """

    columns: ScanColumns
    grid: TdiGrid
    exposure: Exposure
    rules: ChoiceRules

    @property
    def nodes_per_draw(self) -> int:
        """One: a constant drift is that of every line."""
        return 1

    def central(self, which: slice | Index) -> Array:
        """(c, P, 2) MTF at the velocity and slip given."""
        return self._mtf(self.columns.velocity[which], self.columns.slip[which])

    def drawn(self, which: slice | Index) -> Array | None:
        """(M, c, P, 2) MTF at velocities and slips drawn from their covariance; None without one."""
        covariance = self.columns.covariance
        if covariance is None or not covariance.any():
            return None
        root = square_root(covariance[which])
        offsets = np.einsum("cij,mj->mci", root, normal_draws(2))
        velocity, slip = (
            self.columns.velocity[which] + offsets[..., 0],
            self.columns.slip[which] + offsets[..., 1],
        )
        return self._mtf(velocity.ravel(), slip.ravel()).reshape(*velocity.shape, len(self.grid), 2)

    def robust_merit(self, which: slice | Index, rules: ChoiceRules) -> Array | None:
        """(c, P) factor of the merit by mean or quantile of the draws; None without a covariance."""
        return robust_merit(self, which, rules)

    def _mtf(self, velocity: Array, slip: Array) -> Array:
        out = np.empty((len(velocity), len(self.grid), 2))
        kernel = exact_mtf if self.rules.model == "exact" else patent_mtf
        fx, fy = map(float, self.rules.frequencies)
        kernel(
            np.ascontiguousarray(velocity), np.ascontiguousarray(slip), fx, fy,
            self.grid.stages, self.grid.ratios, self.exposure.head_stages, float(self.exposure.head_ratio),
            ALIGNMENTS[self.exposure.align], out,
        )  # fmt: skip
        return out


@dataclass(frozen=True, eq=False)
class SomeColumns:
    """A few columns of a model as a model of their own.

    Attributes
    ----------
    model : ColumnMtf
    which : (c,) int
        Columns, counted from the first.
    """

    model: ColumnMtf
    which: Index

    @property
    def columns(self) -> ScanColumns:
        """The few."""
        return self.model.columns.part(self.which)

    def central(self, which: slice | Index) -> Array:
        """(c, P, 2) as the model gives it."""
        return self.model.central(self.which[which])

    @property
    def nodes_per_draw(self) -> int:
        """As of the model."""
        return self.model.nodes_per_draw

    def drawn(self, which: slice | Index) -> Array | None:
        """(M, c, P, 2) as the model gives it."""
        return self.model.drawn(self.which[which])

    def robust_merit(self, which: slice | Index, rules: ChoiceRules) -> Array | None:
        """(c, P) as the model gives it."""
        return self.model.robust_merit(self.which[which], rules)


def normal_draws(dimensions: int, count: int = DRAWS) -> Array:
    """(count, dimensions) points spread like independent unit normals, always the same."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    untyped: Any = qmc.Sobol
    points = untyped(dimensions, scramble=True, rng=np.random.default_rng(0)).random(count)
    return np.asarray(ndtri(points), dtype=np.float64)


def square_root(covariance: Array) -> Array:
    """(N, K, K) roots of covariances that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


def mtf_merit(mtf: Array, merit: str) -> Array:
    """What the two MTFs (..., 2) give to the merit, shape (...)."""
    x, y = mtf[..., 0], mtf[..., 1]
    match merit:
        case "geomean":
            return np.asarray(np.sqrt(x * y))
        case "mean":
            return np.asarray(0.5 * (x + y))
        case "min":
            return np.asarray(np.minimum(x, y))
        case "x":
            return np.asarray(x)
        case "y":
            return np.asarray(y)
    return np.asarray(x * y)


@dataclass(frozen=True, eq=False)
class ColumnFactors:
    """The part of the merit that columns give.

    Attributes
    ----------
    mtf : (c, P, 2)
        Of the whole system, as expected.
    merit : (c, P)
        Factor of the merit: expected, or a quantile of it.
    in_lobe, in_bounds : (c, P) bool
        Within the main lobe; within the bounds of the MTF.
    """

    mtf: Array
    merit: Array
    in_lobe: Flags
    in_bounds: Flags

    @property
    def allowed(self) -> Array:
        """(c, P) merit, zero where the column forbids the setting."""
        return np.asarray(np.where(self.in_lobe & self.in_bounds, self.merit, 0.0))


def column_factors(
    model: ColumnMtf, which: slice | Index, grid: TdiGrid, rules: ChoiceRules
) -> ColumnFactors:
    """The part of the merit that some columns give to every setting."""
    columns = model.columns.part(which)
    static = columns.static_mtf[:, None, :]
    # by rounding a mean of unit vectors may be longer than 1: no reason for `mtf_max` = 1 to refuse it
    mtf: Array = np.minimum(model.central(which), 1.0) * static
    merit = model.robust_merit(which, rules)
    if merit is None:
        merit = mtf_merit(mtf, rules.merit)
    in_bounds = np.asarray(((mtf >= rules.mtf_min) & (mtf <= rules.mtf_max)).all(axis=-1))
    return ColumnFactors(mtf, np.asarray(merit), main_lobe(columns, grid, rules), in_bounds)


def robust_merit(model: ColumnMtf, which: slice | Index, rules: ChoiceRules) -> Array | None:
    """(c, P) factor of the merit by mean or quantile of what may be; None where all is known."""
    parts = []
    wanted = np.arange(len(model.columns))[which]
    for begin in range(0, len(wanted), DRAWN_COLUMNS):
        each = drawn_merit(model, wanted[begin : begin + DRAWN_COLUMNS], rules)
        if each is None:
            return None
        parts.append(
            each.mean(axis=0) if rules.quantile is None else np.quantile(each, rules.quantile, axis=0)
        )
    return np.concatenate(parts)


def drawn_merit(model: ColumnMtf, which: slice | Index, rules: ChoiceRules) -> Array | None:
    """(E, c, P) factor of the merit that columns give at every draw, mean over its lines; None if known."""
    drawn = model.drawn(which)
    if drawn is None:
        return None
    each = mtf_merit(drawn * model.columns.static_mtf[which][:, None, :], rules.merit)
    return np.asarray(each.reshape(-1, model.nodes_per_draw, *each.shape[1:]).mean(axis=1))


def main_lobe(columns: ScanColumns, grid: TdiGrid, rules: ChoiceRules) -> Flags:
    """(c, P) whether the stages of a setting slip by no more than a cycle in all, or all where not asked."""
    stages, _ = grid.settings
    if not rules.main_lobe_only:
        return np.ones((len(columns), len(stages)), dtype=bool)
    fx, fy = rules.frequencies
    across = phases(columns.velocity, columns.slip, fx, 0.0)[1]
    along = phases(columns.velocity, columns.slip, 0.0, fy)[1]
    slipped = np.maximum(np.abs(across), np.abs(along))
    return np.asarray(stages * slipped[:, None] <= 1.0)


@dataclass(frozen=True, eq=False)
class SignalFactors:
    """The part of the merit that signals give.

    Attributes
    ----------
    snr : (S, P)
        As expected.
    merit : (S, P)
        Factor of the merit: expected SNR, or that of a quantile of the signal.
    unsaturated, clear : (S, P) bool
        Below the full wells; at or above the least SNR.
    """

    snr: Array
    merit: Array
    unsaturated: Flags
    clear: Flags

    @property
    def allowed(self) -> Array:
        """(S, P) merit, zero where the signal forbids the setting."""
        return np.asarray(np.where(self.unsaturated & self.clear, self.merit, 0.0))


def signal_factors(signals: Array, grid: TdiGrid, detector: TdiDetector, rules: ChoiceRules) -> SignalFactors:
    """The part of the merit that signals (S,) give to every setting."""
    from scipy.special import ndtri

    at = _snr_of(signals, grid, detector)
    merit = at
    sigma = rules.signal_sigma
    if sigma > 0.0:
        quantile = rules.quantile
        if quantile is None:
            node, weight = np.polynomial.hermite_e.hermegauss(SIGNAL_NODES)
            merit = np.zeros_like(at)
            for z, w in zip(node, weight / weight.sum(), strict=True):
                merit += w * _snr_of(np.maximum(signals * (1.0 + sigma * z), 0.0), grid, detector)
        else:
            merit = _snr_of(np.maximum(signals * (1.0 + sigma * ndtri(quantile)), 0.0), grid, detector)
    return SignalFactors(at, merit, unsaturated(signals, grid, detector, rules), at >= rules.snr_min)


def _headroom(rules: ChoiceRules) -> float:
    """Factor by which a signal may be higher than expected; wells hold that much."""
    from scipy.special import ndtri

    if rules.signal_sigma <= 0.0:
        return 1.0
    share = HIGH_SIGNAL if rules.quantile is None else 1.0 - rules.quantile
    return float(1.0 + rules.signal_sigma * max(ndtri(share), 0.0))


def fullest_signals(grid: TdiGrid, detector: TdiDetector, rules: ChoiceRules) -> Array:
    """(P,) largest signal with which neither well of a setting overflows; infinite without wells."""
    (line_dark, line), (total_dark, total) = (
        level for level in well_levels(np.array([0.0, 1.0]), grid, detector)
    )
    room = np.minimum(
        (detector.full_well_line - line_dark) / (line - line_dark),
        (detector.full_well_sum - total_dark) / (total - total_dark),
    )
    return np.asarray(room / _headroom(rules))


def _snr_of(signals: Array, grid: TdiGrid, detector: TdiDetector) -> Array:
    """(S, P) SNR of every setting, that of `imaging.tdi_noise`: its variance is a parabola of the signal."""
    stages, ratio = grid.settings
    law, exposure = detector.noise, detector.exposure
    head = np.minimum(stages, exposure.head_stages)
    total = exposure.total(stages, ratio)
    squares = head * exposure.head_ratio**2 + (stages - head) * ratio**2
    parabola = (
        law.gain * squares + law.column_fixed * total**2,
        law.shot * total,
        law.dark * total + stages * law.read**2 + law.output**2,
    )
    out = np.empty((len(signals), len(grid)))
    snr_of_settings(np.asarray(signals, dtype=np.float64) / detector.signal_ratio, total, *parabola, out)
    return out


def unsaturated(signals: Array, grid: TdiGrid, detector: TdiDetector, rules: ChoiceRules) -> Flags:
    """(S, P) whether no line, and not their sum, fills its well."""
    if detector.without_wells:
        return np.ones((len(signals), len(grid)), dtype=bool)
    line, total = well_levels(signals * _headroom(rules), grid, detector)
    return np.asarray((line <= detector.full_well_line) & (total <= detector.full_well_sum))


def well_levels(signals: Array, grid: TdiGrid, detector: TdiDetector) -> tuple[Array, Array]:
    """Electrons (S, P) of the fullest line and of the sum, dark current included."""
    stages, ratio = grid.settings
    return filled(signals[:, None], stages, ratio, detector)


def filled(
    signals: ArrayLike, stages: ArrayLike, ratio: ArrayLike, detector: TdiDetector
) -> tuple[Array, Array]:
    """Electrons of the fullest line and of the sum, dark current included; arguments are broadcast."""
    n, kt = np.asarray(stages), np.asarray(ratio, dtype=np.float64)
    exposure, dark = detector.exposure, detector.noise.dark
    longest = np.maximum(kt, exposure.head_ratio if exposure.head_stages else 0.0)
    longest = np.where(n <= exposure.head_stages, exposure.head_ratio, longest)
    line = (np.asarray(signals, dtype=np.float64) / detector.signal_ratio + dark) * longest
    total = summed_signal(signals, n, kt, exposure, detector.reference)
    return np.asarray(line), total + dark * exposure.total(n, kt)
