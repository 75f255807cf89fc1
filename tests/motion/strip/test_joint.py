"""The joint estimate against a dense Gaussian solution written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sightline.errors import EstimationError
from sightline.estimation.banded_blocks import StoredBand
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.estimation.split import split
from sightline.motion.measure.observations import Star, shared_image_correlation
from sightline.motion.strip import normal_equations as equations
from sightline.motion.strip.joint import (
    CONSTANT_SIGMA,
    DRIFT_SIGMA,
    JointEstimate,
    JointPrior,
    directions_at,
    innovation_weights,
    less_directions,
    longest_gap,
    marginal_covariance,
    nodes_on,
    solve_joint,
    variance_between_nodes,
)
from sightline.motion.strip.normal_equations import (
    GroundOrder,
    TimeGrid,
    modelled,
    modelled_by_blur,
    no_information,
    normal_equations,
    ordered_ground,
)

LAGS = (0.0741, 0.0233)
COUNT, STEP = 80, 0.01


def whole_covariance(estimate: JointEstimate, t: np.ndarray) -> np.ndarray:
    """Posterior covariance (N, 3, 3) of the angles at `t`, free constants included."""
    factor = estimate._factor(constants=True)
    return marginal_covariance(factor, estimate.grid, estimate._data.block, t)


def small_star(seed: int = 0, blocks: int = 3, duration: float = 0.0) -> Star:
    rng = np.random.default_rng(seed)
    rows, pairs = 40, len(LAGS)
    g = rows * blocks
    t_hub = np.repeat(np.linspace(0.02, 0.68, rows), blocks)
    t = t_hub[:, None] + np.array(LAGS) + 1e-4 * rng.standard_normal((g, 1))
    covariance = np.empty((g, pairs, 2, 2))
    a = 0.02 * rng.standard_normal((g, pairs, 2, 2))
    covariance[:] = a @ np.swapaxes(a, -1, -2) + 4e-4 * np.eye(2)
    by_hub = rng.standard_normal((g, pairs, 2, 3)).astype(np.float32)
    residual = 0.1 * rng.standard_normal((g, pairs, 2))
    residual[5, 0] = np.nan
    return Star(
        hub=0,
        images=(1, 2),
        shape=(rows, blocks),
        pixels=np.zeros((g, 2)),
        t_hub=t_hub,
        t=t,
        duration=duration,
        residual_px=residual,
        covariance_px=covariance,
        by_hub=by_hub,
        by_partner=(-by_hub + 0.01 * rng.standard_normal(by_hub.shape)).astype(np.float32),
        by_static=rng.standard_normal((g, pairs, 2, 2)).astype(np.float32),
        by_height=0.1 * rng.standard_normal((g, pairs, 2)).astype(np.float32),
        field=np.tile(np.linspace(-0.9, 0.9, blocks), rows),
        correlation=shared_image_correlation(pairs),
        weight=np.ones((g, pairs)),
    )


def lagrange(t: float) -> np.ndarray:
    """Cubic Lagrange row on the grid, by the definition."""
    row = np.zeros(COUNT)
    first = min(max(int(np.floor(t / STEP)) - 1, 0), COUNT - 4)
    nodes = (first + np.arange(4)) * STEP
    for k in range(4):
        others = np.delete(nodes, k)
        row[first + k] = np.prod((t - others) / (nodes[k] - others))
    return row


def dense_rows(star: Star, relief: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Design, data and error covariance of a star, one row at a time."""
    block = 5 if relief else 3
    rows, data, groups = [], [], []
    for g in range(len(star.t_hub)):
        members = []
        for k in range(len(LAGS)):
            if not np.isfinite(star.residual_px[g, k, 0]):
                continue
            for c in range(2):
                row = np.zeros((COUNT, block))
                row[:, :3] += lagrange(star.t_hub[g])[:, None] * star.by_hub[g, k, c]
                row[:, :3] += lagrange(star.t[g, k])[:, None] * star.by_partner[g, k, c]
                if relief:
                    row[:, 3] = lagrange(star.t_hub[g]) * star.by_height[g, k, c]
                    row[:, 4] = row[:, 3] * star.field[g]
                rows.append(np.concatenate([row.ravel(), star.by_static[g, k, c]]))
                data.append(star.residual_px[g, k, c])
                members.append((k, c))
        groups.append(members)
    total = np.zeros((len(rows), len(rows)))
    at = 0
    for g, members in enumerate(groups):
        factors = np.zeros((2 * len(LAGS), 2 * len(LAGS)))
        for k in range(len(LAGS)):
            factors[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.linalg.cholesky(star.covariance_px[g, k])
        full = factors @ star.correlation @ factors.T
        pick = [2 * k + c for k, c in members]
        total[at : at + len(pick), at : at + len(pick)] = full[np.ix_(pick, pick)]
        at += len(pick)
    return np.array(rows), np.array(data), total


def make_prior(relief: bool) -> tuple[JointPrior, list[np.ndarray]]:
    spectra = [
        Spectrum((Matern(s, 0.2, "5/2"), Matern(0.3 * s, 0.02, "3/2"))) for s in (1.0, 0.7, 0.5, 2.0, 1.0)
    ]
    processes = [s.autoregressive(STEP, COUNT - 1, COUNT) for s in spectra]
    lag = STEP * np.abs(np.subtract.outer(np.arange(COUNT), np.arange(COUNT)))
    dense = [s.autocovariance(lag.ravel()).reshape(lag.shape) for s in spectra]
    prior = JointPrior(tuple(processes[:3]), np.array([0.5, 0.8]), tuple(processes[3:]) if relief else None)
    return prior, dense


def dense_prior(prior: JointPrior, dense: list[np.ndarray], block: int) -> np.ndarray:
    """Covariance of all unknowns beforehand: `block` processes, node by node, then the statics."""
    size = COUNT * block
    k = np.zeros((size + 2, size + 2))
    for axis in range(block):
        k[axis:size:block, axis:size:block] = dense[axis]
    k[size:, size:] = np.diag(prior.statics_sigma**2)
    return k


@pytest.mark.parametrize(
    ("relief", "curves"), [(False, (0.0, 0.0, 0.0)), (True, (0.0, 0.0, 0.0)), (True, (3.0, 0.0, 0.4))]
)
def test_the_joint_posterior_is_the_dense_gaussian_one(relief: bool, curves: tuple[float, ...]) -> None:
    star = small_star()
    prior, dense = make_prior(relief)
    prior = replace(prior, curve_sigma=curves)
    grid = TimeGrid(0.0, STEP, COUNT)
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], relief=relief)
    estimate = solve_joint(data, prior)

    rows, y, noise = dense_rows(star, relief)
    block = 5 if relief else 3
    size = COUNT * block
    k = dense_prior(prior, dense, block)
    parabola = np.polynomial.legendre.legval(np.linspace(-1.0, 1.0, COUNT), [0.0, 0.0, 1.0])
    for axis in range(3):
        k[axis:size:block, axis:size:block] += CONSTANT_SIGMA[axis] ** 2
        k[axis:size:block, axis:size:block] += curves[axis] ** 2 * np.outer(parabola, parabola)
    gain = k @ rows.T @ np.linalg.inv(rows @ k @ rows.T + noise)
    # the estimate is also given that no axis has a mean or a drift but for their sigmas
    held = np.zeros((6, size + 2))
    u = np.linspace(-1.0, 1.0, COUNT)
    for axis in range(3):
        held[axis, axis:size:block] = 1.0 / COUNT
        held[3 + axis, axis:size:block] = u / (u @ u)
    rows_held = np.concatenate([rows, held])
    noise_held = np.zeros((len(rows_held), len(rows_held)))
    noise_held[: len(rows), : len(rows)] = noise
    noise_held[len(rows) :, len(rows) :] = np.diag(np.square(CONSTANT_SIGMA + DRIFT_SIGMA))
    spread = rows_held @ k @ rows_held.T + noise_held
    mean = k @ rows_held.T @ np.linalg.solve(spread, np.concatenate([y, np.zeros(6)]))
    covariance = k - gain @ rows @ k
    expected = mean[:size].reshape(COUNT, block)
    sigma = np.sqrt(np.diag(covariance)[:size].reshape(COUNT, block)[:, :3])
    # float32 sensitivities (1e-7) times the conditioning of the prior: far below a thousandth of sigma
    np.testing.assert_allclose(estimate.nodes, expected[:, :3], atol=2e-3 * sigma.max())
    np.testing.assert_allclose(estimate.statics, mean[size:], atol=2e-3)
    np.testing.assert_allclose(estimate.statics_sigma, np.sqrt(np.diag(covariance)[size:]), rtol=1e-3)

    t = grid.nodes[2:-2]
    marginal = whole_covariance(estimate, t)
    np.testing.assert_allclose(np.sqrt(marginal[:, [0, 1, 2], [0, 1, 2]]), sigma[2:-2], rtol=2e-3)

    # means of the three axes, then the drifts of two from the middle to the end
    sums = np.zeros((size + 2, 5))
    for axis in range(3):
        sums[axis:size:block, axis] = 1.0 / COUNT
    for column, axis in enumerate((2, 0), start=3):
        sums[axis:size:block, column] = u / (u @ u)
    # nothing is held: even drifts of the prior's sigmas are free, as constants are, and add to the processes
    loose = dense_prior(prior, dense, block)
    loose[:size, :size] += (k - dense_prior(prior, dense, block))[:size, :size]
    for axis in range(3):
        loose[axis:size:block, axis:size:block] += DRIFT_SIGMA[axis] ** 2 * np.outer(u, u)
    left = loose - loose @ rows.T @ np.linalg.solve(rows @ loose @ rows.T + noise, rows @ loose)
    found, want = estimate.hidden_covariance((2, 0)), sums.T @ left @ sums
    np.testing.assert_allclose(found, want, atol=2e-3 * want.max())


