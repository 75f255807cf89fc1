"""MTF under a recovered motion: one column's formula, brute force over exact rays, closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError, SpanError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.imaging.tdi_transfer import (
    ALIGNMENTS,
    POINTS,
    Exposure,
    drift_transfer,
    jitter_transfer,
    motion_transfer,
)
from sightline.tdi.merit import normal_draws, robust_merit
from sightline.tdi.motion_kernels import moved_mtf
from sightline.tdi.motion_knowledge import MotionKnowledge
from sightline.tdi.motion_mtf import MotionMtf
from sightline.tdi.scan_columns import ColumnGeometry, column_geometry
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiGrid
from tdi.brute_force_column import TdiColumn

PERIOD, IFOV, LINES = 5e-4, 5e-6, 400
GRID = TdiGrid(np.array([1, 2, 5, 16, 40]), np.array([0.3, 0.8, 1.0]))
RULES = ChoiceRules(frequencies=(0.5, 0.4))


def camera(look_ahead=0.0) -> PushbroomCamera:
    flight = Trajectory.level_flight(680e3, 6800.0, -0.05, 0.3)
    row = LineDetector.from_ifov("PAN", 801, IFOV, PERIOD, look_ahead=look_ahead)
    return PushbroomCamera(row, flight, FixedMount(), 0.0, LINES)


def geometry(columns=(0, 400, 800), **kind) -> ColumnGeometry:
    return column_geometry(camera(**kind), Plane(), columns)


def model(
    knowledge, exposure=None, grid=GRID, columns=(0, 400, 800), covariance=None, **options
) -> MotionMtf:
    where = geometry(columns)
    return MotionMtf(
        where.columns(1.0, covariance), where, knowledge, grid, exposure or Exposure(), RULES, **options
    )


def wavy(size=1.0, fine=10) -> Motion:
    """Drift and tones of a few tenths of a px on every axis, sampled `fine` times per line."""
    t = np.arange(-40 * fine, (LINES + 40) * fine) * PERIOD / fine
    waves = [3.0 * t + 0.3 * np.sin(2 * np.pi * 40 * t), -4.0 * t + 0.25 * np.sin(2 * np.pi * 70 * t + 1.0)]
    yaw = 2e-3 + 5e-3 * t + 2e-4 * np.sin(2 * np.pi * 25 * t)
    return Motion(t, size * np.stack([*(IFOV * w for w in waves), yaw], axis=1))


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_the_compiled_loop_is_the_formula_of_one_column(align):
    """Same points, same order of operations but for rounding: 1e-12."""
    rng = np.random.default_rng(3)
    exposure, ratios = Exposure(2, 0.25, align), np.array([0.2, 0.7, 1.0])
    motion = np.cumsum(rng.normal(scale=0.02, size=(40, 2)), axis=0)
    velocity, slip, start = np.array([1.004, 0.99]), np.array([0.01, -0.02]), 1.3
    node, weight = np.polynomial.legendre.leggauss(POINTS)
    k = np.arange(30)
    length = np.where(k[:, None] < 2, 0.25, ratios)
    offset = length[..., None] * (0.5 * node + ALIGNMENTS[align])
    at = start + k[:, None, None] + offset
    moved = np.stack([np.interp(at, np.arange(40.0), motion[:, c]) for c in range(2)])
    stages = np.array([1, 3, 17, 30])
    out = np.empty((2, 12, 2))
    across = velocity * np.tan(slip)
    levers = np.tile(np.eye(2), (2, 1, 1))
    moved_mtf(
        across, velocity - 1, velocity, levers, 0.5, 0.4, stages, ratios, 2, 0.25,
        offset.reshape(30, -1), moved.reshape(2, 30, -1), 0.5 * weight, out,
    )  # fmt: skip
    for c in range(2):
        for axis, (fx, fy) in enumerate([(0.5, 0.0), (0.0, 0.4)]):
            whole = motion_transfer(30, ratios, velocity[c], slip[c], fx, fy, motion, start, exposure)
            assert_allclose(out[c, :, axis], abs(whole[:, stages - 1]).T.ravel(), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("align", "look_ahead"), [("centre", 0.0), ("start", -2e-3)])
def test_brute_force_column_over_exact_rays(align, look_ahead):
    """A ground point followed through the moving camera by rays; a column that sums instants of a sinusoid.

    No formula is shared. 40 instants per exposure: (pi/2/40)^2/6 = 3e-4 of the contrast; yaw of 2e-3 to
    3e-3 and second-order terms beside it stay below 1e-4 px in 40 stages.
    """
    motion, exposure = wavy(fine=1), Exposure(2, 0.25, align)
    one = camera(look_ahead)
    moving = one.with_trajectory(one.trajectory.with_motion(motion))
    where = column_geometry(one, Plane(), [0, 800])
    found = MotionMtf(where.columns(1.0), where, MotionKnowledge(motion), GRID, exposure, RULES, starts=3)
    start_lines = found.start_times()[0] / PERIOD
    nodes = found.drawn(slice(0, 2))
    for place, column in enumerate((0.0, 800.0)):
        for node, line in enumerate(start_lines):
            if not 2.0 < line < LINES - 45.0:
                continue
            point = one.locate([[line, column]], Plane())
            origin = one.detector.tangents[int(column)]

            def path(t, point=point, origin=origin):
                flat = np.ravel(t)
                seen = moving.camera_tangents(np.repeat(point, len(flat), axis=0), flat) - origin
                return (seen[:, 0] / IFOV).reshape(t.shape), (-seen[:, 1] / IFOV).reshape(t.shape)

            for p, (stages, ratio) in enumerate(zip(*GRID.settings, strict=True)):
                if stages not in (5, 40) or ratio == 0.3:
                    continue
                column_sum = TdiColumn(int(stages), ratio, 2, 0.25, ALIGNMENTS[align], instants=40)
                expected = [
                    abs(column_sum.response(0.5, 0.0, path, line)),
                    abs(column_sum.response(0.0, 0.4, path, line)),
                ]
                assert_allclose(nodes[node, place, p], expected, atol=1e-3)


def test_sinusoidal_jitter_is_the_closed_form():
    """Roll of 0.3 px and 0.13 cycles per line: sums of eight points per exposure are exact to 1e-9."""
    nu, size = 0.13, 0.3
    t = np.arange(-1000, (LINES + 20) * 20) * PERIOD / 20
    roll = -size * IFOV * np.sin(2 * np.pi * nu * t / PERIOD)
    motion = Motion(t, np.outer(roll, [1.0, 0.0, 0.0]))
    found = model(MotionKnowledge(motion), starts=5)
    nodes, starts = found.drawn(slice(1, 2))[:, 0], found.start_times()[0] / PERIOD
    stages, ratio = GRID.settings
    for node, start in zip(nodes, starts, strict=True):
        wave = jitter_transfer(stages, ratio, 1.0, 0.0, 0.5, 0.0, (size, 0.0), nu, 2 * np.pi * nu * start)
        assert_allclose(node[:, 0], abs(wave), atol=2e-6)  # nodes are kept as 32-bit numbers
        assert_allclose(node[:, 1], abs(drift_transfer(stages, ratio, 1.0, 0.0, 0.0, 0.4)), atol=2e-6)


def test_a_steady_yaw_is_a_slip_and_rates_are_drifts():
    """By the levers: tan g = -yaw - F roll' T; V - 1 = T (F pitch' + X yaw')."""
    t = np.linspace(-0.02, 0.25, 600)
    rates, yaw = np.array([2e-5, -3e-5, 0.0]), 4e-3
    motion = Motion(t, np.outer(t, rates) + np.array([0.0, 0.0, yaw]))
    found = model(MotionKnowledge(motion), starts=2)
    stages, ratio = GRID.settings
    slip = np.arctan(-yaw - rates[0] * PERIOD / IFOV)
    velocity = 1.0 + rates[1] * PERIOD / IFOV
    expected = [
        abs(drift_transfer(stages, ratio, velocity, slip, fx, fy)) for fx, fy in ((0.5, 0.0), (0.0, 0.4))
    ]
    # slip times velocity - 1 is 1e-5 px per line, 4e-4 px after 40
    assert_allclose(found.drawn(slice(0, 3))[0, 1], np.transpose(expected), atol=2e-3)


