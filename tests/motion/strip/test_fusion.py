"""Star trackers, gyros and control points against dense formulas and geometry written out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from tests.motion.strips import (
    ALTITUDE,
    IFOV,
    PERIOD,
    SPEED,
    given_bands,
    moved_by_turn,
    plain_star,
    strip_cameras,
)

from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.geometry.trajectory import Trajectory
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.statics import band_statics
from sightline.motion.strip.fusion import (
    UNFELT,
    attitude_rows,
    control_rows,
    own_parts,
    reweighted,
    tie,
    unfelt_tones,
    uses,
)
from sightline.motion.strip.joint import JointPrior, angles_at, directions_at, solve_joint
from sightline.motion.strip.normal_equations import GroundOrder, TimeGrid, no_information, normal_equations

GRID = TimeGrid(0.0, 2e-3, 300)
STILL = Trajectory.level_flight(ALTITUDE, SPEED, -1.0, 4.0)
PIXEL = np.full(3, IFOV)
SPECTRUM = Spectrum((Matern(2.0 * IFOV, 0.3, "5/2"), Matern(0.1 * IFOV, 0.01, "3/2")))
NOTHING = (None, None, None)


def tracker(t, angles, sigma, alignment=0.0, bias=0.0, time=0.0) -> AttitudeSensor:
    """A star tracker's table."""
    return AttitudeSensor(
        "tracker", "star-tracker", t, t, angles, np.full(len(t), sigma), alignment, bias, time
    )


def gyro(edges, increments, sigma, alignment=0.0, bias=0.0, time=0.0) -> AttitudeSensor:
    """A gyro's table of adjoining intervals."""
    sigmas = np.full(len(edges) - 1, sigma)
    return AttitudeSensor("gyro", "gyro", edges[:-1], edges[1:], increments, sigmas, alignment, bias, time)


def rows_of(sensor, *, statics=0, unfelt=NOTHING, unseen=0.0, reference=STILL, memory=10.0):
    """Rows of a sensor over the whole grid."""
    span = (GRID.start, GRID.start + GRID.step * (GRID.count - 1))
    rows = attitude_rows(sensor, span, statics, unfelt, np.full(3, unseen), reference, memory)
    assert rows is not None
    return rows


def dense(ties):
    """The information of ties as one dense matrix of motion and border."""
    e = ties.equations
    band = e.ab.whole()
    n = band.shape[1]
    whole = np.zeros((n, n))
    for d in range(len(band)):
        k = np.arange(n - d)
        whole[k + d, k] = whole[k, k + d] = band[d, : n - d]
    return np.block([[whole, e.border], [e.border.T, e.corner]])


def prior_of(statics=0, spectrum=SPECTRUM):
    """The same process on all axes."""
    process = spectrum.autoregressive(GRID.step, 30, GRID.count)
    return JointPrior((process, process, process), np.ones(statics))


# ---------------------------------------------------------------------------- rows


def test_a_star_tracker_fixes_its_nodes_with_its_own_precision():
    t = GRID.nodes[[10, 50, 200]]
    ties = tie([rows_of(tracker(t, np.ones((3, 3)), 2e-6))], GRID, 3)
    expected = np.zeros(3 * GRID.count)
    for node in (10, 50, 200):
        expected[3 * node : 3 * node + 3] = 2e-6**-2
    # readings fall on nodes: the interpolation is one there
    assert np.allclose(np.diag(dense(ties)), expected, rtol=1e-9)
    assert np.allclose(ties.equations.rhs, expected)
    assert ties.tied.all()


def test_readings_outside_the_estimated_time_are_left_out_and_counted():
    t = np.array([-5.0, 0.1, 0.2, 99.0])
    rows = rows_of(tracker(t, np.zeros((4, 3)), 1e-6))
    assert (rows.given, len(rows.value)) == (4, 6)
    assert (
        attitude_rows(
            tracker(t + 200.0, np.zeros((4, 3)), 1e-6), (0.0, 1.0), 0, NOTHING, np.zeros(3), STILL, 0.0
        )
        is None
    )


