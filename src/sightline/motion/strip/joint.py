"""The joint estimate: roll, pitch, yaw on one grid, static parameters and relief, with covariance.

Maximum a posteriori by banded normal equations: the data's information (``normal_equations.py``)
plus one autoregressive precision per axis. A free constant per axis and the static parameters
form the border. The covariance is that of the motion less its hidden part: a constant per axis,
and what free static parameters imitate.

Not here: choosing the prior (``estimation/likelihood.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from sightline.errors import EstimationError
from sightline.estimation.banded import (
    ROWS_AT_ONCE,
    BandedFactor,
    BorderedFactor,
    add_band_times,
    products,
)
from sightline.estimation.prior import Autoregressive, Spectrum, Tone
from sightline.estimation.split import LaidFactor, Layout, SplitPrior, farthest, spread_columns
from sightline.execution import give_back_memory, slices
from sightline.motion.strip.fusion import Ties, add_ties
from sightline.motion.strip.normal_equations import NormalEquations, TimeGrid, no_information
from sightline.writing import let_go, scratch_array

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Factor = BorderedFactor | LaidFactor

#: 1-sigma of the constant of roll, pitch and yaw, and of even drifts from the middle of the strip to its end
#: (rad). Images of one strip never see a constant of roll or pitch, which stay where the reference attitude
#: puts them: let loose, errors of linearisation would carry them away, and a constant pitch of D turns the
#: yaw y(t) into a roll -D y(t). That of yaw turns bands that look ahead sideways.
CONSTANT_SIGMA = (1e-5, 1e-5, 1e-2)
DRIFT_SIGMA = (1e-5, 1e-5, 1e-2)
#: The same of an axis that sensors or control points tie to the world (rad): they alone say where it is.
TIED_SIGMA = 1.0

#: A drift is hidden where free static parameters leave less than this share of what images see of it beside
#: curves of this degree. Of hidden ones up to 0.01 is left, 0.045 where lags are a few lines: the motion
#: changes lags by up to a tenth, which a drift would scale it by. Where images see a drift it is 0.19 to 1.
HIDDEN, DEGREE = 0.09, 3
#: Nor are drifts seen that images tell less of than this share of all that is known of them.
SEEN = 0.5

#: Innovations beyond this many sigmas are taken for jumps.
JUMP = 4.5
#: Instants at which covariances are found at a time.
INSTANTS = 16384
#: Rows of the autoregression that are not looked at for jumps.
STARTUP_ROWS = 64


@dataclass(frozen=True, eq=False)
class JointPrior:
    """What is believed before the images are looked at.

    Attributes
    ----------
    angles : three Autoregressive
        Roll, pitch, yaw departures from a free constant, on the grid (rad).
    statics_sigma : (Q,)
        Of each static parameter, in its unit.
    relief : two Autoregressive or None
        Mean height and cross-track slope (at the field edge) of each row of ground (m).
    innovation_weights : (count, 3) or None
        Below 1 where the motion may jump.
    constant_sigma, drift_sigma : (3,)
        rad; of the free constant of each axis, and of its even drift from the middle of the strip to its end.
    apart : three SplitPrior or None
        The same processes with their drifts on a coarse grid of their own, of one ratio: for gaps longer than
        the memory of `angles`.
    own_precision : (S, S) or None
        Of the constants of attitude sensors, unknowns beside the static parameters.
    slow_precision : (E, E) or None
        Of errors of matching that wander along the strip, unknowns beside the static parameters
        (``slow_errors.py``).
    ample : JointPrior or None
        Of motions that hold no axis still, whose constants and drifts are as far off as is said of the
        reference attitude: it completes hidden drifts, and says how well they are known. None: this one.
    curve_sigma : (3,)
        rad; of a parabola along the strip (Legendre's, 1 at the ends) of each axis beside `angles`, whose
        memory is too short to know its size; 0 adds none, nor does a prior whose drifts are apart.
    even : bool
        Whether even drifts are free beside `angles` too, and not held alone.
    common : (Q, K) or None
        Directions of the static parameters that move all images alike, as a constant turn of the body does.
        No image shows how much there is of them: where nothing else ties it, it stays as believed.
    unshown : (Q, Q) or None
        Information on `common` that the equations claim and no image holds, under just this prior: it is
        taken off (`kept_common`).
    """

    angles: tuple[Autoregressive, Autoregressive, Autoregressive]
    statics_sigma: Array
    relief: tuple[Autoregressive, Autoregressive] | None = None
    innovation_weights: Array | None = None
    constant_sigma: tuple[float, float, float] = CONSTANT_SIGMA
    apart: tuple[SplitPrior, SplitPrior, SplitPrior] | None = None
    own_precision: Array | None = None
    slow_precision: Array | None = None
    drift_sigma: tuple[float, float, float] = DRIFT_SIGMA
    ample: JointPrior | None = None
    curve_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    even: bool = False
    common: Array | None = None
    unshown: Array | None = None

    @property
    def _curved(self) -> list[int]:
        """Axes with a free parabola."""
        return [k for k in range(3) if self.curve_sigma[k] > 0.0 and self.apart is None]

    @property
    def _drifting(self) -> list[int]:
        """Axes with a free even drift."""
        return [k for k in range(3) if self.even and self.drift_sigma[k] > 0.0]

    @property
    def free_sigma(self) -> Array:
        """Sigmas (F,) rad of what `angles` leave free: parabolas, even drifts if any, a constant per axis."""
        drifts = (self.drift_sigma[k] for k in self._drifting)
        return np.array([*(self.curve_sigma[k] for k in self._curved), *drifts, *self.constant_sigma])

    def free_shapes(self, count: int, block: int) -> Array:
        """(block * count, F) motions of the grid of which `free_sigma` are the sigmas."""
        u = np.linspace(-1.0, 1.0, count)
        parabolas = [(k, 1.5 * u**2 - 0.5) for k in self._curved]
        drifts = [(k, u) for k in self._drifting]
        shapes = [*parabolas, *drifts, *((k, np.ones(count)) for k in range(3))]
        out = scratch_array((block * count, len(shapes)))
        for column, (axis, values) in enumerate(shapes):
            out[axis::block, column] = values
        return out

    def loosened(self, tied: NDArray[np.bool_]) -> JointPrior:
        """The prior with free constants of the axes (3,) that sensors or control points tie to the world."""
        roll, pitch, yaw = np.where(tied, TIED_SIGMA, self.constant_sigma)
        return replace(self, constant_sigma=(roll, pitch, yaw))

    @property
    def border_precision(self) -> Array:
        """Of static parameters, errors that wander, sensors' constants: (Q + E + S, Q + E + S)."""
        more = [p for p in (self.slow_precision, self.own_precision) if p is not None]
        statics = np.diag(1.0 / self.statics_sigma**2)
        if self.unshown is not None:
            statics = statics - self.unshown
        return np.asarray(block_diag(statics, *more))

    def common_parts(self) -> tuple[Array, Array]:
        """Weights (Q, K) of static parameters whose sums are how much of `common` they hold; its covariance.

        What is left beside it is as likely beforehand as may be.
        """
        none = np.zeros((len(self.statics_sigma), 0))
        directions = none if self.common is None else self.common
        weights = directions / self.statics_sigma[:, None] ** 2
        variance = np.linalg.inv(directions.T @ weights)
        return weights @ variance, np.asarray(variance)

    def layout(self, count: int, block: int) -> Layout | None:
        """Where the unknowns of the grid stand between coarse nodes; None where there are none."""
        if self.apart is None:
            return None
        return Layout.interleaved(count, self.apart[0].ratio, block=block, slow=3)

    def laid_width(self, layout: Layout) -> int:
        """Subdiagonals of the prior precision of all unknowns of a layout, coarse ones among them."""
        assert self.apart is not None
        place = layout.fine
        widths = [p.width(layout, axis) for axis, p in enumerate(self.apart)]
        widths += [farthest(place[:, 3 + k], p.order) for k, p in enumerate(self.relief or ())]
        return max(widths)

    def laid_columns(self, layout: Layout, first: int, last: int, width: int) -> Array:
        """Columns [first, last) of the lower band of that precision, (width + 1, last - first)."""
        assert self.apart is not None
        out = np.zeros((width + 1, last - first))
        for axis, p in enumerate(self.apart):
            weights = None if self.innovation_weights is None else self.innovation_weights[:, axis].copy()
            p.add_to(out, layout, axis, weights, first)
        for k, process in enumerate(self.relief or ()):
            place = np.ascontiguousarray(layout.fine[:, 3 + k])
            low, high = np.searchsorted(place, (first, last)).tolist()
            if low < high:
                spread_columns(process.precision_columns(low, high), place, low, out, first)
        return out

    def width(self, block: int) -> int:
        """Subdiagonals of the prior precision of all unknowns of the grid."""
        return block * max(process.order for process in (*self.angles, *(self.relief or ())))

    def precision_columns(self, first: int, last: int, block: int) -> Array:
        """Columns [first, last) of the lower band of that precision, (width + 1, last - first)."""
        begin, end = first // block, -(-last // block)
        out = np.zeros((self.width(block) + 1, block * (end - begin)))
        for axis, process in enumerate((*self.angles, *(self.relief or ()))):
            weights = None
            if self.innovation_weights is not None and axis < 3:
                weights = self.innovation_weights[:, axis]
            band = process.precision_columns(begin, end, weights)
            out[: (len(band) - 1) * block + 1 : block, axis::block] = band
        return np.ascontiguousarray(out[:, first - block * begin : last - block * begin])


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """Posterior of the joint problem.

    Attributes
    ----------
    grid : TimeGrid
    nodes : (count, 3)
        rad; roll, pitch, yaw.
    relief : (count, 2) or None
        m; mean height and slope (at the field edge).
    statics : (Q,)
        Estimates of the static parameters; `statics_sigma` their posterior sigmas.
    own : (S,)
        Estimates of the constants of attitude sensors; `own_sigma` their posterior sigmas.
    ties : Ties or None
        What sensors and control points said.
    slow : (E,)
        px; errors of matching that wander along the strip; `slow_covariance` (E, E) theirs.
    """

    grid: TimeGrid
    nodes: Array
    relief: Array | None
    statics: Array
    statics_sigma: Array
    _images: NormalEquations
    _prior: JointPrior
    own: Array = field(default_factory=lambda: np.zeros(0))
    own_sigma: Array = field(default_factory=lambda: np.zeros(0))
    ties: Ties | None = None
    slow: Array = field(default_factory=lambda: np.zeros(0))
    slow_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __getstate__(self) -> dict[str, Any]:
        """Without the factors, which are made when they are asked for."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    def alone(self) -> JointEstimate:
        """The same values without the equations that they solve: no covariance can be asked of it."""
        return replace(self, _images=no_information(self.grid, 0))

    @property
    def prior(self) -> JointPrior:
        """What was believed before the images were looked at."""
        return replace(self._prior, unshown=None)

    @cached_property
    def _data(self) -> NormalEquations:
        """Information of images and sensors."""
        return self._images if self.ties is None else add_ties(self._images, self.ties)

    @cached_property
    def _banded(self) -> _Banded:
        """Factor of the band of data + prior, which is the same with and without constants."""
        return _banded_factor(self._data, self._prior)

    @cached_property
    def _factors(self) -> dict[bool, Factor]:
        """What `_factor` has made."""
        return {}

    def _factor(self, *, constants: bool) -> Factor:
        """Factor of data + prior, with or without a free constant per axis."""
        if constants not in self._factors:
            made = _factor(self._banded, self._data, self._prior, constants=constants)
            self._factors[constants] = made
        return self._factors[constants]

    def unknowns(self) -> Array:
        """Node values with relief where there is any, (count, 3 or 5)."""
        return self.nodes if self.relief is None else np.concatenate([self.nodes, self.relief], axis=1)

    def moved_by(self, images: NormalEquations) -> Array:
        """(count, 3) rad; by how much the motion would be another with so much more in its measurements.

        `images` are the normal equations of the same rows with that on their left side.
        """
        factor = self._factor(constants=True)
        x, y = factor.solve(images.rhs, _beside(images, factor))
        x, _ = _held(factor, self._data, self._prior, x, y)
        return np.asarray(x.reshape(self.grid.count, -1)[:, :3])

    def likelihood_of(self, relief: tuple[Autoregressive, Autoregressive]) -> float:
        """Logarithm of the likelihood of what was measured, had the ground this relief; plus a constant."""
        prior = replace(self.prior, relief=relief)
        factor = _factor(_banded_factor(self._data, prior), self._data, prior, constants=True)
        beside = _beside(self._data, factor)
        x, y = factor.solve(self._data.rhs, beside)
        explained = float(self._data.rhs @ x + beside @ y)
        return 0.5 * (explained - factor.logdet + sum(process.logdet for process in relief))

    def shown_of(self, motions: Array) -> tuple[Array, Array]:
        """What images and sensors show of `motions` (count, 3, K) beside the estimate and its prior.

        Returns
        -------
        score : (K,)
            Slope of the log-likelihood by how much there is of each, at none.
        information : (K, K)
            Its mean bend: of a motion a score of no such motion is Gaussian with this covariance.
        """
        data, block, many = self._data, self._data.block, motions.shape[2]
        laid = np.zeros((self.grid.count, block, many))
        laid[:, :3] = motions
        flat = laid.reshape(-1, many)
        top, bottom = data.times(flat)
        beside = np.concatenate([self.statics, self.slow, self.own])
        score = flat.T @ data.rhs - top.T @ self.unknowns().ravel() - bottom.T @ beside
        factor = self._factor(constants=False)
        border = np.zeros((factor.q, many))
        border[: len(bottom)] = bottom
        x, y = factor.solve(top, border)
        return score, np.asarray(flat.T @ top - top.T @ x - border.T @ y)

    def relief_sigma(self) -> Array:
        """Sigma (count, 2) m of the relief, constants of the motion held."""
        block = self._data.block
        variance = self._factor(constants=False).covariance_band(0)[0].reshape(-1, block)
        return np.sqrt(np.maximum(variance[:, 3:], 0.0))

    @cached_property
    def hidden_drifts(self) -> tuple[int, ...]:
        """Axes (0 roll, 1 pitch, 2 yaw) whose linear drift free static parameters hide from the images.

        Notes
        -----
        A drift shifts the images of a pair by what grows with their lag: offsets and rotations imitate it
        where they are free in all images but those of one lag. Curves of the other axes alone, such as the
        parabola of roll that belongs to a drift of yaw, leave some of it to be seen; it is hidden where free
        static parameters take away all of that. So it is where what they leave says less than the priors of
        the motions, which know of such a parabola but that curves that are seen are small: short lags over a
        narrow field.
        """
        data, count = self._images, self.grid.count
        free = len(self._prior.statics_sigma)
        if not free:
            return ()
        curves = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), DEGREE)
        each = DEGREE + 1
        seen = np.zeros((3 * each + free,) * 2)
        seen[3 * each :, 3 * each :] = data.corner[:free, :free]
        for axis in range(3):  # one after the other: of long strips all together take more than the motion
            shapes = np.zeros((count, data.block, each))
            shapes[:, axis] = curves
            top, bottom = data.times(shapes.reshape(-1, each))
            here = slice(each * axis, each * (axis + 1))
            angles = top.reshape(count, data.block, each)[:, :3]
            seen[: 3 * each, here] = np.einsum("nc,nad->acd", curves, angles).reshape(3 * each, each)
            seen[3 * each :, here], seen[here, 3 * each :] = bottom[:free], bottom[:free].T
        size = np.sqrt(np.maximum(np.diag(seen), 0.0))
        seen = seen / np.outer(*[np.where(size > 0.0, size, 1.0)] * 2)
        motions = [k for k in range(3 * each) if k % each > 1]
        everything = [*motions, *range(3 * each, len(seen))]
        drifts = [each * axis + 1 for axis in range(3)]
        left = np.array([_unexplained(seen, k, everything) for k in drifts])
        share = left / [_unexplained(seen, k, motions) for k in drifts]
        hidden = share < HIDDEN
        if self.ties is None:
            weights, drift = np.zeros((count, data.block, 3)), mean_and_drift(count)[:, 1]
            for axis in range(3):
                weights[:, axis, axis] = drift
            flat = weights.reshape(-1, 3)
            variance = (flat * self._factor(constants=True).times(flat)[0]).sum(axis=0)
            hidden |= variance * left * size[drifts] ** 2 < SEEN
        return tuple(int(axis) for axis in np.flatnonzero(hidden))

    def untied_drifts(self) -> tuple[int, ...]:
        """The hidden drifts that neither sensors nor control points see."""
        tied = np.zeros(3, dtype=bool) if self.ties is None else self.ties.tied
        return tuple(axis for axis in self.hidden_drifts if not tied[axis])

    def hidden_directions(self, drifts: Sequence[int] = ()) -> Array:
        """Motions that leave every image as it is, (count, 3, H) rad; of unit size at their own axis.

        A constant per axis, and a linear drift of each axis in `drifts` (from `hidden_drifts`: one that the
        images see has no hidden direction), each with what exact rays tie to it: the change of the other axes
        and of the free static parameters that cancels its effect on the images.

        Notes
        -----
        A seed h is completed to the hidden direction h + x by the least informative x:
        ``(N + P) x = -N h``, N the data's information and P the prior's, so that h + x leaves the data alone.
        For drifts P is that of motions about each axis of some size beside the one that moves most: a prior
        that holds one axis still would rather have the images see something than let that axis move.
        """
        own = [(0, axis) for axis in range(3)] + [(1, axis) for axis in drifts]
        return _unmixed(self._completed[:, :, [3 * shape + axis for shape, axis in own]], own, self._seeds)

    @property
    def _seeds(self) -> Array:
        """(count, 2): a constant, and a linear drift."""
        count = self.grid.count
        return np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)

    @cached_property
    def _completed(self) -> Array:
        """(count, 3, 6) rad: a constant and a drift of each axis, completed to what images see least."""
        data, count = self._images, self.grid.count
        alone = replace(self.prior, own_precision=None, ample=None)
        # what sensors see of a motion does not make it less hidden from the images
        own = self._factor(constants=False) if self.ties is None else joint_factor(data, alone)
        ample = self._prior.ample
        factors = (
            own,
            own if ample is None else joint_factor(data, ample),
        )
        # a constant moves the static parameters alone, and ample motions would rather undo it than let them
        out = scratch_array((count, 3, 6))
        for shape, factor in enumerate(factors):
            seeds = np.zeros((count, data.block, 3))
            for axis in range(3):
                seeds[:, axis, axis] = self._seeds[:, shape]
            h = seeds.reshape(-1, 3)
            top, bottom = data.times(h)
            border = np.zeros((factor.q, 3))
            border[: len(bottom)] = bottom
            x = factor.solve(-top, -border)[0]
            out[:, :, 3 * shape : 3 * shape + 3] = (h + x).reshape(count, data.block, 3)[:, :3]
        return out

    def relative_covariance(
        self, t: Array, directions: Array, scale: Array, turn: Array | None = None
    ) -> Array:
        """Covariance (N, 3, 3) rad^2 of the motion at `t` after the hidden `directions` are fitted away.

        Parameters
        ----------
        t : (N,)
            s; instants at which the motion is given, evenly weighted in the fit.
        directions : (N, 3, H)
            Hidden directions at these instants.
        scale : (3,)
            rad; angle that counts as one in the fit, per axis (one pixel; for yaw one at the field edge).
        turn : (3, 3), optional
            Rotation from the axes of the estimate to those of `directions`, `scale` and the result.
        """
        # images say nothing of constants; what sensors say of them can lean on the rest of the motion
        factor = self._factor(constants=self.ties is not None)
        return projected_covariance(factor, self.grid, self._data.block, t, directions, scale, turn)

    def functional_covariance(self, t: Array, weights: Array, turn: Array | None = None) -> Array:
        """Covariance (K, K) rad^2 of weighted sums of the motion at `t`, constants held.

        Parameters
        ----------
        t : (N,)
            s.
        weights : (N, 3, K)
            Of roll, pitch, yaw at these instants, in the axes of the result.
        turn : (3, 3), optional
            Rotation from the axes of the estimate to those of `weights`.
        """
        count = weights.shape[2]
        turned = weights if turn is None else np.einsum("pa,npk->nak", turn, weights)
        on_grid = np.zeros((self.grid.count, self._data.block, count))
        for axis in range(3):
            on_grid[:, axis] = self.grid.spread(turned[:, axis], t)
        flat = on_grid.reshape(-1, count)
        spread, _ = self._factor(constants=False).times(flat)
        return np.asarray(flat.T @ spread)

    def row_variance(self, rows: Any, beside: Array) -> Array:
        """Variance (R,) px^2 of what rows read: what the estimate predicts of matches that it did not use.

        Parameters
        ----------
        rows : (R, block * count) sparse
            By the unknowns of the grid, as `normal_equations.window_rows` makes them.
        beside : (R, Q) or (R, Q + E)
            By the static parameters, and the errors that wander.
        """
        factor = self._factor(constants=self.ties is not None)
        border = np.zeros((len(beside), factor.q))
        border[:, : beside.shape[1]] = beside
        return np.maximum(factor.row_variance(rows, border), 0.0)

    def hidden_covariance(self, drifts: Sequence[int] = ()) -> Array:
        """Covariance (H, H) rad^2 of how much the motion holds of each hidden direction, constants free.

        Parameters
        ----------
        drifts : sequence of int
            As given to `hidden_directions`, whose order this has.

        Notes
        -----
        A direction is the only one that holds the mean, or the drift from the middle to the ends, of its own
        axis: the covariance is that of these means and drifts. Priors alone bound them, and what attitude
        sensors and control points say. Those of the `ample` prior: where drifts are held says how the
        estimate chose among what images cannot tell apart, not how well that is known. A constant of roll or
        pitch shows by how motions about turned axes look, in a linear problem: what there is of it beside
        the drifts, not how far the attitude itself is off.
        """
        grid, block = self.grid, self._data.block
        own = [(0, axis) for axis in range(3)] + [(1, axis) for axis in drifts]
        shapes, weights = mean_and_drift(grid.count), np.zeros((grid.count, block, len(own)))
        for k, (shape, axis) in enumerate(own):
            weights[:, axis, k] = shapes[:, shape]
        flat = weights.reshape(-1, len(own))
        prior = replace(self._prior.ample or self.prior, even=True)
        if self.ties is not None:
            prior = replace(prior, own_precision=self._prior.own_precision).loosened(self.ties.tied)
        try:
            spread, _ = joint_factor(self._data, prior, constants=True).times(flat)
        except EstimationError:
            # nothing but the priors bounds some of them, by less than the equations are exact to
            sigmas = (prior.constant_sigma, prior.drift_sigma)
            return np.diag([sigmas[shape][axis] ** 2 for shape, axis in own])
        return np.asarray(flat.T @ spread)

    def absolute_sigma(self, t: Array, turn: Array | None = None) -> Array:
        """Sigma (N, 3) rad of the motion at `t`, hidden part included; infinite on axes that nothing ties.

        Parameters
        ----------
        t : (N,)
            s.
        turn : (3, 3), optional
            Rotation from the axes of the estimate to those of the result.
        """
        out = np.full((len(t), 3), np.inf)
        if self.ties is not None and self.ties.tied.any():
            turn = np.eye(3) if turn is None else turn
            factor = self._factor(constants=True)
            covariance = marginal_covariance(factor, self.grid, self._data.block, t)
            variance = np.einsum("ij,njk,ik->ni", turn, covariance, turn)
            # an axis that leans on one that nothing ties is tied by nothing
            tied = ~(np.abs(turn[:, ~self.ties.tied]) > 1e-9).any(axis=1)
            out[:, tied] = np.sqrt(variance[:, tied])
        return out

    def covariance_band(self, nodes: int = 4) -> Array:
        """Lower band of the motion's covariance in time, over `nodes` neighbouring nodes (constants held)."""
        block = self._data.block
        factor = self._factor(constants=False)
        band = factor.covariance_band(nodes * block - 1)
        if block == 3:
            return band
        keep = np.zeros((nodes * 3, 3 * self.grid.count))
        for p in range(3):
            for d in range(nodes * 3):
                q = (p + d) % 3
                ahead = (p + d) // 3
                row = ahead * block + q - p
                keep[d, p::3] = band[row, p::block] if row < len(band) else 0.0
        return keep

    def innovations(self) -> Array:
        """Scaled innovations of the estimated motion under the prior, (count, 3): about 1 where it fits."""
        centred = self.nodes - self.nodes.mean(axis=0)
        return np.stack([p.innovations(centred[:, k]) for k, p in enumerate(self._prior.angles)], axis=1)


def innovation_weights(estimate: JointEstimate) -> Array:
    """Weights (count, 3) that let the motion jump where its innovations are far beyond the prior's.

    Notes
    -----
    Estimated innovations are smaller than true ones; beyond JUMP sigmas a step or a switched-on tone is the
    better explanation, and the innovation keeps a weight that makes it one sigma. Only for a prior that was
    fitted to the data: under a prior of the wrong size every innovation looks like a jump.
    """
    e = np.abs(estimate.innovations())
    # the start-up rows answer to the removed mean, not to jumps
    e[:STARTUP_ROWS] = 0.0
    return np.where(e > JUMP, (1.0 / np.maximum(e, 1.0)) ** 2, 1.0)


def _unexplained(information: Array, k: int, others: Sequence[int]) -> float:
    """Share of the information on unknown `k` (unit diagonal) that `others`, all free, cannot imitate."""
    if information[k, k] <= 0.0:
        return 1.0
    between = information[np.ix_(others, others)]
    inverse = np.linalg.pinv(between, rcond=1e-10, hermitian=True)
    return max(float(1.0 - information[k, others] @ inverse @ information[others, k]), 1e-12)


def _unmixed(directions: Array, own: Sequence[tuple[int, int]], shapes: Array) -> Array:
    """Directions recombined so that each holds its own (shape, axis) once and that of no other.

    Parameters
    ----------
    directions : (count, 3, H)
    own : H times (int, int)
        Column of `shapes`, and axis.
    shapes : (count, 2)
        Constant and drift.
    """
    used = shapes[:, : 1 + max(shape for shape, _ in own)]
    content = np.linalg.lstsq(used, directions.reshape(len(shapes), -1), rcond=None)[0]
    content = content.reshape(used.shape[1], 3, -1)
    return np.asarray(directions @ np.linalg.inv(np.stack([content[shape, axis] for shape, axis in own])))


@dataclass(frozen=True, eq=False)
class _Banded:
    """Band of data + prior, factored: the same with and without a free constant per axis.

    `free` (size, F) are these constants, after other free shapes, `pulled` the prior's precision times them;
    `place` is where the unknowns of the grid stand; None where there are no others between them. `beside`
    (size, Q) are the statics.
    """

    factor: BandedFactor
    free: Array
    pulled: Array
    place: Index | None
    beside: Array

    @property
    def border(self) -> Array:
        """(size, Q + F); the statics, then what is free: made anew, for an estimate would hold it."""
        statics = self.beside.shape[1]
        out = scratch_array((len(self.beside), statics + self.pulled.shape[1]))
        for some in slices(len(out), ROWS_AT_ONCE):
            out[some, :statics], out[some, statics:] = self.beside[some], -self.pulled[some]
            let_go()
        return out

    @cached_property
    def tied(self) -> Array:
        """The inverse of the band times the border, (size, Q + F)."""
        return self.factor.solve(self.border)


def _banded_factor(data: NormalEquations, prior: JointPrior) -> _Banded:
    """Factor of the banded part of data + prior."""
    layout, block = prior.layout(data.grid.count, data.block), data.block
    free = prior.free_shapes(data.grid.count, block)
    # what matching and earlier solutions have freed would stay beside the large pieces of the factor
    give_back_memory()
    if layout is not None:
        return _laid_factor(data, prior, layout, free)
    n, width = data.ab.n, prior.width(block)
    pulled = scratch_array(free.shape)
    depth = min(max(width, data.ab.subdiagonals), n - 1) + 1

    def columns(first: int, last: int) -> Array:
        p = prior.precision_columns(first, last, block)[:depth]
        add_band_times(p, free, first, pulled)
        let_go()
        out = data.ab.columns(first, last)
        if depth > len(out):
            out = np.concatenate([out, np.zeros((depth - len(out), last - first))])
        out[: len(p)] += p
        return out

    factor = BandedFactor.of_columns(depth - 1, n, columns)
    return _Banded(factor, free, pulled, None, data.border)


def _laid_factor(data: NormalEquations, prior: JointPrior, layout: Layout, free: Array) -> _Banded:
    """The same where drifts have coarse unknowns of their own."""
    place, size = np.ascontiguousarray(layout.fine.ravel()), layout.size
    laid, beside = (scratch_array((size, known.shape[1])) for known in (free, data.border))
    laid[place], beside[place] = free, data.border
    pulled = scratch_array(laid.shape)
    own = prior.laid_width(layout)
    depth = max(own, farthest(place, data.ab.subdiagonals)) + 1
    let_go()
    give_back_memory()

    def columns(first: int, last: int) -> Array:
        # the data first: they come in pieces of other columns, beside which no more than one band has room
        out = np.zeros((depth, last - first))
        low, high = np.searchsorted(place, (first, last)).tolist()
        if low < high:
            spread_columns(data.ab.columns(low, high), place, low, out, first)
        p = prior.laid_columns(layout, first, last, own)
        add_band_times(p, laid, first, pulled)
        let_go()
        out[: len(p)] += p
        return out

    return _Banded(BandedFactor.of_columns(depth - 1, size, columns), laid, pulled, place, beside)


def _factor(banded: _Banded, data: NormalEquations, prior: JointPrior, *, constants: bool) -> Factor:
    """Factor of data + prior; the border holds statics, free shapes and, if asked, a constant per axis."""
    precision, sigma = prior.border_precision, prior.free_sigma
    statics, free = len(precision), len(sigma) - (0 if constants else 3)
    corner = np.zeros((statics + free,) * 2)
    corner[:statics, :statics] = data.corner + precision
    pulled = products(banded.free, banded.pulled)
    corner[statics:, statics:] = (pulled + np.diag(sigma**-2.0))[:free, :free]
    columns = len(corner)
    factor = BorderedFactor(banded.factor, banded.border[:, :columns], corner, banded.tied[:, :columns])
    return factor if banded.place is None else LaidFactor(factor, banded.place)


def _beside(data: NormalEquations, factor: Factor) -> Array:
    """The right side of all unknowns in the border of a factor; beyond those of the data it is zero."""
    return np.concatenate([data.rhs_static, np.zeros(factor.q - len(data.rhs_static))])


def joint_factor(data: NormalEquations, prior: JointPrior, *, constants: bool = False) -> Factor:
    """Factor of data + prior, constants of the motion held or not; statics and free shapes are its border."""
    return _factor(_banded_factor(data, prior), data, prior, constants=constants)


def mean_and_drift(count: int) -> Array:
    """Weights (count, 2) of a motion's mean over the grid, and of its drift from the middle to the end."""
    u = np.linspace(-1.0, 1.0, count)
    return np.stack([np.full(count, 1.0 / count), u / (u @ u)], axis=1)


def longest_gap(data: NormalEquations) -> int:
    """Most nodes in a row, between seen ones, that no measurement of roll, pitch or yaw touches."""
    seen = np.flatnonzero(data.ab.diagonal().reshape(-1, data.block)[:, :3].any(axis=1))
    return int(np.diff(seen).max(initial=1)) - 1


def solve_joint(images: NormalEquations, prior: JointPrior, ties: Ties | None = None) -> JointEstimate:
    """Posterior mean of motion, statics and relief for given data and prior.

    Parameters
    ----------
    images : NormalEquations
        What the matches say.
    prior : JointPrior
    ties : Ties, optional
        What attitude sensors and control points say. Axes that they tie to the world have a free constant.
    """
    data, prior = images, replace(prior, unshown=None)
    if ties is not None:
        data = add_ties(images, ties)
        # these see what moves all images alike
        prior = replace(prior, own_precision=ties.own_precision, common=None).loosened(ties.tied)
    banded = _banded_factor(data, prior)
    factor = _factor(banded, data, prior, constants=True)
    if prior.common is not None:
        prior = kept_common(factor, prior)
        factor = _factor(banded, data, prior, constants=True)
    statics = len(prior.statics_sigma)
    beside = statics + (0 if prior.slow_precision is None else len(prior.slow_precision))
    free = len(prior.free_sigma)
    x, y = factor.solve(data.rhs, _beside(data, factor))
    x, y = _held(factor, data, prior, x, y)
    nodes = x.reshape(data.grid.count, data.block)
    covariance = factor.border_covariance
    sigma = np.sqrt(np.diag(covariance)[:-free])
    relief = nodes[:, 3:].copy() if data.block == 5 else None
    return JointEstimate(
        data.grid,
        nodes[:, :3].copy(),
        relief,
        y[:statics],
        sigma[:statics],
        images,
        prior,
        y[beside:-free],
        sigma[beside:],
        ties,
        y[statics:beside],
        covariance[statics:beside, statics:beside].copy(),
    )


def kept_common(factor: Factor, prior: JointPrior) -> JointPrior:
    """The prior under which the equations say nothing of what moves all images alike.

    Bands that all look a little further ahead, and a roll with as much more of the yaw in it, leave all
    images as they are. All that speaks of it is that roll and yaw would be independent of each other: the
    equations take errors of the same matches in both for motions, and may be wrong by several sigmas.
    """
    weights, variance = prior.common_parts()
    q = len(weights)
    told = np.linalg.inv(weights.T @ factor.border_covariance[:q, :q] @ weights) - np.linalg.inv(variance)
    return replace(prior, unshown=weights @ told @ weights.T)


def _held(
    factor: Factor, data: NormalEquations, prior: JointPrior, x: Array, y: Array
) -> tuple[Array, Array]:
    """The solution given that no axis has a mean or a drift but for the sigma of its constant and its drift.

    A slow process of large sigma would carry a mean of its own past the prior of the constant; conditioning
    on the mean over the grid is an exact update of small rank. What it moves is hidden: relative covariances
    stay. Axes tied to the world keep their mean.

    Notes
    -----
    A drift that free offsets hide scales the motion: turning along with the scan by a share e of its rate, a
    motion of pitch moves the image by 1 + e of what it does otherwise. The linearised posterior then pays
    for its motions' size and earns nothing for their range, and its mode leans to the drift under which
    they are smallest, 4 % of the scan rate in 1500 lines: five sigmas of the offsets. A drift that the
    images, or sensors, do see is far better known than the constants' sigma, and stays.
    """
    block, count = data.block, data.grid.count
    axes = [axis for axis in range(3) if prior.constant_sigma[axis] < TIED_SIGMA]
    shapes, (common, _) = mean_and_drift(count), prior.common_parts()
    many = 2 * len(axes)
    seen, beside = (np.zeros((rows, many + common.shape[1])) for rows in (block * count, factor.q))
    for k, axis in enumerate(axes):
        seen[axis::block, 2 * k : 2 * k + 2] = shapes
    beside[: len(common), many:] = common
    top, bottom = factor.solve(seen, beside)
    sigmas = [s for axis in axes for s in (prior.constant_sigma[axis], prior.drift_sigma[axis])]
    held = np.diag(np.square(np.concatenate([sigmas, np.zeros(common.shape[1])])))
    gain = np.linalg.solve(seen.T @ top + beside.T @ bottom + held, seen.T @ x + beside.T @ y)
    return x - top @ gain, y - bottom @ gain


def _interpolated(band: Array, grid: TimeGrid, block: int, t: Array) -> Array:
    """(N, 3, 3) covariance at `t` from the band of the grid's covariance."""
    first, w = grid.weights(t)
    taps = w.shape[1]
    out = np.zeros((len(t), 3, 3))
    for i in range(taps):
        for j in range(taps):
            weight = w[:, i] * w[:, j]
            for p in range(3):
                for q in range(3):
                    row, column = (first + i) * block + p, (first + j) * block + q
                    low, high = np.minimum(row, column), np.maximum(row, column)
                    out[:, p, q] += weight * band[high - low, low]
    return out


def marginal_covariance(factor: Factor, grid: TimeGrid, block: int, t: Array) -> Array:
    """(N, 3, 3) posterior covariance of the three angles at `t`."""
    return _interpolated(factor.covariance_band(4 * block - 1), grid, block, t)


def projected_covariance(
    factor: Factor,
    grid: TimeGrid,
    block: int,
    t: Array,
    directions: Array,
    scale: Array,
    turn: Array | None = None,
) -> Array:
    """(N, 3, 3) covariance at `t` of the motion with `directions` (N, 3, H) removed by one unweighted fit.

    `turn` (3, 3) leads from the axes of the factor to those of the directions; none where they are the same.

    Notes
    -----
    With Q an orthonormal basis of the directions: ``C - Q Q'C - C Q Q' + Q (Q'CQ) Q'``, block diagonal only;
    C Q comes from H solves with the factor.
    """
    q3, parts = _orthonormal(directions, scale), slices(len(t), INSTANTS)
    h = q3.shape[2]
    turn = np.eye(3) if turn is None else turn
    # a pixel of each axis of the result, in the axes of the factor
    unit = turn / scale[:, None]
    on_grid = np.zeros((grid.count, block, h))
    for some in parts:
        in_factor = np.einsum("nph,pa->nah", q3[some], unit)
        for axis in range(3):
            on_grid[:, axis] += grid.spread(in_factor[:, axis], t[some])
    cq_grid = factor.times(on_grid.reshape(-1, h))[0].reshape(grid.count, block, h)
    del on_grid
    cq, inner = scratch_array(q3.shape), np.zeros((h, h))
    for some in parts:
        cq[some] = unit @ grid.interpolate(cq_grid[:, :3], t[some])
        inner += q3[some].reshape(-1, h).T @ cq[some].reshape(-1, h)
        let_go()
    del cq_grid
    band, out = factor.covariance_band(4 * block - 1), scratch_array((len(t), 3, 3))
    for some in parts:
        c = unit @ _interpolated(band, grid, block, t[some]) @ unit.T
        cross = np.einsum("nph,nqh->npq", cq[some], q3[some])
        c -= cross
        c -= cross.transpose(0, 2, 1)
        c += np.einsum("nph,hk,nqk->npq", q3[some], inner, q3[some])
        out[some] = c * np.outer(scale, scale)
        let_go()
    return out


def variance_between_nodes(spectrum: Spectrum, grid: TimeGrid, t: Array) -> Array:
    """Variance (N,) of a motion of known spectrum about its interpolation from the grid's nodes.

    What the motion does between nodes is not in the grid's covariance. Broad parts: ``k(0) - 2 w'k + w'Kw``
    with k the autocovariance at the distances to the nodes used and K between them. Tones are sinusoids over
    a few nodes: their variance times ``|1 - sum w exp(2 pi i f d)|^2``.
    """
    if len(t) > INSTANTS:
        parts = slices(len(t), INSTANTS)
        return np.concatenate([variance_between_nodes(spectrum, grid, t[some]) for some in parts])
    first, w = grid.weights(t)
    distance = grid.start + grid.step * (first[:, None] + np.arange(w.shape[1])) - t[:, None]
    apart = grid.step * np.abs(np.subtract.outer(np.arange(w.shape[1]), np.arange(w.shape[1])))
    total = np.zeros(len(t))
    for part in spectrum.components:
        if isinstance(part, Tone):
            response = np.einsum("nk,nk->n", w, np.exp(2j * np.pi * part.frequency * distance))
            total += part.sigma**2 * np.abs(1.0 - response) ** 2
        else:
            between = part.autocovariance(apart.ravel()).reshape(apart.shape)
            reach = part.autocovariance(np.abs(distance).ravel()).reshape(distance.shape)
            left = float(part.autocovariance(np.zeros(1))[0]) - 2.0 * np.einsum("nk,nk->n", w, reach)
            total += np.maximum(left + np.einsum("nk,kl,nl->n", w, between, w), 0.0)
    return total


def _orthonormal(directions: Array, scale: Array) -> Array:
    """Orthonormal basis (N, 3, H) of the directions in units of `scale`."""
    n, _, h = directions.shape
    if n <= INSTANTS:
        q, _ = np.linalg.qr((directions / scale[None, :, None]).reshape(n * 3, h))
        return np.asarray(q.reshape(n, 3, h))

    def flat(some: slice) -> Array:
        return np.asarray((directions[some] / scale[:, None]).reshape(-1, h))

    # some at a time: the triangle of all is that of their triangles
    parts, out = slices(n, INSTANTS), scratch_array((n, 3, h))
    triangles = np.concatenate([np.linalg.qr(flat(some), mode="r") for some in parts])
    inverse = np.linalg.inv(np.linalg.qr(triangles, mode="r"))
    for some in parts:
        out[some] = (flat(some) @ inverse).reshape(-1, 3, h)
        let_go()
    return out


def less_directions(values: Array, directions: Array, scale: Array) -> Array:
    """`values` (N, 3) less their least-squares fit by `directions` (N, 3, H), axes in units of `scale`."""
    q, parts = _orthonormal(directions, scale), slices(len(values), INSTANTS)
    held = np.zeros(q.shape[2])
    for some in parts:
        held += np.einsum("nph,np->h", q[some], values[some] / scale)
    out = np.empty(values.shape)
    for some in parts:
        out[some] = (values[some] / scale - np.einsum("nph,h->np", q[some], held)) * scale
        let_go()
    return out


def directions_at(grid: TimeGrid, directions: Array, t: Array) -> Array:
    """Hidden directions given on the grid, at the instants `t`: (N, 3, H)."""
    return grid.interpolate(directions, t)


def angles_at(estimate: JointEstimate, t: Array) -> Array:
    """Estimated angles (N, 3) rad at the instants `t`."""
    return estimate.grid.interpolate(estimate.nodes, t)


def nodes_on(estimate: JointEstimate, grid: TimeGrid) -> Array:
    """Estimated angles (count, 3) rad at the nodes of a grid that may be finer than the estimate's own.

    By a spline of degree 5: local cubics would leave images of the tones above the coarse grid's Nyquist
    frequency (a tenth of a tone of four nodes per period), where windows of a few lines hardly see them.
    """
    from scipy.interpolate import make_interp_spline

    if grid == estimate.grid:
        return estimate.nodes
    return np.asarray(make_interp_spline(estimate.grid.nodes, estimate.nodes, k=5)(grid.nodes))


__all__: Sequence[str] = (
    "JointEstimate",
    "JointPrior",
    "angles_at",
    "directions_at",
    "joint_factor",
    "less_directions",
    "longest_gap",
    "marginal_covariance",
    "mean_and_drift",
    "projected_covariance",
    "solve_joint",
)