def test_a_yaw_turns_the_whole_path():
    """Movement (a, V) seen from axes turned by yaw: (a - V yaw, V + a yaw); 4e-4 of it is second order."""
    where, yaw = geometry((400, 401)), 0.02
    velocity, slip = np.array([1.02, 0.98]), np.array([0.05, -0.04])
    columns = ScanColumns(where.column, velocity, slip, np.ones((2, 2)))
    motion = Motion([-0.02, 0.25], np.tile([0.0, 0.0, yaw], (2, 1)))
    found = MotionMtf(columns, where, MotionKnowledge(motion), GRID, Exposure(), RULES, starts=1)
    stages, ratio = GRID.settings
    for k in range(2):
        a = velocity[k] * np.tan(slip[k])
        v, g = velocity[k] + a * yaw, np.arctan((a - velocity[k] * yaw) / (velocity[k] + a * yaw))
        expected = [abs(drift_transfer(stages, ratio, v, g, fx, fy)) for fx, fy in ((0.5, 0.0), (0.0, 0.4))]
        # within a stage the turn is not counted along the column: 1e-3 px
        assert_allclose(found.drawn(slice(k, k + 1))[0, 0], np.transpose(expected), atol=2e-3)


def test_what_cannot_be_followed_is_a_gaussian():
    still = Motion.zero(-0.02, 0.25)
    found = model(MotionKnowledge(still, jitter=np.array([0.2, 0.1, 0.0]) * IFOV), starts=1)
    stages, ratio = GRID.settings
    expected = abs(drift_transfer(stages, ratio, 1.0, 0.0, 0.0, 0.4)) * np.exp(
        -2 * np.pi**2 * 0.4**2 * 0.1**2
    )
    assert_allclose(found.central(slice(1, 2))[0, :, 1], expected, atol=1e-6)
    assert_allclose(found.central(slice(1, 2))[0, :, 0], np.exp(-2 * np.pi**2 * 0.25 * 0.04), atol=1e-6)