def test_a_gyro_compares_the_ends_of_its_intervals():
    edges = GRID.nodes[[20, 30, 40]]
    ties = tie([rows_of(gyro(edges, np.zeros((2, 3)), 1e-6))], GRID, 3)
    roll = dense(ties)[: -0 or None, :][::3, ::3] * 1e-12
    expected = np.zeros((GRID.count, GRID.count))
    for a, b in ((20, 30), (30, 40)):
        expected[np.ix_([a, b], [a, b])] += [[1, -1], [-1, 1]]
    assert np.allclose(roll, expected, atol=1e-9)
    assert not ties.tied.any()


def test_a_misaligned_gyro_takes_the_turn_of_the_reference_for_motion():
    # a body that pitches with the orbit (about -y) at 1e-3 rad/s; sensor axes turned by m about yaw (z) read
    # R(-m z) w: w = (0, -1e-3, 0) becomes (-m 1e-3, ..): a false roll rate of m x 1e-3, sign by hand below
    from scipy.spatial.transform import Rotation

    rate, m = 1e-3, 2e-3
    edges = np.array([0.1, 0.2])
    true_turn = Rotation.from_rotvec([0.0, -rate * 0.1, 0.0])
    sensed = Rotation.from_rotvec([0.0, 0.0, m]).inv().as_matrix() @ true_turn.as_rotvec()
    t = np.linspace(0.0, 1.0, 101)
    attitude = Rotation.from_rotvec(np.outer(t, [0.0, -rate, 0.0]))
    reference = Trajectory(t, np.zeros((101, 3)), t, attitude)
    rows = rows_of(gyro(edges, np.zeros((1, 3)), 1e-9, alignment=1e-3), reference=reference)
    predicted = rows.own @ np.array([0.0, 0.0, m])
    # what the table holds is relative to the reference: sensed less true
    assert np.allclose(predicted, sensed - true_turn.as_rotvec(), atol=m**2 * rate * 0.1 + 1e-12)
    assert abs(predicted[0]) > 1e-7


def test_what_a_gyro_may_err_by_is_its_bias_and_the_turn_of_its_axes():
    # increments over 0.1 s of a body that turns by (1, -2, 3) mrad in each; axes known to 4 mrad
    sigma, turned, count = 4e-3, np.array([1e-3, -2e-3, 3e-3]), 3
    edges = 0.1 * np.arange(count + 1)
    for bias in (0.0, 5e-5):
        rows = rows_of(gyro(edges, np.tile(turned, (count, 1)), 1e-9, alignment=sigma, bias=bias))
        spread = rows.own @ np.linalg.inv(rows.own_precision) @ rows.own.T
        # m x turned for m of that sigma about each axis: all increments alike, bias times width besides
        drawn = np.cross(sigma * np.eye(3), turned)
        each = drawn.T @ drawn + (0.1 * bias) ** 2 * np.eye(3)
        # rows are axis by axis
        wanted = np.kron(each, np.ones((count, count)))
        np.testing.assert_allclose(spread, wanted, atol=1e-9 * wanted.max())


def test_tones_that_a_gyro_may_not_feel_are_whitened_away():
    tone = Spectrum((*SPECTRUM.components, Tone(0.3 * IFOV, 47.0, 0.8)))
    edges = np.arange(0.0, 0.3001, 0.01)
    rows = rows_of(
        gyro(edges, np.zeros((30, 3)), 0.05 * IFOV), unfelt=unfelt_tones([tone, SPECTRUM, SPECTRUM])
    )
    # by hand: increments of a damped oscillator, and white noise
    lag, turn = np.arange(31) * 0.01, 2 * np.pi * 47.0 * np.arange(31) * 0.01
    shape = np.exp(-np.pi * 0.8 * lag) * (np.cos(turn) + 0.8 / 94.0 * np.sin(turn))
    angle = toeplitz((UNFELT * 0.3 * IFOV) ** 2 * shape)
    step = np.diff(np.eye(31), axis=0)
    covariance = step @ angle @ step.T + (0.05 * IFOV) ** 2 * np.eye(30)
    w = rows.whiten.toarray()
    # every earlier reading within the memory: exact
    assert np.allclose(w[:30, :30] @ covariance @ w[:30, :30].T, np.eye(30), atol=1e-6)
    assert np.allclose(w[30:, 30:], np.eye(60) / (0.05 * IFOV))


