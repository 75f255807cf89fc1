"""MTF of every setting under drift and a recovered motion, over the strip and over what is not known of it.

A node is one line: a time at which its first stage begins, and one draw of what the motion may be there. The
merit of a setting is its mean over the lines of a strip; draws show how sure that is.

Not here: the motion and what is known of it (``motion_knowledge.py``), drift alone (``merit.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError, SpanError
from sightline.geometry.interpolation import interpolate
from sightline.imaging.tdi_transfer import ALIGNMENTS, POINTS, Exposure
from sightline.tdi.merit import mtf_merit, normal_draws, robust_merit, square_root
from sightline.tdi.motion_kernels import moved_mtf
from sightline.tdi.motion_knowledge import MotionKnowledge
from sightline.tdi.scan_columns import ColumnGeometry
from sightline.tdi.setting import ChoiceRules, Index, ScanColumns, TdiGrid

Array = NDArray[np.float64]

#: Columns for which the motion is integrated; those between are interpolated.
GROUPS = 64
#: Lines of the strip per draw, and draws of what is not known; lines where nothing is drawn.
STARTS, DRAWS, EXACT_STARTS = 16, 16, 64
#: Merits of which what stands still is a factor.
FACTORS = ("product", "geomean", "x", "y")
#: Line periods before and after the stages that exposures of any alignment reach.
MARGIN = 1.0


@dataclass(frozen=True, eq=False)
class MotionMtf:
    """MTF of motion by column and setting, under drift and a motion (a ``ColumnMtf``).

    Attributes
    ----------
    columns : ScanColumns
        A covariance of velocity and slip is drawn from beside the motion's own.
    geometry : ColumnGeometry
        Of the same columns.
    knowledge : MotionKnowledge
    grid : TdiGrid
    exposure : Exposure
    rules : ChoiceRules
    span : (float, float) or None
        s; the strip. The motion's own span by default.
    starts, draws : int or None
        Lines per draw and draws; chosen by whether anything is uncertain where not given.
    groups : int
        At most so many columns are integrated.
    """

    columns: ScanColumns
    geometry: ColumnGeometry
    knowledge: MotionKnowledge
    grid: TdiGrid
    exposure: Exposure
    rules: ChoiceRules
    span: tuple[float, float] | None = None
    starts: int | None = None
    draws: int | None = None
    groups: int = GROUPS

    def __post_init__(self) -> None:
        """Refuse what does not fit together, and a motion that does not cover the strip."""
        if self.rules.model != "exact":
            raise InputError(
                f'`model` is {self.rules.model!r}, which knows no measured motion; with a motion "exact" is '
                "allowed"
            )
        if not np.array_equal(self.columns.column, self.geometry.column):
            raise InputError(
                f"columns mismatch: {len(self.columns)} columns, geometry of {len(self.geometry.column)}; "
                "the two must be of the same columns in the same order"
            )
        if self.span is not None:
            self.knowledge.check_covers(*self.span)
        self._first_starts()

    @property
    def nodes_per_draw(self) -> int:
        """Nodes in a row that are lines of one and the same strip."""
        return self.starts or (EXACT_STARTS if self._sure else STARTS)

    def judged_by(self, rules: ChoiceRules) -> MotionMtf:
        """The same under other rules; what was integrated is kept where the frequencies stay."""
        other = replace(self, rules=rules)
        if rules.frequencies == self.rules.frequencies and "_nodes" in self.__dict__:
            other.__dict__["_nodes"] = self._nodes
        return other

    def central(self, which: slice | Index) -> Array:
        """(c, P, 2) MTF of motion across and along, mean over all nodes."""
        return self._between(self._mean[None], which)[0]

    def drawn(self, which: slice | Index) -> Array:
        """(M, c, P, 2) MTF of motion at every node: draws, and within each its lines."""
        return self._between(self._nodes, which)

    def robust_merit(self, which: slice | Index, rules: ChoiceRules) -> Array:
        """(c, P) factor of the merit, by mean or quantile over draws.

        Parameters
        ----------
        which : slice
        rules : ChoiceRules

        Notes
        -----
        Found for the groups and linear between, where the MTF of what stands still is but a factor of it, or
        the same in all columns; else column by column.
        """
        static = self.columns.static_mtf
        factor = mtf_merit(static, rules.merit)
        alike = bool((static == static[0]).all())
        if not (alike or rules.merit in FACTORS) or not factor.all():
            merit = robust_merit(self, which, rules)
            assert merit is not None  # there is a node at least
            return merit
        key = (rules.merit, rules.quantile)
        if key not in self._by_group:
            each = [robust_merit(self, slice(k, k + 1), rules) for k in self._places.tolist()]
            found = np.concatenate([merit for merit in each if merit is not None])
            self._by_group[key] = found / factor[self._places, None]
        between = self._between(self._by_group[key][None, ..., None], which)[0, ..., 0]
        return np.asarray(between * factor[which, None])

    @cached_property
    def _by_group(self) -> dict[tuple[str, float | None], Array]:
        """Merit (G, P) of the groups over that of what stands still, by how it is judged."""
        return {}

    @property
    def _sure(self) -> bool:
        covariance = self.columns.covariance
        return self.knowledge.exact and (covariance is None or not covariance.any())

    @cached_property
    def _places(self) -> NDArray[np.intp]:
        """Numbers of the columns that are integrated, ends included."""
        count = len(self.columns)
        return np.unique(np.round(np.linspace(0, count - 1, min(self.groups, count))).astype(np.intp))

    def _between(self, nodes: Array, which: slice | Index) -> Array:
        """Nodes (M, G, P, 2) of the groups at columns: linear in the column's number."""
        column = self.columns.column
        known, wanted = column[self._places], column[which]
        if len(known) == len(column):
            return nodes[:, which]
        order = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(known) - 2)
        share = ((wanted - known[order]) / (known[order + 1] - known[order]))[:, None, None]
        return np.asarray((1.0 - share) * nodes[:, order] + share * nodes[:, order + 1])

    @cached_property
    def _mean(self) -> Array:
        return np.asarray(self._nodes.mean(axis=0))

    def _first_starts(self) -> tuple[float, float]:
        """First and last time (s) at which a line may begin."""
        begin, end = self.knowledge.motion.span
        if self.span is not None:
            begin, end = max(begin, self.span[0]), min(end, self.span[1])
        step, stages = self.geometry.line_period, int(self.grid.stages[-1])
        first, last = begin + MARGIN * step, end - (stages - 1 + MARGIN) * step
        if last < first:
            raise SpanError(
                f"the motion covers {(end - begin) / step:.0f} line periods of the strip, {stages} stages "
                f"need {stages + 2 * MARGIN - 1:.0f}; give a longer motion, or fewer stages in [grid]"
            )
        return first, last

    def start_times(self) -> Array:
        """(draws, starts) s; when the first stage of each node is centred: spread evenly over the strip.

        Every draw has its own, between those of the others.
        """
        draws, starts = (1 if self._sure else self.draws or DRAWS), self.nodes_per_draw
        first, last = self._first_starts()
        # the k-th draw stands at the k-th place of each stretch, in bit-reversed order
        place = (np.argsort(np.argsort(_bit_reversed(draws))) + 0.5) / draws
        return first + (last - first) * (np.arange(starts) + place[:, None]) / starts

    @cached_property
    def _nodes(self) -> Array:
        """(M, G, P, 2) MTF at every node for the groups."""
        times = self.start_times()
        draws, starts = times.shape
        hidden = self.knowledge.hidden_covariance
        kinds = 0 if hidden is None else len(hidden)
        unit = np.zeros((1, kinds + 2)) if draws == 1 else normal_draws(kinds + 2, draws)
        out = np.empty((draws * starts, len(self._places), len(self.grid), 2), dtype=np.float32)
        errors = self._errors(draws * starts)
        for d in range(draws):
            amplitudes = None
            if hidden is not None and draws > 1:
                amplitudes = square_root(hidden[None])[0] @ unit[d, :kinds]
            velocity, slip = self._drift(unit[d, kinds:])
            for s in range(starts):
                node = d * starts + s
                error = None if errors is None else errors[node]
                self.line_mtf(times[d, s], velocity, slip, amplitudes, error, out[node])
        return out

    def _drift(self, unit: Array) -> tuple[Array, Array]:
        """Velocity and slip (G,) of the groups, so many sigmas from what they are expected to be."""
        velocity, slip = self.columns.velocity[self._places], self.columns.slip[self._places]
        if self.columns.covariance is None or not unit.any():
            return velocity, slip
        moved = square_root(self.columns.covariance[self._places]) @ unit
        return velocity + moved[:, 0], slip + moved[:, 1]

    def _errors(self, count: int) -> Array | None:
        """(count, K + 4, 3) rad; draws of the error of the motion from a line period before each node on."""
        psd, f = self.knowledge.error_psd, self.knowledge.frequency
        if not np.any(psd):
            return None
        step, length = self.geometry.line_period, int(self.grid.stages[-1]) + 4
        # drifts are hidden, or seen well: what is slower than the strip is not in the density
        slowest = 1.0 / np.ptp(self.knowledge.motion.t)
        size = 2 * int(np.ceil(max(count * length, 2.0 / (slowest * step)) / 2.0))
        at = np.fft.rfftfreq(size, step)
        density = np.stack([np.interp(at, f, psd[:, k], right=0.0) for k in range(3)], axis=1)
        density[at < slowest] = 0.0
        white = np.random.default_rng(0).standard_normal((size, 3))
        # white noise of unit variance has the one-sided density 2 step
        path = np.fft.irfft(np.fft.rfft(white, axis=0) * np.sqrt(density / (2.0 * step)), size, axis=0)
        return np.asarray(path[: count * length].reshape(count, length, 3))

    def line_mtf(
        self,
        start: float,
        velocity: Array,
        slip: Array,
        amplitudes: Array | None,
        error: Array | None,
        out: Array,
    ) -> None:
        """MTF of every setting of one line, for the groups.

        Parameters
        ----------
        start : float
            s; middle of its first stage.
        velocity, slip : (G,)
        amplitudes : (H,) or None
            How much of each hidden direction the motion holds besides.
        error : (K + 4, 3) or None
            rad; to be added, from two line periods before the start on, one row per line period.
        out : (G, P, 2)
            Overwritten.
        """
        offset, weight = self._points
        step = self.geometry.line_period
        since = np.arange(len(offset))[:, None] + offset  # line periods
        at = start + step * since
        angles = self._angles(at.ravel(), amplitudes)
        if error is not None:
            angles += interpolate(np.arange(-2.0, len(error) - 2.0), error, since.ravel())
        moved = np.empty((4, at.size))
        moved[:3] = angles.T
        moved[3] = -(angles @ self.geometry.twist) * since.ravel()
        across = velocity * np.tan(slip)
        levers = np.zeros((len(velocity), 2, 4))
        levers[:, :, :3] = self.geometry.levers[self._places]
        levers[:, 0, 3], levers[:, 1, 3] = velocity, -across  # the path, turned with the camera
        fx, fy = map(float, self.rules.frequencies)
        sharp = np.empty((len(velocity), len(self.grid), 2))
        moved_mtf(
            across, velocity - 1.0, np.ascontiguousarray(velocity), levers, fx, fy,
            self.grid.stages, self.grid.ratios, self.exposure.head_stages, float(self.exposure.head_ratio),
            offset, moved.reshape(4, *offset.shape), weight, sharp,
        )  # fmt: skip
        out[:] = sharp * self._jitter[:, None, :]

    def _angles(self, t: Array, amplitudes: Array | None) -> Array:
        """(T, 3) rad at times `t`, so much of each hidden direction added."""
        motion, hidden = self.knowledge.motion, self.knowledge.hidden
        angles = motion.at(np.clip(t, *motion.span))
        if amplitudes is not None and hidden is not None:
            path = hidden @ amplitudes
            angles += np.stack([np.interp(t, motion.t, path[:, axis]) for axis in range(3)], axis=1)
        return angles

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        """Line periods (K, R Q) from the middle of each line to points of its exposures, and weights (Q,)."""
        node, weight = np.polynomial.legendre.leggauss(POINTS)
        k = np.arange(int(self.grid.stages[-1]))
        head = k[:, None] < self.exposure.head_stages
        length = np.where(head, self.exposure.head_ratio, self.grid.ratios)
        offset = length[..., None] * (0.5 * node + ALIGNMENTS[self.exposure.align])
        return offset.reshape(len(k), -1), 0.5 * weight

    @cached_property
    def _jitter(self) -> Array:
        """(G, 2) MTF of what is too fast to be followed, normally distributed."""
        levers = self.geometry.levers[self._places]
        variance = (levers**2) @ self.knowledge.jitter**2
        f = np.asarray(self.rules.frequencies, dtype=np.float64)
        return np.asarray(np.exp(-2.0 * np.pi**2 * f**2 * variance))


def _bit_reversed(count: int) -> Array:
    """Van der Corput's sequence of base 2: any first few of its numbers are spread over 0 to 1."""
    bits = max(int(np.ceil(np.log2(max(count, 2)))), 1)
    digits = (np.arange(count)[:, None] >> np.arange(bits)) & 1
    return np.asarray(digits @ (0.5 ** np.arange(1, bits + 1)))