def test_where_equations_do_not_bound_what_is_hidden_it_is_known_as_priors_have_it(monkeypatch) -> None:
    """Sensitivities are exact to 1e-7: of directions that only priors bound there may be no factor."""
    prior, _ = make_prior(False)
    said, drifts = (0.3, 0.2, 0.4), (0.05, 0.06, 0.07)
    loose = replace(prior, statics_sigma=np.zeros(0), ample=None, constant_sigma=said, drift_sigma=drifts)
    estimate = solve_joint(no_information(TimeGrid(0.0, STEP, COUNT), 0), loose)

    def unfactored(*_, **__):
        raise EstimationError("not determined")

    monkeypatch.setattr("sightline.motion.strip.joint.joint_factor", unfactored)
    found = estimate.hidden_covariance((2, 0))
    np.testing.assert_array_equal(found, np.diag(np.square([*said, drifts[2], drifts[0]])))


def test_what_is_hidden_is_known_as_far_as_is_said_and_not_as_it_is_held() -> None:
    """Of a prior that holds roll and pitch, beside one that says how far they may be off."""
    prior, _ = make_prior(False)
    grid, said = TimeGrid(0.0, STEP, COUNT), (0.3, 0.2, 0.4)
    drifts = (0.05, 0.0, 0.07)
    nothing = no_information(grid, 0)
    held = replace(prior, statics_sigma=np.zeros(0), ample=None)
    loose = replace(held, constant_sigma=said, drift_sigma=drifts)
    beside = np.sqrt(np.diag(solve_joint(nothing, held).hidden_covariance((0, 1, 2))))
    found = np.sqrt(np.diag(solve_joint(nothing, replace(held, ample=loose)).hidden_covariance((0, 1, 2))))
    np.testing.assert_allclose(
        found**2 - beside**2,
        np.square(said + drifts) - np.square(CONSTANT_SIGMA + DRIFT_SIGMA),
        rtol=1e-6,
        atol=1e-15,
    )