@pytest.mark.parametrize("readings", [40, 200])
def test_a_slow_error_of_a_star_tracker_has_its_own_correlation(readings):
    t = np.linspace(0.05, 0.55, readings)
    sensor = tracker(t, np.zeros((readings, 3)), 1e-6, alignment=3e-6, bias=4e-6, time=0.2)
    rows = rows_of(sensor)
    covariance = rows.own @ np.linalg.inv(rows.own_precision) @ rows.own.T
    w = np.linalg.inv(rows.whiten.toarray())
    covariance = (covariance + w @ w.T)[:readings, :readings]
    apart = np.abs(t[:, None] - t)
    expected = 9e-12 + 16e-12 * np.exp(-apart / 0.2) + 1e-12 * np.eye(readings)
    # 200 readings are interpolated between 64: neighbours within a step (8 ms of 200) lose 4 % of their tie
    assert np.allclose(covariance, expected, atol=16e-12 * (1e-9 if readings == 40 else 0.5 * 0.5 / 63 / 0.2))
    assert np.allclose(np.diag(covariance), np.diag(expected), rtol=1e-9)


def test_errors_that_are_alike_for_long_average_to_one():
    # twenty readings of sigma 1 urad within a tenth of their correlation time are worth one reading
    t = np.linspace(0.1, 0.12, 20)
    rows = rows_of(tracker(t, np.zeros((20, 3)), 1e-6, time=10.0))
    found = solve_joint(no_information(GRID, 0), prior_of(), tie([rows], GRID, 3))
    # e^-0.002 between its ends: the mean of the twenty knows 0.999 of the variance, the motion's own 0.1 px
    # of jitter over 20 ms is what is left between them
    assert found.absolute_sigma(np.array([0.11]))[0, 0] == pytest.approx(1e-6, rel=0.03)


# ---------------------------------------------------------------------------- control points


@pytest.mark.parametrize("sigma_px", [0.1, 0.5])
def test_a_control_point_sees_the_turn_of_the_body(sigma_px):
    camera = strip_cameras((0.0,))[0]
    pixels = np.array([[100.0, 20.0], [300.0, 280.0]])
    flat = IFOV * ALTITUDE
    # by hand: line k is at k PERIOD, column c looks (c - 159.5) pixels to the left (west)
    points = np.stack([-(pixels[:, 1] - 159.5) * flat, pixels[:, 0] * PERIOD * SPEED, np.zeros(2)], axis=1)
    turn = np.array([3.0, -2.0, 40.0]) * IFOV
    seen = pixels + np.einsum("nij,j->ni", moved_by_turn(pixels, 0.0), turn)
    control = ControlSightings(points, np.full(2, 0.01), np.zeros(2, dtype=np.intp), seen, sigma_px)
    rows = control_rows(control, [camera], [], GRID, np.zeros((GRID.count, 3)), np.zeros(0))
    assert rows is not None
    assert np.allclose(rows.by[:, 1].reshape(2, 2, 3), moved_by_turn(pixels, 0.0), rtol=1e-4, atol=2.0)
    # m per px is 3.4: a centimetre of ground is 0.003 px
    assert np.allclose(np.linalg.inv(rows.whiten.toarray()), np.eye(4) * sigma_px, rtol=1e-3, atol=1e-4)
    found = solve_joint(no_information(GRID, 0), prior_of(), tie([rows], GRID, 3))
    # two points of four numbers fix three constants to about where they were seen, yaw over 130 px
    error = angles_at(found, np.array([0.05, 0.15])) - turn
    assert (np.abs(error) < 4 * sigma_px * IFOV * np.array([1.0, 1.0, 1.0 / (130 * IFOV)])).all()