def test_error_that_is_fast_blurs_like_a_gaussian_and_error_that_is_slow_does_not():
    """0.25 px at 100 to 900 Hz is averaged by 40 stages; at 5.5 Hz it moves the whole line, by 0.17 px.

    Fast: a node is the mean of 40 vectors that scatter by 0.79 rad, var cos 0.11 and var sin 0.35: 256 nodes
    are sure to 0.003, and the modulus of a node is longer than its mean by 0.35 / 40 / 2 / 0.73 = 0.006.
    Slow: a line that drifts by d = 0.25 x 2 pi 5.5 Hz x 0.02 s loses (pi d / 2)^2 / 6 = 0.0123 on average.
    """
    f = np.linspace(0.0, 1000.0, 4001)
    sigma = 0.25 * IFOV
    fast = np.where((f >= 100.0) & (f < 900.0), sigma**2 / 800.0, 0.0)
    slow = np.where((f >= 5.0) & (f < 6.0), sigma**2 / 1.0, 0.0)
    still = Motion.zero(-0.02, 0.6)
    grid = TdiGrid(np.array([40]), np.array([0.01]))
    gaussian = np.exp(-2 * np.pi**2 * 0.25 * 0.25**2)
    for density, expected, tolerance in ((fast, gaussian, 0.016), (slow, 0.9877, 0.004)):
        knowledge = MotionKnowledge(still, f, density[:, None] * [1.0, 0.0, 0.0])
        found = model(knowledge, grid=grid)
        assert found.central(slice(1, 2))[0, 0, 0] == pytest.approx(expected, abs=tolerance)