@pytest.mark.parametrize("at_once", [13, 1000])
def test_the_relative_covariance_is_the_projected_dense_one(at_once: int, monkeypatch) -> None:
    monkeypatch.setattr("sightline.motion.strip.joint.INSTANTS", at_once)
    star = small_star(1)
    prior, dense = make_prior(False)
    grid = TimeGrid(0.0, STEP, COUNT)
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()])
    estimate = solve_joint(data, prior)
    directions = directions_at(grid, estimate.hidden_directions((0, 1, 2)), grid.nodes)
    t = grid.nodes
    scale = np.array([1.0, 2.0, 0.5])
    relative = estimate.relative_covariance(t, directions, scale)

    rows, _, noise = dense_rows(star, False)
    size = COUNT * 3
    k = np.zeros((size + 2, size + 2))
    for axis in range(3):
        k[axis:size:3, axis:size:3] = dense[axis]
    k[size:, size:] = np.diag(prior.statics_sigma**2)
    covariance = k - k @ rows.T @ np.linalg.inv(rows @ k @ rows.T + noise) @ rows @ k
    units = np.tile(scale, COUNT)
    flat = directions.reshape(size, -1) / units[:, None]
    projector = units[:, None] * (np.eye(size) - flat @ np.linalg.pinv(flat)) / units
    expected = projector @ covariance[:size, :size] @ projector.T
    for p in range(3):
        for q in range(3):
            want = expected[p::3, q::3].diagonal()
            np.testing.assert_allclose(relative[:, p, q], want, atol=2e-3 * expected.diagonal().max())


def test_rows_read_what_the_model_says() -> None:
    star = small_star(2)
    grid = TimeGrid(0.0, STEP, COUNT)
    rng = np.random.default_rng(3)
    nodes, statics = rng.standard_normal((COUNT, 5)), rng.standard_normal(2)
    rows, _, _ = dense_rows(star, True)
    got = modelled(star, grid, nodes, statics)
    seen = np.isfinite(star.residual_px)
    np.testing.assert_allclose(
        got[seen], rows @ np.concatenate([nodes.ravel(), statics]), rtol=1e-5, atol=1e-5
    )


def test_a_window_averages_the_motion_over_its_length() -> None:
    # a parabola c t^2 averaged over a window of length d about t is c (t^2 + d^2 / 12); the midpoint rule
    # with p points leaves c d^2 / (12 p^2), p = 2 + ceil(d / step) = 5
    star = small_star(4, duration=0.03)
    grid = TimeGrid(0.0, STEP, COUNT)
    nodes = np.zeros((COUNT, 3))
    nodes[:, 1] = grid.nodes**2
    got = modelled(star, grid, nodes, np.zeros(2))
    d = star.duration
    extra = d**2 / 12 * (1 - 1 / 25)
    inside = star.t.max(axis=1) + d < grid.nodes[-1]
    want = star.by_hub[..., 1] * (star.t_hub**2 + extra)[:, None, None]
    want = want + star.by_partner[..., 1] * (star.t**2 + extra)[:, :, None]
    np.testing.assert_allclose(got[inside], want[inside], atol=1e-6)