def test_one_control_point_does_not_tie_yaw():
    camera = strip_cameras((0.0,))[0]
    control = ControlSightings(
        np.array([[0.0, 100 * PERIOD * SPEED, 0.0]]),
        np.array([1.0]),
        np.zeros(1, dtype=np.intp),
        np.array([[100.0, 159.5]]),
    )
    rows = control_rows(control, [camera], [], GRID, np.zeros((GRID.count, 3)), np.zeros(0))
    ties = tie([rows], GRID, 3)
    assert ties.tied.tolist() == [True, True, False]


def test_a_control_point_shares_the_offset_of_its_band():
    cameras = strip_cameras((0.0, 40.0))
    parameters = band_statics(given_bands(["a", "b"], [1.0, 1.0], [0.0, 0.0]))
    control = ControlSightings(
        np.array([[0.0, 100 * PERIOD * SPEED, 0.0]]),
        np.array([1.0]),
        np.ones(1, dtype=np.intp),
        np.array([[60.0, 159.5]]),
    )
    rows = control_rows(control, cameras, parameters, GRID, np.zeros((GRID.count, 3)), np.zeros(4))
    # a line that looks one pixel further forward sees the point one line earlier; one more column: one less
    assert np.allclose(rows.by_static, [[0, 0, -1, 0], [0, 0, 0, -1]], atol=1e-3)
    # the band looks 40 px ahead: it sees the ground of line 100 at line 60
    assert np.abs(rows.value).max() < 1e-2


# ---------------------------------------------------------------------------- the joint estimate


def image_data(motion, rng):
    """A star of images with errors, and its equations."""
    star = plain_star(120, 4, 2)
    at = lambda t: GRID.interpolate(motion, t)  # noqa: E731
    read = np.einsum("gkca,ga->gkc", star.by_hub, at(star.t_hub))
    read += np.einsum("gkca,gka->gkc", star.by_partner, at(star.t.ravel()).reshape(*star.t.shape, 3))
    # one error per image, as the start of the correlation says
    images = 0.05 / np.sqrt(2.0) * rng.normal(size=(len(star.t_hub), 3, 2))
    read += images[:, 1:] - images[:, :1]
    return normal_equations([star], [read], GRID, orders=[GroundOrder()])


def drawn(rng):
    """A motion (count, 3) of the prior with a constant of tens of px."""
    apart = np.abs(np.subtract.outer(GRID.nodes, GRID.nodes))
    root = np.linalg.cholesky(
        SPECTRUM.autocovariance(apart.ravel()).reshape(apart.shape) + 1e-9 * IFOV**2 * np.eye(GRID.count)
    )
    return root @ rng.normal(size=(GRID.count, 3)) + 30.0 * IFOV * rng.normal(size=3)


def test_a_star_tracker_gives_the_constant_and_leaves_the_rest_to_the_images():
    t = np.linspace(0.0, 0.59, 10)
    errors, sigmas, relative = [], [], []
    inside = GRID.nodes[60:200]
    for seed in range(8):
        rng = np.random.default_rng(seed)
        motion = drawn(rng)
        fixes = GRID.interpolate(motion, t) + 5 * IFOV * rng.normal(size=(10, 3))
        rows = rows_of(tracker(t, fixes, 5 * IFOV))
        found = solve_joint(image_data(motion, rng), prior_of(), tie([rows], GRID, 3))
        error = angles_at(found, inside) - motion[60:200]
        errors.append(error.mean(axis=0))
        sigmas.append(found.absolute_sigma(inside).mean(axis=0))
        constant = directions_at(GRID, found.hidden_directions(), inside)
        covariance = found.relative_covariance(inside, constant, PIXEL)
        relative.append(
            np.mean((error - error.mean(axis=0)) ** 2, axis=0)
            / covariance[:, [0, 1, 2], [0, 1, 2]].mean(axis=0)
        )
    errors, sigmas = np.array(errors), np.array(sigmas)
    # roll and pitch: ten fixes are known to each other through the images to a small part of 5 px
    assert np.allclose(sigmas[:, :2], 5 * IFOV / np.sqrt(10), rtol=0.1)
    # 8 seeds of 2 axes: the mean of 16 squared normal numbers is within 1 +- 4 sqrt(2 / 16)
    assert abs(np.mean((errors[:, :2] / sigmas[:, :2]) ** 2) - 1.0) < 4 * np.sqrt(2 / 16)
    # some tens of independent errors per strip and axis: 4 sigma of the mean over 8 strips
    assert abs(np.mean(relative) - 1.0) < 4 * np.sqrt(2 / (8 * 10))


