"""Observations: what matched windows say about attitude, static parameters and relief together.

A *star* is a set of ground patches, each cut once from one image (the hub) and found in
several others. All its pairs share the hub's error, every match keeps its own two times, and
the length of the window is part of the measurement. Sums of stars are what the joint
estimator (``motion/strip/joint.py``) turns into normal equations.

Not here: per-axis differences for S1's named methods (``motion/estimators/differences.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.motion.measure.windows import stretches
from sightline.writing import let_go, scratch_array, scratch_copy

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Star:
    """Windows of one hub image found in K other images.

    Attributes
    ----------
    hub : int
        Number of the image the windows were cut from.
    images : tuple of int
        The K images they were found in.
    shape : (rows, blocks)
        The windows form a grid: G = rows * blocks, row by row.
    pixels : (G, 2)
        Centres of the windows in the hub, (line, column) px.
    t_hub : (G,)
        s; exposure of the window's centre in the hub.
    t : (G, K)
        s; exposure of the partner.
    duration : float
        s; time a window spans along the hub's lines (0 for an area detector).
    coarseness : float
        Line period of the hub over that of the finest of all images; 1 where they are like.
    fineness : tuple of float
        Pixels of each partner to one of the hub where they are finer, else 1; empty: 1 of all.
    tdi_hub, tdi : (G,) and (G, K), optional
        s; how long TDI averages the motion in the hub and in the partner, beside the window; None: no band
        has TDI.
    stretch : float
        s; by how much longer what is measured along the lines averages than what is measured across them.
    residual_px : (G, K, 2)
        Measured minus predicted, px; NaN where there is no match.
    covariance_px : (G, K, 2, 2)
        Of each match by itself, px^2.
    by_hub, by_partner : (G, K, 2, 3) float32
        px/rad; by the attitude of the hub's and of the partner's instant.
    by_static : (G, K, 2, Q) float32
        px per unit of each static parameter.
    by_height : (G, K, 2) float32
        px/m.
    field : (G,)
        Position across the field, -1 .. 1 from edge to edge of the hub's detector.
    correlation : (2K, 2K)
        Covariance of the errors scaled by each match's own Cholesky factor: 1 on the diagonal where the
        matcher's covariance is right, about 1/2 between pairs, which share the hub.
    weight : (G, K)
        Robust weight of each match in [0, 1].
    single : (K, 2, 2), optional
        What `correlation` has of single matches of each pair, without what errors that rows or neighbours
        share add to long means; None: the same.
    brightness : (G,), optional
        Of the brightest part of each window in the hub, in units of the image.
    brightness_elsewhere : (M,), optional
        The same of windows all over the hub, where those of the star show little of it.
    window : (lines, columns), optional
        Size of the windows, px.
    chosen : (G,), optional
        Windows that were to be matched; None: all.
    blur_px : (G, K, 2), optional
        px; what was taken off `residual_px` for jitter within the stages of TDI; None: no band has TDI.
    uneven : (G, K, 2, 2, 3, B) float32, optional
        px/rad; how that changes with the attitude of hub and partner `uneven_at` (B,) s beside their
        instants: what stages show of the motion is no even mean of it where other motion blurs them.
    """

    hub: int
    images: tuple[int, ...]
    shape: tuple[int, int]
    pixels: Array
    t_hub: Array
    t: Array
    duration: float
    residual_px: Array
    covariance_px: Array
    by_hub: NDArray[np.float32]
    by_partner: NDArray[np.float32]
    by_static: NDArray[np.float32]
    by_height: NDArray[np.float32]
    field: Array
    correlation: Array
    weight: Array
    brightness: Array | None = None
    brightness_elsewhere: Array | None = None
    window: tuple[int, int] | None = None
    stretch: float = 0.0
    coarseness: float = 1.0
    fineness: tuple[float, ...] = ()
    tdi_hub: Array | None = None
    tdi: Array | None = None
    blur_px: Array | None = None
    uneven: NDArray[np.float32] | None = None
    uneven_at: Array | None = None
    chosen: NDArray[np.bool_] | None = None
    single: Array | None = None

    @property
    def longest(self) -> float:
        """s; the longest time that a measurement averages over."""
        whole = self.duration + self.stretch
        if self.tdi_hub is None or self.tdi is None:
            return whole
        return whole + max(float(self.tdi_hub.max(initial=0.0)), float(np.nanmax(self.tdi, initial=0.0)))

    def averaging(self) -> tuple[Array, Array]:
        """`tdi_hub` and `tdi`, zeros where there are none."""
        if self.tdi_hub is None or self.tdi is None:
            return np.zeros(len(self.t_hub)), np.zeros(self.t.shape)
        return self.tdi_hub, self.tdi

    def by_stages(self) -> list[Star]:
        """The star for each set of times that TDI averages over in its images; others have no weight."""
        if self.tdi_hub is None or self.tdi is None:
            return [self]
        times = np.round(np.column_stack([self.tdi_hub, self.tdi]), 12)
        out = []
        for each in np.unique(times[self.present.any(axis=1)], axis=0):
            alike = (times == each).all(axis=1)
            out.append(self.with_weight(np.where(alike[:, None], self.weight, 0.0)))
        return out

    def stretches(self) -> list[slice]:
        """Whole rows of windows, some at a time."""
        return stretches(*self.shape)

    def rows(self, some: slice) -> Star:
        """The star of some rows of windows alone, all between two or every so many."""
        numbers = np.arange(self.shape[0])[some]
        windows: dict[str, Any] = {
            one.name: self.of_rows(value, some)
            for one in fields(self)
            if isinstance(value := getattr(self, one.name), np.ndarray)
            and one.name not in ("correlation", "single", "uneven_at", "brightness_elsewhere")
        }
        return replace(self, shape=(len(numbers), self.shape[1]), **windows)

    def of_rows(self, values: NDArray[Any], some: slice) -> NDArray[Any]:
        """What windows (G, ...) have, of some rows of them."""
        if some.step in (None, 1):
            return values[some.start * self.shape[1] : some.stop * self.shape[1]]
        found = scratch_copy(values.reshape(*self.shape, *values.shape[1:])[some])
        let_go()
        return found.reshape(len(found) * self.shape[1], *values.shape[1:])

    def each(self, function: Callable[..., NDArray[Any]], *arrays: NDArray[Any]) -> NDArray[Any]:
        """What a function of `arrays` (G, ...) gives window by window, as a scratch array."""
        out: NDArray[Any] | None = None
        for some in self.stretches() or [slice(0, 0)]:
            values = function(*(array[some] for array in arrays))
            if out is None:
                out = scratch_array((len(self.t_hub), *values.shape[1:]), values.dtype)
            out[some] = values
            let_go()
        assert out is not None
        return out

    @property
    def present(self) -> NDArray[np.bool_]:
        """(G, K): matches that exist and carry weight."""
        return self.each(
            lambda residual, weight: np.isfinite(residual[..., 0]) & (weight > 0.0),
            self.residual_px,
            self.weight,
        )

    def with_correlation(self, correlation: Array) -> Star:
        """The same star with another error correlation between its pairs."""
        return replace(self, correlation=correlation)

    def with_weight(self, weight: Array) -> Star:
        """The same star with other robust weights, (G, K)."""
        return replace(self, weight=weight)

    def error_variance(self, some: slice | NDArray[np.bool_]) -> Array:
        """(some, K, 2) px^2; what matches err by along lines and columns, as their scatter shows it.

        Single matches where `single` says it, else matches as long means feel them.
        """
        scaled, pair = self.single, np.arange(self.t.shape[1])
        if scaled is None:
            scaled = self.correlation.reshape(len(pair), 2, -1, 2)[pair, :, pair]
        l11, l21, l22 = _factor(self.covariance_px[some])
        c11, c12, c22 = scaled[:, 0, 0], scaled[:, 0, 1], scaled[:, 1, 1]
        return np.stack([l11**2 * c11, l21**2 * c11 + 2.0 * l21 * l22 * c12 + l22**2 * c22], axis=-1)

    def scaled(self) -> Array:
        """Residuals in units of each match's own sigma: (G, 2K), NaN where absent."""
        return scale_residuals(self.residual_px, self.covariance_px)