@pytest.mark.parametrize("at_once", [13, 1000])
def test_fitting_directions_away_leaves_nothing_along_them(at_once: int, monkeypatch) -> None:
    monkeypatch.setattr("sightline.motion.strip.joint.INSTANTS", at_once)
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((30, 3, 4))
    left = less_directions(rng.standard_normal((30, 3)), directions, np.ones(3))
    np.testing.assert_allclose(np.einsum("nph,np->h", directions, left), 0.0, atol=1e-12)


@pytest.mark.parametrize("relief", [False, True])
def test_the_band_in_time_is_that_of_the_dense_covariance_with_constants_held(relief: bool) -> None:
    star = small_star(5)
    prior, dense = make_prior(relief)
    grid = TimeGrid(0.0, STEP, COUNT)
    estimate = solve_joint(
        normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], relief=relief), prior
    )
    nodes = 3
    got = estimate.covariance_band(nodes)

    rows, _, noise = dense_rows(star, relief)
    block = 5 if relief else 3
    size = COUNT * block
    k = dense_prior(prior, dense, block)
    covariance = k - k @ rows.T @ np.linalg.inv(rows @ k @ rows.T + noise) @ rows @ k
    angles = np.arange(size).reshape(COUNT, block)[:, :3].ravel()
    covariance = covariance[np.ix_(angles, angles)]
    assert got.shape == (3 * nodes, 3 * COUNT)
    for d in range(3 * nodes - 2):
        # float32 sensitivities, as above
        want = np.diag(covariance, -d)
        np.testing.assert_allclose(got[d, : 3 * COUNT - d], want, atol=2e-3 * covariance.max())

    # sums of the motion over its whole length, in axes turned by a permutation
    weights = np.random.default_rng(0).standard_normal((COUNT, 3, 4)) / np.sqrt(3 * COUNT)
    turn = np.eye(3)[[1, 2, 0]]
    sums = estimate.functional_covariance(grid.nodes, weights, turn)
    flat = weights[:, [2, 0, 1]].reshape(3 * COUNT, 4)
    want = flat.T @ covariance @ flat
    np.testing.assert_allclose(sums, want, atol=2e-3 * want.max())


class TestInterpolationVariance:
    GRID = TimeGrid(0.0, STEP, COUNT)

    @staticmethod
    def departures(t: np.ndarray) -> np.ndarray:
        """Weights of (motion at t, motion at the nodes) that make the error of interpolation."""
        return np.array([np.concatenate([[1.0], -lagrange(instant)]) for instant in t])

    def test_of_broad_motion_it_is_the_variance_left_by_the_weights(self) -> None:
        spectrum = Spectrum((Matern(1.5, 0.2, "5/2"), Matern(0.4, 0.015, "3/2")))
        t = np.random.default_rng(0).uniform(0.05, 0.7, 20)
        want = []
        for instant, row in zip(t, self.departures(t), strict=True):
            every = np.concatenate([[instant], self.GRID.nodes])
            lags = np.abs(np.subtract.outer(every, every))
            want.append(row @ spectrum.autocovariance(lags.ravel()).reshape(lags.shape) @ row)
        # differences of variances of 2.4: rounding 1e-15 each
        np.testing.assert_allclose(
            variance_between_nodes(spectrum, self.GRID, t), want, rtol=1e-6, atol=1e-12
        )
        assert max(want) > 1e-3

    def test_of_a_tone_it_is_that_of_sinusoids_of_any_phase(self) -> None:
        frequency, sigma = 23.0, 0.7
        t = np.random.default_rng(1).uniform(0.05, 0.7, 20)
        phases = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
        square = np.zeros(len(t))
        for phase in phases:
            for n, (instant, row) in enumerate(zip(t, self.departures(t), strict=True)):
                every = np.concatenate([[instant], self.GRID.nodes])
                square[n] += (row @ (np.sqrt(2) * sigma * np.cos(2 * np.pi * frequency * every + phase))) ** 2
        spectrum = Spectrum((Tone(sigma, frequency, 0.01),))
        got = variance_between_nodes(spectrum, self.GRID, t)
        # twelve phases average a squared sinusoid exactly; half-way between nodes cubic interpolation misses
        # by 9 / 384 (2 pi f step)^4 = 10 % of the amplitude, 1 % of the variance
        np.testing.assert_allclose(got, square / len(phases), rtol=1e-9)
        assert got.max() > 0.005 * sigma**2

    def test_parts_of_a_spectrum_add_up_and_nodes_have_none(self) -> None:
        parts = (Matern(1.0, 0.02, "3/2"), Tone(0.5, 20.0, 0.1))
        t = np.linspace(0.1, 0.6, 33)
        whole = variance_between_nodes(Spectrum(parts), self.GRID, t)
        each = [variance_between_nodes(Spectrum((part,)), self.GRID, t) for part in parts]
        np.testing.assert_allclose(whole, each[0] + each[1], rtol=1e-12)
        at_nodes = variance_between_nodes(Spectrum(parts), self.GRID, self.GRID.nodes)
        np.testing.assert_allclose(at_nodes, 0.0, atol=1e-12)