def test_sensors_never_make_the_relative_sigma_worse():
    rng = np.random.default_rng(0)
    motion = drawn(rng)
    data = image_data(motion, rng)
    edges = np.arange(0.0, 0.5901, 0.01)
    increments = np.diff(GRID.interpolate(motion, edges), axis=0)
    rows = rows_of(gyro(edges, increments, 0.05 * IFOV, alignment=1e-3, bias=1e-6))
    inside = GRID.nodes[60:200]
    alone, both = solve_joint(data, prior_of()), solve_joint(data, prior_of(), tie([rows], GRID, 3))
    hidden = alone.hidden_directions()
    # what is hidden from the images is no less hidden because a sensor sees it
    assert np.allclose(both.hidden_directions(), hidden, atol=1e-9)
    constant = directions_at(GRID, hidden, inside)
    sigma = [
        np.diagonal(e.relative_covariance(inside, constant, PIXEL), axis1=1, axis2=2) for e in (alone, both)
    ]
    assert (sigma[1] <= sigma[0] * (1 + 1e-9)).all()
    assert sigma[1].mean() < 0.5 * sigma[0].mean()
    # a gyro knows nothing of constants
    assert np.isinf(both.absolute_sigma(inside)).all()


def test_a_sensor_that_errs_more_than_it_says_is_believed_less():
    rng = np.random.default_rng(1)
    motion = drawn(rng)
    t = np.linspace(0.0, 0.59, 60)
    fixes = GRID.interpolate(motion, t) + 3 * IFOV * rng.normal(size=(60, 3))
    fixes[7, 0] += 100 * IFOV
    rows = rows_of(tracker(t, fixes, 1 * IFOV))
    data = image_data(motion, rng)
    for _ in range(4):
        found = solve_joint(data, prior_of(), tie([rows], GRID, 3))
        assert found.ties is not None
        (own,) = own_parts(found.ties, found.own)
        rows = reweighted(rows, GRID, found.nodes, found.statics, own)
    use = uses(found.ties, found.own, found.own_sigma)[0]
    # the middle of 60 normal numbers tells their size within 4 x 1.17 / sqrt(60)
    assert np.allclose(use.sigma_factor, 3.0, rtol=4 * 1.17 / np.sqrt(60))
    assert use.outliers == 1
    assert rows.weight[7] < 0.05


def test_a_sensor_as_good_as_it_says_keeps_its_sigma():
    rng = np.random.default_rng(2)
    motion = drawn(rng)
    t = np.linspace(0.0, 0.59, 60)
    rows = rows_of(tracker(t, GRID.interpolate(motion, t) + IFOV * rng.normal(size=(60, 3)), IFOV))
    found = solve_joint(image_data(motion, rng), prior_of(), tie([rows], GRID, 3))
    rows = reweighted(rows, GRID, found.nodes, found.statics, found.own)
    assert (rows.scale == 1.0).all()


def test_an_offset_of_the_tracker_is_part_of_the_absolute_sigma():
    t = np.linspace(0.0, 0.59, 30)
    rows = rows_of(tracker(t, np.full((30, 3), 50e-6), 1e-6, alignment=20e-6, bias=15e-6))
    found = solve_joint(no_information(GRID, 0), prior_of(), tie([rows], GRID, 3))
    # alignment and bias are one constant of 25 urad that nothing else sees
    assert np.allclose(found.absolute_sigma(t), 25e-6, rtol=0.01)
    assert np.allclose(angles_at(found, t), 50e-6, atol=1e-7)
    (use,) = uses(found.ties, found.own, found.own_sigma)
    assert use.constants["offset of yaw"] == pytest.approx((0.0, 25e-6), abs=1e-6)