def scale_residuals(residual_px: Array, covariance_px: Array) -> Array:
    """Residuals divided by the Cholesky factor of their covariance: (G, 2K)."""
    l11, l21, l22 = _factor(covariance_px)
    first = residual_px[..., 0] / l11
    second = (residual_px[..., 1] - l21 * first) / l22
    return np.stack([first, second], axis=-1).reshape(len(residual_px), -1)


def scaled_pixel(covariance_px: Array) -> Array:
    """What a pixel along an axis alone is of the scaled residual of that axis, 1/px: (G, 2K)."""
    l11, _, l22 = _factor(covariance_px)
    return (1.0 / np.stack([l11, l22], axis=-1)).reshape(len(covariance_px), -1)


def _factor(covariance_px: Array) -> tuple[Array, Array, Array]:
    """Lower Cholesky factor of covariances (..., 2, 2): first column, then what is left."""
    l11 = np.sqrt(covariance_px[..., 0, 0])
    l21 = covariance_px[..., 1, 0] / l11
    return l11, l21, np.sqrt(np.maximum(covariance_px[..., 1, 1] - l21**2, 1e-30))


def shared_image_correlation(pairs: int) -> Array:
    """Start value of the error correlation: two images of equal noise, the hub's part shared by all pairs."""
    gamma = np.full((pairs, pairs), 0.5) + 0.5 * np.eye(pairs)
    return np.asarray(np.kron(gamma, np.eye(2)), dtype=np.float64)