class TestInnovationWeights:
    COUNT, JUMP_AT, AXIS = 300, 200, 1

    def estimate(self, nodes: np.ndarray) -> tuple[JointEstimate, np.ndarray]:
        """An estimate whose prior is a Matern motion, and the dense covariance of that."""
        star = small_star()
        grid = TimeGrid(0.0, STEP, self.COUNT)
        spectrum = Spectrum((Matern(1.0, 0.1, "3/2"),))
        process = spectrum.autoregressive(STEP, self.COUNT - 1, self.COUNT)
        data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()])
        prior = JointPrior((process, process, process), np.array([0.5, 0.8]))
        return JointEstimate(grid, nodes, None, np.zeros(2), np.zeros(2), data, prior), self.dense()

    def dense(self) -> np.ndarray:
        """Written out: (1 + a) exp(-a) with a = sqrt(3) lag / timescale."""
        a = (
            np.sqrt(3.0)
            * STEP
            * np.abs(np.subtract.outer(np.arange(self.COUNT), np.arange(self.COUNT)))
            / 0.1
        )
        return (1 + a) * np.exp(-a) + 1e-9 * np.eye(self.COUNT)

    def drawn(self) -> np.ndarray:
        white = np.random.default_rng(6).standard_normal((self.COUNT, 3))
        return np.linalg.cholesky(self.dense()) @ white

    def test_motion_of_the_prior_s_own_kind_is_held_everywhere(self) -> None:
        # of 900 innovations one beyond 4.5 sigmas has odds of 0.6 %
        weights = innovation_weights(self.estimate(self.drawn())[0])
        np.testing.assert_array_equal(weights, 1.0)

    def test_a_step_is_let_go_where_and_on_the_axis_it_happens(self) -> None:
        nodes = self.drawn()
        nodes[self.JUMP_AT :, self.AXIS] += 3.0
        estimate, dense = self.estimate(nodes)
        weights = innovation_weights(estimate)
        loose = np.argwhere(weights < 1.0)
        assert (loose[:, 1] == self.AXIS).all()
        assert loose[:, 0].min() == self.JUMP_AT
        # whitened with the dense covariance the innovation there is far beyond; its weight makes it one sigma
        centred = nodes[:, self.AXIS] - nodes[:, self.AXIS].mean()
        white = np.linalg.solve(np.linalg.cholesky(dense), centred)
        assert abs(white[self.JUMP_AT]) > 10
        np.testing.assert_allclose(
            weights[self.JUMP_AT, self.AXIS] * white[self.JUMP_AT] ** 2, 1.0, rtol=0.01
        )


@pytest.mark.parametrize("relief", [False, True])
def test_drifts_on_a_grid_of_their_own_give_the_same_posterior(relief):
    spectrum = Spectrum((Matern(1.0, 3.0, "5/2"), Matern(0.05, 0.02)))
    order = COUNT - 1
    whole = spectrum.autoregressive(STEP, order, COUNT)
    part = split(spectrum, STEP, order, COUNT, ratio=6)
    assert part is not None
    star = small_star()
    grid = TimeGrid(0.0, STEP, COUNT)
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], relief=relief)
    ground = Spectrum((Matern(2.0, 0.05),)).autoregressive(STEP, 8, COUNT)
    plain = JointPrior((whole,) * 3, np.array([0.5, 0.5]), (ground, ground) if relief else None)
    apart = JointPrior(
        plain.angles, plain.statics_sigma, plain.relief, None, plain.constant_sigma, (part,) * 3
    )
    one, other = solve_joint(data, plain), solve_joint(data, apart)
    t = grid.nodes[3:-3]
    sigma = np.sqrt(whole_covariance(one, t)[:, [0, 1, 2], [0, 1, 2]])
    # both are exact but for the cubic between coarse nodes a fiftieth of the timescale apart: 1e-4 of the
    # drift of 1, against sigmas of a hundredth
    assert np.abs((other.nodes - one.nodes)[3:-3] / sigma).max() < 0.03
    again = np.sqrt(whole_covariance(other, t)[:, [0, 1, 2], [0, 1, 2]])
    np.testing.assert_allclose(again, sigma, rtol=0.02)
    np.testing.assert_allclose(other.statics_sigma, one.statics_sigma, rtol=0.02)


def test_the_longest_gap_is_counted_between_nodes_that_are_seen():
    star = small_star()
    away = (star.t_hub[:, None] < 0.3) & (star.t < 0.3) | (star.t_hub[:, None] > 0.5)
    star = star.with_weight(np.where(away, 1.0, 0.0))
    data = normal_equations(
        [star], [star.residual_px], TimeGrid(0.0, STEP, COUNT), orders=[GroundOrder()], relief=False
    )
    # up to two nodes beyond 0.3 and before 0.5 s are interpolated from
    assert 15 <= longest_gap(data) <= 19