def test_hidden_directions_are_drawn_and_those_that_cancel_change_nothing():
    """A constant of yaw is a slip; together with the roll drift that images tie to it, it moves nothing."""
    t = np.linspace(-0.02, 0.25, 541)
    yaw, tied, sigma = np.zeros((541, 3, 1)), np.zeros((541, 3, 1)), 5.1e-3
    yaw[:, 2] = tied[:, 2] = 1.0
    tied[:, 0, 0] = -IFOV / PERIOD * t  # -F roll' T = 1: as much as the yaw takes away
    still = Motion(t, np.zeros((541, 3)))
    variance = np.array([[sigma**2]])
    found = model(MotionKnowledge(still, hidden=yaw, hidden_covariance=variance), draws=8, starts=2)
    slips = -sigma * normal_draws(3, 8)[:, 0]
    stages, ratio = GRID.settings
    expected = [abs(drift_transfer(stages, ratio, 1.0, np.arctan(g), 0.5, 0.0)) for g in slips]
    nodes = found.drawn(slice(1, 2))[:, 0, :, 0]
    assert found.nodes_per_draw == 2 and len(nodes) == 16
    assert_allclose(nodes[::2], expected, atol=1e-6)
    assert_allclose(nodes[1::2], expected, atol=1e-6)
    assert np.ptp(nodes[:, -1]) > 0.01
    where = geometry()
    drift = MotionKnowledge(still, hidden=yaw, hidden_covariance=variance).drift_covariance(where)
    assert_allclose(drift, np.broadcast_to([[0.0, 0.0], [0.0, sigma**2]], (3, 2, 2)), atol=1e-12)
    assert_allclose(
        MotionKnowledge(still, hidden=tied, hidden_covariance=variance).drift_covariance(where),
        0.0,
        atol=1e-12,
    )
    knowledge = MotionKnowledge(still, hidden=yaw, hidden_covariance=variance, warnings=("one",))
    assert knowledge.doubts(where)[0] == "one" and len(knowledge.doubts(where)) == 2
    assert "sigma of 0.29 degrees" in knowledge.doubts(where)[1]
    assert replace(knowledge, hidden=tied).doubts(where) == ("one",)
    same = model(MotionKnowledge(still, hidden=tied, hidden_covariance=variance), draws=8, starts=2)
    assert_allclose(same.drawn(slice(1, 2))[:, 0, :, 0], 1.0, atol=1e-6)


def test_each_draw_moves_velocity_and_slip_by_their_own_sigmas():
    """Nothing moves but what the columns' covariance says, one number for both: a constant drift."""
    t, sigma = np.linspace(-0.02, 0.25, 541), np.array([[4e-3, -1e-3], [9e-3, 3e-3], [2e-3, 8e-3]])
    covariance = sigma[:, :, None] * sigma[:, None, :]
    found = model(MotionKnowledge(Motion(t, np.zeros((541, 3)))), covariance=covariance, draws=8, starts=1)
    where, (stages, ratio) = geometry(), GRID.settings
    nodes, units = found.drawn(slice(0, 3)), normal_draws(2, 8)
    for c, (of_velocity, of_slip) in enumerate(sigma):
        # which of two normal numbers moves them, and which way, is the root's
        off = []
        for unit in (units[:, 0], -units[:, 0], units[:, 1], -units[:, 1]):
            drift = (
                (where.velocity[c] + of_velocity * unit)[:, None],
                (where.slip[c] + of_slip * unit)[:, None],
            )
            each = [abs(drift_transfer(stages, ratio, *drift, *f)) for f in ((0.5, 0.0), (0.0, 0.4))]
            off.append(np.abs(nodes[:, c] - np.stack(each, axis=-1)).max())
        # nodes are kept as 32-bit numbers
        assert min(off) < 2e-6 and max(off) > 1e-3


def test_hidden_drifts_as_covariance_are_what_exact_rays_say():
    """Rates of pitch and yaw that are one direction: V moves by T (F pitch' + X yaw') sigma, X to 400."""
    t = np.linspace(-0.02, 0.25, 541)
    direction = np.zeros((541, 3, 1))
    direction[:, 1, 0], direction[:, 2, 0] = 2e-5 * t, 1e-2 * t
    sigma, one = 0.7, camera()
    knowledge = MotionKnowledge(
        Motion(t, np.zeros((541, 3))), hidden=direction, hidden_covariance=np.array([[sigma**2]])
    )
    found = knowledge.drift_covariance(geometry())
    moved = one.with_trajectory(one.trajectory.with_motion(Motion(t, sigma * direction[:, :, 0])))
    change = column_geometry(moved, Plane(), (0, 400, 800)).velocity - geometry().velocity
    assert_allclose(np.sqrt(found[:, 0, 0]), np.abs(change), rtol=1e-3, atol=2e-6)


