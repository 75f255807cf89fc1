"""Errors that wander along the strip: what they move, their part in the estimate, how sizes are learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import plain_star
from sightline.estimation.prior import Matern, Spectrum
from sightline.motion.measure.match_noise import lasts
from sightline.motion.measure.observations import Star
from sightline.motion.strip import normal_equations as equations
from sightline.motion.strip.estimate import _same_sizes
from sightline.motion.strip.joint import JointEstimate, JointPrior, solve_joint
from sightline.motion.strip.normal_equations import GroundOrder, TimeGrid, normal_equations
from sightline.motion.strip.slow_errors import LENGTH_LINES, NODE_LINES, SlowErrors, slow_errors

SIGMA = 0.05
#: Correlation of an error with itself at the next node: Gauss-Markov.
KEPT = np.exp(-NODE_LINES / LENGTH_LINES)


def strip_star(rows: int = 400, blocks: int = 10, seed: int = 0) -> Star:
    """Rows of windows every four lines of 1 ms, two partners, nothing but noise."""
    star = plain_star(rows, blocks, 2, SIGMA)
    noise = SIGMA * np.random.default_rng(seed).standard_normal((rows * blocks, 2, 2))
    t = np.repeat(0.004 * np.arange(rows), blocks)
    return replace(
        star, t_hub=t, t=t[:, None] + [0.05, 0.08], duration=0.004, window=(4, 100), residual_px=noise
    )


def nodes_of(star: Star, sizes: np.ndarray) -> SlowErrors:
    step = NODE_LINES * 1e-3
    count = int(np.ceil(star.t_hub.max() / step)) + 1
    return SlowErrors(0.0, step, count, (0, 1, 2), sizes)


def drawn(slow: SlowErrors, seed: int) -> np.ndarray:
    """Errors at the nodes (count, I) px, drawn from what is believed of them, node by node."""
    unit = np.random.default_rng(seed).standard_normal((slow.count, len(slow.sizes)))
    for k in range(1, slow.count):
        unit[k] = KEPT * unit[k - 1] + np.sqrt(1.0 - KEPT**2) * unit[k]
    return unit * slow.sizes


def shifts(star: Star, slow: SlowErrors, nodes: np.ndarray) -> np.ndarray:
    """What the errors move each window by, (G, K, 2): a partner's less the hub's, along lines."""
    t = slow.start + slow.step * np.arange(slow.count)
    out = np.zeros((len(star.t_hub), 2, 2))
    for g, now in enumerate(star.t_hub):
        here = [np.interp(now, t, nodes[:, image]) for image in range(3)]
        out[g, :, 0] = here[1] - here[0], here[2] - here[0]
    return out


def test_what_unknowns_move_is_a_partner_s_error_less_the_hub_s() -> None:
    star = strip_star(100, 4)
    slow = nodes_of(star, np.full(3, 0.02))
    nodes = drawn(slow, 1)
    expected = shifts(star, slow, nodes)
    assert_allclose(slow.moved(star, star.t_hub, nodes.ravel()), expected, atol=1e-12)
    for part in (slice(0, 80), slice(80, 400)):
        near, columns = slow.columns(star, star.t_hub[part])
        assert_allclose(columns @ nodes.ravel()[near], expected[part], atol=1e-7)


def test_the_precision_is_that_of_a_gauss_markov_process() -> None:
    slow = SlowErrors(0.0, 0.1, 7, (0, 1), np.array([0.01, 0.03]))
    apart = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    covariance = np.kron(KEPT**apart, np.diag(slow.sizes**2))
    assert_allclose(slow.precision @ covariance, np.eye(14), atol=1e-9)


def estimated(star: Star, slow: SlowErrors | None) -> JointEstimate:
    """Of a strip that hardly moves: what wanders is found, not taken for motion."""
    grid = TimeGrid(-0.02, 0.01, int(star.t.max() / 0.01) + 8)
    still = Spectrum((Matern(1e-10, 0.2, "5/2"), Matern(1e-10, 0.02, "3/2")))
    processes = (still.autoregressive(grid.step, 10, grid.count),) * 3
    data = normal_equations([star], [star.residual_px], grid, orders=[GroundOrder()], slow=slow)
    statics = np.full(star.by_static.shape[3], 1e-6)
    wander = None if slow is None else slow.precision
    return solve_joint(data, JointPrior(processes, statics, slow_precision=wander))


@pytest.mark.parametrize("rows", [64, 9])
def test_the_posterior_is_that_of_a_dense_gaussian(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    monkeypatch.setattr(equations, "SLOW_ROWS", rows)
    star = strip_star(80, 3, seed=2)
    slow = nodes_of(star, np.array([0.03, 0.01, 0.02]))
    found = estimated(star, slow)
    # the motion is held still: what is left is linear in the errors, with noise that two pairs share
    t = slow.start + slow.step * np.arange(slow.count)
    tent = np.stack([np.interp(star.t_hub, t, unit) for unit in np.eye(slow.count)], axis=1)
    design = np.zeros((len(tent), 2, 2, slow.count, 3))
    for k in (0, 1):
        design[:, k, 0, :, 1 + k] = tent
        design[:, k, 0, :, 0] = -tent
    noise = np.linalg.inv(SIGMA**2 * star.correlation)
    rows_of = design.reshape(len(tent), 4, -1)
    information = np.einsum("gru,rs,gsv->uv", rows_of, noise, rows_of)
    right = np.einsum("gru,rs,gs->u", rows_of, noise, star.residual_px.reshape(-1, 4))
    covariance = np.linalg.inv(information + slow.precision)
    size = np.sqrt(np.diag(covariance))
    # the motion may still move by 2e-5 px, the sensitivities are float32
    assert_allclose(found.slow, covariance @ right, atol=1e-3 * size.max())
    assert_allclose(found.slow_covariance, covariance, atol=2e-3 * size.max() ** 2)


def test_sizes_are_learned() -> None:
    true = np.array([0.06, 0.0, 0.04])
    star = strip_star(1100, 6)
    slow = nodes_of(star, true)
    moved = shifts(star, slow, drawn(slow, 10))
    star = replace(star, residual_px=star.residual_px + moved, correlation=np.eye(4))
    slow = replace(slow, sizes=np.full(3, 0.02))
    for _ in range(5):
        found = estimated(star, slow)
        slow = slow.learned(found.slow, found.slow_covariance)
    # 38 nodes, of which one in some five is worth an independent value: variances to a factor of 3
    assert_allclose(np.log(slow.sizes[[0, 2]] / true[[0, 2]]), 0.0, atol=0.5 * np.log(3.0))
    # what is not there falls; eight independent values of the others leave it some part of theirs
    assert slow.sizes[1] < 0.02


def test_rows_that_share_pixels_are_no_errors_that_last() -> None:
    star = strip_star(600, 8)
    # windows of four rows: each errs as the mean of four independent ones
    own = star.residual_px.reshape(600, 8, 2, 2)
    mean = sum(np.roll(own, shift, axis=0) for shift in range(4)) / 2.0
    period = float(np.diff(star.t_hub.reshape(600, 8)[:, 0]).mean())
    wide = replace(star, residual_px=mean.reshape(-1, 2, 2), duration=4.0 * period)
    assert not lasts(wide, wide.residual_px)
    assert lasts(replace(wide, duration=period), wide.residual_px)


def test_errors_are_followed_where_windows_err_alike_over_many_rows_and_nowhere_else() -> None:
    white = strip_star(600, 8)
    assert not lasts(white, white.residual_px)
    assert slow_errors([white], [white.residual_px], [white.t_hub]) is None
    rng = np.random.default_rng(3)
    red = np.zeros((600, 8, 2, 2))
    for row in range(1, 600):
        red[row] = 0.9 * red[row - 1] + rng.standard_normal((8, 2, 2))
    patchy = replace(white, residual_px=white.residual_px + 0.02 * red.reshape(-1, 2, 2))
    found = slow_errors([patchy], [patchy.residual_px], [patchy.t_hub])
    assert found is not None and found.images == (0, 1, 2) and found.covers([patchy])
    assert found.count == int(np.ceil(599 * 0.004 / 0.12)) + 1
    # rows of three windows, and strips too long for a dense border, keep what lasts as noise
    narrow = strip_star(600, 3)
    assert slow_errors([narrow], [narrow.residual_px + 0.1], [narrow.t_hub]) is None
    assert slow_errors([patchy], [patchy.residual_px], [3.0 * patchy.t_hub]) is None


def test_rounds_go_on_while_sizes_grow() -> None:
    small = nodes_of(strip_star(80, 3), np.array([0.003, 0.004, 0.001]))
    assert _same_sizes(None, None) and not _same_sizes(None, small)
    assert _same_sizes(small, replace(small, sizes=1.05 * small.sizes))
    assert not _same_sizes(small, replace(small, sizes=small.sizes * [1.0, 1.5, 1.0]))