@pytest.mark.parametrize("relief", [False, True])
def test_sums_do_not_depend_on_the_pieces_they_are_made_of(monkeypatch, relief):
    stars = [small_star(0, duration=0.017), small_star(1, blocks=4)]
    grid = TimeGrid(0.0, STEP, COUNT)
    measured = [s.residual_px for s in stars]
    nodes = np.random.default_rng(2).standard_normal((COUNT, 5 if relief else 3))

    def summed(patches, most_bytes=10**9):
        monkeypatch.setattr(equations, "PART_PATCHES", patches)
        monkeypatch.setattr(equations, "PART_BYTES", most_bytes)
        data = normal_equations(
            stars, measured, grid, orders=[GroundOrder(), GroundOrder(0.03)], relief=relief
        )
        return data, [modelled(s, grid, nodes, np.ones(2), GroundOrder(0.03)) for s in stars]

    whole, read = summed(10**6)
    for limits in ((9,), (10**6, 1)):
        parts, read_in_parts = summed(*limits)
        for name in ("ab", "border", "corner", "rhs", "rhs_static", "chi2", "rows"):
            one, many = (
                np.asarray(part.whole() if isinstance(part, StoredBand) else part)
                for part in (getattr(whole, name), getattr(parts, name))
            )
            # sums of some hundred terms in another order: 1e-13 of the largest
            np.testing.assert_allclose(many, one, rtol=0, atol=1e-13 * np.abs(one).max())
        for one, many in zip(read, read_in_parts, strict=True):
            np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize("most_bytes", [10**9, 10**6, 1])
def test_rows_far_apart_are_summed_in_parts_whose_bands_have_room(monkeypatch, most_bytes):
    star, grid = small_star(), TimeGrid(0.0, STEP / 8, 8 * COUNT)  # 14 nodes from row to row
    monkeypatch.setattr(equations, "PART_BYTES", most_bytes)
    summed, bands = equations._summed, []

    def noted(*given):
        found = summed(*given)
        bands.append(max(one.ab.nbytes for one in found.stretches))
        return found

    monkeypatch.setattr(equations, "_summed", noted)
    orders = [GroundOrder()]
    normal_equations([star], [star.residual_px], grid, orders=orders, relief=False)
    width = equations.bandwidth_of([star], grid, 3, orders, False)
    if most_bytes == 1:
        # as many nodes between its rows as its lags reach beyond them, and the eight that interpolation takes
        assert max(bands) <= 8 * (width + 1) * (2 * width + 3 * 8)
    else:
        assert max(bands) <= most_bytes
    assert (len(bands) == 1) == (most_bytes == 10**9)


def test_a_motion_found_on_a_coarse_grid_is_carried_to_a_finer_one_without_images_of_its_tones():
    fine = TimeGrid(-0.01, 1e-3, 401)
    coarse = fine.coarser(2)
    assert coarse.nodes[0] == fine.nodes[0]
    assert coarse.nodes[-1] >= fine.nodes[-1] > coarse.nodes[-2]

    def tone(t):
        return np.sin(2 * np.pi * 121.0 * t)[:, None] * np.ones(3)

    estimate = JointEstimate(coarse, tone(coarse.nodes), None, np.zeros(0), np.zeros(0), None, None)
    error = (nodes_on(estimate, fine) - tone(fine.nodes))[20:-20]
    # x = 121 Hz of 500 Hz sampled: splines of degree 5 leave about 2 (x / (1 - x))^6 = 0.2 % of a tone; local
    # cubics leave its image, 13 %
    assert np.abs(error).max() < 0.004
    assert np.abs(coarse.interpolate(estimate.nodes, fine.nodes) - tone(fine.nodes))[20:-20].max() > 0.05
    assert nodes_on(estimate, coarse) is estimate.nodes


def test_ground_of_all_hubs_lies_on_the_grid_and_one_place_at_one_instant():
    grid = TimeGrid(-0.2, 0.01, 141)
    hubs, delays = [np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1.0, 11)], [0.0, 0.3]
    orders = ordered_ground(hubs, delays, grid)
    placed = [order.of(t) for order, t in zip(orders, hubs, strict=True)]
    inside = grid.nodes[1], grid.nodes[-2]
    assert all(inside[0] - 1e-12 <= t.min() and t.max() <= inside[1] + 1e-12 for t in placed)
    # what the second hub sees 0.3 s later than the first
    np.testing.assert_allclose(placed[1][3:], placed[0][:-3], atol=1e-12)
    np.testing.assert_allclose(orders[0].seen(placed[0]), hubs[0], atol=1e-12)
    # with room enough instants are kept, up to a shift
    assert orders[0].rate == 1.0
    assert ordered_ground(hubs[:1], [0.0], grid)[0] == GroundOrder()


def test_ground_that_has_no_room_on_the_grid_is_laid_closer():
    grid = TimeGrid(0.0, 0.01, 101)
    hubs = [np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1.0, 11)]
    orders = ordered_ground(hubs, [0.0, 0.3], grid)
    placed = np.concatenate([order.of(t) for order, t in zip(orders, hubs, strict=True)])
    np.testing.assert_allclose([placed.min(), placed.max()], [grid.nodes[1], grid.nodes[-2]], atol=1e-12)
    assert orders[0].rate == pytest.approx(0.98 / 1.3)