def test_columns_between_groups_are_interpolated_well():
    """64 groups of 801 columns under a yaw rate that spoils the edges; curvature between is (1/64)^2."""
    every = np.arange(801)
    exact = model(MotionKnowledge(wavy(fine=1)), columns=every, starts=2, groups=801)
    some = model(MotionKnowledge(wavy(fine=1)), columns=every, starts=2)
    assert_allclose(some.drawn(slice(0, 801)), exact.drawn(slice(0, 801)), atol=2e-4)
    assert_allclose(some.central(slice(37, 60)), some.drawn(slice(37, 60)).mean(axis=0), atol=1e-6)


@pytest.mark.parametrize("merit", ["product", "min"])
@pytest.mark.parametrize("quantile", [None, 0.3])
def test_merit_between_groups_is_that_of_every_column(merit, quantile):
    """Optics that differ from column to column: a factor of the product, not of the lesser of two MTFs."""
    every = np.arange(0, 801, 5)
    where, rules = geometry(every), replace(RULES, merit=merit, quantile=quantile)
    static = np.stack([0.3 + 1e-4 * every, 0.2 + 0.0 * every], axis=1)
    doubt = np.tile(np.diag([1e-3, 2e-3]) ** 2, (len(every), 1, 1))
    found = MotionMtf(
        where.columns(static, doubt), where, MotionKnowledge(wavy(fine=1)), GRID, Exposure(), rules,
        draws=4, starts=2,
    )  # fmt: skip
    part = slice(30, 60)
    every_column = robust_merit(replace(found, groups=1000), part, rules)
    assert_allclose(found.robust_merit(part, rules), every_column, rtol=2e-3, atol=1e-5)


def test_a_column_has_the_merit_alone_that_it_has_among_others():
    doubt = np.diag([1e-3, 2e-3]) ** 2
    known, options = MotionKnowledge(wavy(fine=1)), {"draws": 4, "starts": 2}
    among = model(known, covariance=np.tile(doubt, (3, 1, 1)), **options).robust_merit(slice(0, 3), RULES)
    for place, column in ((0, 0), (2, 800)):
        alone = model(known, columns=(column,), covariance=doubt[None], **options)
        # nodes are kept as 32-bit numbers
        assert_allclose(alone.robust_merit(slice(0, 1), RULES)[0], among[place], rtol=1e-5)


def test_lines_are_spread_over_the_strip_and_each_draw_has_its_own():
    t = np.linspace(-0.02, 0.25, 541)
    direction, variance = np.ones((541, 3, 1)), np.array([[1e-12]])
    found = model(
        MotionKnowledge(Motion(t, np.zeros((541, 3))), hidden=direction, hidden_covariance=variance)
    )
    times = found.start_times()
    # first stages can be centred a line after the motion begins and 40 lines before it ends: each start is
    # the middle of its own part of that
    first, last = -0.02 + PERIOD, 0.25 - 40 * PERIOD
    parts = (np.arange(times.size) + 0.5) / times.size
    assert_allclose(np.sort(times.ravel()), first + (last - first) * parts)
    # and each draw has one in every stretch
    stretches = np.floor((times - first) / (last - first) * times.shape[1])
    assert (stretches == np.arange(times.shape[1])).all()
    assert_allclose(model(MotionKnowledge(wavy())).start_times().shape, (1, 64))


def test_bad_input_is_refused():
    good = MotionKnowledge(wavy(fine=1))
    with pytest.raises(SpanError, match="give the folder that `sightline recover` wrote"):
        model(good, span=(0.0, 0.4))
    with pytest.raises(SpanError, match="40 stages need 41; give a longer motion, or fewer stages"):
        model(MotionKnowledge(Motion.zero(0.0, 39 * PERIOD)))
    where = geometry()
    with pytest.raises(InputError, match="columns mismatch: 2 columns, geometry of 3"):
        MotionMtf(geometry((0, 1)).columns(1.0), where, good, GRID, Exposure(), RULES)
    with pytest.raises(InputError, match="knows no measured motion"):
        MotionMtf(where.columns(1.0), where, good, GRID, Exposure(), replace(RULES, model="patent"))