def test_what_is_seen_along_the_lines_may_average_over_longer() -> None:
    # the parabola of the test above: lines see it over the longer time, columns over the shorter
    star = replace(small_star(4, duration=0.03), stretch=0.02)
    grid = TimeGrid(0.0, STEP, COUNT)
    nodes = np.zeros((COUNT, 3))
    nodes[:, 1] = grid.nodes**2
    got = modelled(star, grid, nodes, np.zeros(2))
    inside = star.t.max(axis=1) + 0.05 < grid.nodes[-1]
    for c, d in enumerate((0.05, 0.03)):
        points = 2 + np.ceil(d / STEP - 1e-9)
        extra = d**2 / 12 * (1 - 1 / points**2)
        want = star.by_hub[..., c, 1] * (star.t_hub**2 + extra)[:, None]
        want = want + star.by_partner[..., c, 1] * (star.t**2 + extra)
        np.testing.assert_allclose(got[inside, :, c], want[inside], atol=1e-6)


@pytest.mark.parametrize("relief", [False, True])
def test_the_information_of_stretched_rows_is_that_of_what_they_read(relief: bool) -> None:
    # x' N x is the squared length, in units of the noise, of what the rows read for the motion x
    star = replace(small_star(6, duration=0.03), stretch=0.02)
    grid = TimeGrid(0.0, STEP, COUNT)
    block = 5 if relief else 3
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], relief=relief)
    rng = np.random.default_rng(7)
    nodes, statics = rng.standard_normal((COUNT, block)), rng.standard_normal(2)
    read = modelled(star, grid, nodes, statics)
    _, _, noise = dense_rows(star, relief)
    seen = read[np.isfinite(star.residual_px)]
    want = seen @ np.linalg.solve(noise, seen)
    along, across = data.times(nodes.ravel())
    found = nodes.ravel() @ along + 2.0 * statics @ across + statics @ data.corner @ statics
    np.testing.assert_allclose(found, want, rtol=1e-6)


@pytest.mark.parametrize("stretch", [0.0, 0.02])
def test_stages_that_count_unevenly_add_what_they_say_of_instants_beside_the_middle(stretch: float) -> None:
    # one row by hand: what is added is the motion at instants beside those of hub and partner
    rng = np.random.default_rng(3)
    star = replace(small_star(6, duration=0.03), stretch=stretch)
    size, at = star.t.shape, 0.004 * np.arange(-2.0, 3.0)
    uneven = rng.standard_normal((*size, 2, 2, 3, len(at))).astype(np.float32)
    tdi = (np.full(len(star.t), 0.01), np.full(size, 0.01))
    star = replace(star, tdi_hub=tdi[0], tdi=tdi[1])
    with_weights = replace(star, uneven=uneven, uneven_at=at)
    grid = TimeGrid(0.0, STEP, COUNT)
    nodes, statics = rng.standard_normal((COUNT, 3)), rng.standard_normal(2)
    read = modelled(with_weights, grid, nodes, statics)
    more = read - modelled(star, grid, nodes, statics)
    assert_close = np.testing.assert_allclose
    assert_close(modelled_by_blur(with_weights, grid, nodes), more, atol=1e-12)
    for g, k in ((7, 0), (60, 1), (101, 1)):
        want = np.zeros(2)
        for side, t in enumerate((star.t_hub[g], star.t[g, k])):
            moved = np.array([lagrange(t + o) @ nodes for o in at])
            want += np.einsum("cab,ba->c", uneven[g, k, side].astype(float), moved)
        assert_close(more[g, k], want, rtol=1e-9)
    # and the rows' information is that of what they read
    data = normal_equations([with_weights], [star.residual_px], grid, orders=[GroundOrder()])
    _, _, noise = dense_rows(star, relief=False)
    seen = read[np.isfinite(star.residual_px)]
    along, across = data.times(nodes.ravel())
    found = nodes.ravel() @ along + 2.0 * statics @ across + statics @ data.corner @ statics
    assert_close(found, seen @ np.linalg.solve(noise, seen), rtol=1e-6)
    measured = star.residual_px[np.isfinite(star.residual_px)]
    right = nodes.ravel() @ data.rhs + statics @ data.rhs_static
    assert_close(right, seen @ np.linalg.solve(noise, measured), rtol=1e-6)


def test_the_motion_moves_by_what_more_in_the_measurements_moves_it() -> None:
    star, grid = small_star(), TimeGrid(-0.05, STEP, COUNT)
    orders = ordered_ground([star.t_hub[star.present.any(axis=1)]], [0.0], grid)
    prior, _ = make_prior(False)
    more = 0.03 * np.random.default_rng(4).standard_normal(star.residual_px.shape) + 0.0 * star.residual_px
    estimates = []
    for measured in (star.residual_px, star.residual_px + more):
        estimates.append(solve_joint(normal_equations([star], [measured], grid, orders=orders), prior))
    moved = estimates[0].moved_by(normal_equations([star], [more], grid, orders=orders))
    difference = estimates[1].nodes - estimates[0].nodes
    # both are sums over the same rows, of some hundred terms
    np.testing.assert_allclose(moved, difference, rtol=0, atol=1e-8 * np.abs(difference).max())


@pytest.mark.parametrize("relief", [False, True])
def test_what_rows_show_of_a_wave_is_the_slope_and_bend_of_the_dense_likelihood(relief: bool) -> None:
    star, grid = small_star(2), TimeGrid(0.0, STEP, COUNT)
    prior, dense = make_prior(relief)
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], relief=relief)
    # waves about which means and drifts, known by themselves, say nothing: eight periods, tapered
    t = grid.nodes / (STEP * COUNT)
    waves = np.zeros((COUNT, 3, 4))
    waves[:, 0, 0], waves[:, 0, 1] = (f(16.0 * np.pi * t) * np.sin(np.pi * t) ** 2 for f in (np.cos, np.sin))
    waves[:, 1, 2], waves[:, 2, 3] = waves[:, 0, 0], waves[:, 0, 1]
    score, information = solve_joint(data, prior).shown_of(waves)

    rows, y, noise = dense_rows(star, relief)
    block = 5 if relief else 3
    size = COUNT * block
    k = dense_prior(prior, dense, block)
    laid = np.zeros((COUNT, block, 4))
    laid[:, :3] = waves
    seen = rows[:, :size] @ laid.reshape(size, 4)
    weighed = np.linalg.solve(rows @ k @ rows.T + noise, seen)
    expected = weighed.T @ seen
    # the mean of the motion is held in the one and the free in the other: some thousandths
    np.testing.assert_allclose(information, expected, rtol=0, atol=0.01 * expected.max())
    np.testing.assert_allclose(score, weighed.T @ y, rtol=0, atol=0.05 * np.sqrt(expected.max()))


def test_the_likelihood_of_a_relief_is_that_of_the_dense_gaussian() -> None:
    star, grid = small_star(2), TimeGrid(0.0, STEP, COUNT)
    prior, dense = make_prior(True)
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], relief=True)
    estimate = solve_joint(data, prior)
    rows, y, noise = dense_rows(star, True)
    size, found, expected = 5 * COUNT, [], []
    for share in (1.0, 0.3, 0.05):
        spectra = [Spectrum((Matern(share * s, 0.2, "5/2"),)) for s in (2.0, 1.0)]
        first, second = (s.autoregressive(STEP, COUNT - 1, COUNT) for s in spectra)
        found.append(estimate.likelihood_of((first, second)))
        lag = STEP * np.abs(np.subtract.outer(np.arange(COUNT), np.arange(COUNT)))
        known = [*dense[:3], *(s.autocovariance(lag.ravel()).reshape(lag.shape) for s in spectra)]
        k = dense_prior(prior, known, 5)
        for axis in range(3):
            k[axis:size:5, axis:size:5] += CONSTANT_SIGMA[axis] ** 2
        spread = rows @ k @ rows.T + noise
        expected.append(-0.5 * (np.linalg.slogdet(spread)[1] + y @ np.linalg.solve(spread, y)))
    # a constant stands between them; float32 sensitivities times the conditioning of the prior, as above
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=2e-3, atol=2e-3)


def test_rows_far_apart_add_what_they_add_alone_and_hold_no_band_between_them() -> None:
    star, many = small_star(), TimeGrid(0.0, STEP, 20 * COUNT)
    early, late = (slice(0, 6), slice(114, 120))
    apart = 15.0

    def some(part: slice, later: float) -> Star:
        names = ("pixels", "residual_px", "covariance_px", "by_hub", "by_partner", "by_static", "by_height")
        arrays = {name: getattr(star, name)[part] for name in (*names, "field", "weight")}
        t_hub, t = star.t_hub[part] + later, star.t[part] + later
        return replace(star, shape=(2, 3), t_hub=t_hub, t=t, **arrays)

    first, last = some(early, 0.0), some(late, apart)
    both = replace(
        first,
        shape=(4, 3),
        **{
            name: np.concatenate([getattr(first, name), getattr(last, name)])
            for name in (
                "pixels", "t_hub", "t", "residual_px", "covariance_px", "by_hub", "by_partner", "by_static",
                "by_height", "field", "weight",
            )
        },
    )  # fmt: skip
    one, two, whole = (
        normal_equations([s], [s.residual_px], many, orders=[GroundOrder()]) for s in (first, last, both)
    )
    np.testing.assert_array_equal(whole.ab.whole(), one.ab.whole() + two.ab.whole())
    np.testing.assert_array_equal(whole.border, one.border + two.border)
    # the corner is summed on from the first rows to the last: rounded elsewhere
    np.testing.assert_allclose(whole.corner, one.corner + two.corner, rtol=1e-12)
    assert whole.rows == one.rows + two.rows
    # a band of two rows reaches over a lag, not over what lies between them: 15 s are 1,500 nodes
    piece = equations._Piece(both, both.residual_px, GroundOrder(), slice(0, 12))
    held = sum(part.ab.shape[1] for part in equations._summed(piece, many, 3, 60).stretches)
    assert held < 3 * 2 * (max(LAGS) / STEP + 4 + 20)
