"""The estimate of a spinning camera on matches worked out by hand, no image rendered."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tests.motion.spinning import SpinningCamera, turn

from consistency import assert_possible
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Ellipsoid, Infinity
from sightline.imaging.source import ArrayImage
from sightline.motion.band import ChipKnowledge, Frame, LensKnowledge
from sightline.motion.frames.matches import FrameStar
from sightline.motion.frames.ties import FrameTies
from sightline.motion.sensors import AttitudeSensor
from sightline.motion.spin.matches import LEAST_LINES, strip_pairs
from sightline.motion.spin.report import at_camera, findings
from sightline.motion.spin.solve import (
    SPIN_NAMES,
    AttitudeSigma,
    SpinUnknowns,
    layers_of,
    solve_spin,
    spin_statics,
)

FOCAL, INTERVAL, EXPOSURES, LINES, COLUMNS = 1000.0, 0.4, 10, 100, 400
TURN, NOMINAL = -0.08, (120.0, 20.0, -80.0)
RADIUS, DISTANCE, SPEED = 7e7, 1.9e8, np.array([1.5e4, 2.5e4, 2e4])
NOISE = 0.05
HEIGHTS = np.array([15e3, 0.0, -10e3])
NAMES = ("blue", "green", "red")


def attitude() -> np.ndarray:
    """Half of the scan before the nadir: the body lies along -z of the world, seen from +z."""
    return turn(np.array([np.pi, 0.0, 0.0])) @ turn(np.array([-TURN * (EXPOSURES - 1) / 2.0, 0.0, 0.0]))


def place(t: float) -> np.ndarray:
    return np.array([0.0, 0.0, DISTANCE]) + SPEED * t


def case(seed: int, *, noise: float = NOISE, axes: int = 1):
    """Truth, frames with nominal cameras, and matches of points of a sphere; departures about some axes."""
    rng = np.random.default_rng(seed)
    departures = np.zeros((EXPOSURES, 3))
    departures[:, :axes] = rng.normal(0.0, 3e-5, (EXPOSURES, axes))
    lines = tuple(line - 4.0 for line in NOMINAL)
    truth = SpinningCamera(
        FOCAL, 199.5, lines, np.array([1.0, 2e-3, -1e-3]), TURN + 1e-4, departures, attitude()
    )
    spin = Spin(Rotation.from_matrix(attitude()), np.array([1.0, 0.0, 0.0]), TURN / INTERVAL, 0.0, 0.01, 1e-3)
    t = INTERVAL * np.arange(EXPOSURES)
    trajectory = spin.trajectory(t, np.array([place(at) for at in t]), (t[0], t[-1]))
    frames = []
    for exposure in range(EXPOSURES):
        for strip in range(3):
            detector = AreaDetector("camera", (LINES, COLUMNS), FOCAL, (NOMINAL[strip], 199.5))
            camera = FrameCamera(detector, trajectory, FixedMount(Rotation.identity()), t[exposure])
            image = ArrayImage(np.zeros((LINES, COLUMNS), np.float32))
            frames.append(Frame(f"{exposure} {NAMES[strip]}", image, camera, 0.0, exposure, strip))
    pairs = strip_pairs(frames)
    stars = [
        star
        for pair in pairs
        for exposure in range(EXPOSURES - pair.lag)
        if (star := star_of(truth, pair, exposure, rng, noise)) is not None
    ]
    return truth, spin, frames, pairs, stars


def star_of(truth, pair, exposure, rng, noise) -> FrameStar | None:
    """Windows of one strip in another: the same feature, each filter seeing it at its own height."""
    line, column = np.meshgrid(
        np.arange(15.0, LINES - 15, 14), np.arange(30.0, COLUMNS - 30, 28), indexing="ij"
    )
    pixels = np.column_stack([line.ravel(), column.ravel()])
    look = truth.directions(exposure, pair.hub, pixels[:, 0], pixels[:, 1])
    here, later = place(INTERVAL * exposure), place(INTERVAL * (exposure + pair.lag))
    radius = RADIUS + HEIGHTS[pair.hub]
    along = look @ here
    root = along**2 - here @ here + radius**2
    hit = root > (0.3 * radius) ** 2
    ground = here + (-along - np.sqrt(np.maximum(root, 0.0)))[:, None] * look
    other = ground * (RADIUS + HEIGHTS[pair.partner]) / radius
    seen = truth.pixel(exposure + pair.lag, pair.partner, other - later)
    inside = hit & (seen > 12.0).all(axis=1) & (seen < np.array([LINES - 13.0, COLUMNS - 13.0])).all(axis=1)
    if inside.sum() < 6:
        return None
    measured = np.where(inside[:, None], seen + noise * rng.normal(size=seen.shape), np.nan)
    n, sigma = len(pixels), max(noise, 1e-3)
    return FrameStar(
        3 * exposure + pair.hub,
        (3 * (exposure + pair.lag) + pair.partner,),
        (line.shape[0], line.shape[1]),
        (14, 28),
        pixels,
        measured[:, None],
        np.tile(sigma**2 * np.eye(2), (n, 1, 1, 1)),
        np.zeros((n, 1), np.uint8),
        np.ones((n, 1)),
        np.ones((n, 1)),
    )


def unknowns_of(frames, spin, surface, *, heights: float, parallax: float = 0.0) -> SpinUnknowns:
    lens = LensKnowledge(1.0, 0.0, 0.0)
    chip = ChipKnowledge(NAMES, 10.0, (0.05,) * 3, (0.0,) * 3, (heights,) * 3)
    statics = spin_statics(frames, surface, lens, chip, parallax)
    known = AttitudeSigma(0.0, 0.0)
    return SpinUnknowns(tuple(frames), spin, known, statics, np.full(3, 3e-5), layers_of(surface, chip))


@pytest.fixture(scope="module", params=[0, 1])
def solved(request):
    truth, spin, frames, pairs, stars = case(request.param)
    surface = Ellipsoid(RADIUS, RADIUS)
    unknowns = unknowns_of(frames, spin, surface, heights=2e4)
    return truth, solve_spin(stars, unknowns, surface, pairs, steps=3)


def test_strips_share_the_lines_of_the_middle_column_that_both_see():
    """The axis is nearly along the view: lines turn by 0.09 from one exposure to the next."""
    axis, focal, lines = np.array([0.8, 0.1, 2.0]), 900.0, (110.0, 30.0, -45.0)
    truth = SpinningCamera(focal, 180.0, lines, axis, -0.1, np.zeros((2, 3)), attitude())
    spin = Spin(
        Rotation.from_matrix(attitude()), axis / np.linalg.norm(axis), -0.1 / INTERVAL, 0.0, 0.01, 1e-3
    )
    trajectory = spin.trajectory(np.array([0.0, INTERVAL]), np.zeros((2, 3)), (0.0, INTERVAL))
    frames = [
        Frame(
            f"{exposure} {strip}", ArrayImage(np.zeros((70, 361), np.float32)),
            FrameCamera(
                AreaDetector("camera", (70, 361), focal, (lines[strip], 180.0)), trajectory,
                FixedMount(Rotation.identity()), INTERVAL * exposure,
            ),
            0.0, exposure, strip,
        )
        for exposure in range(2) for strip in range(3)
    ]  # fmt: skip
    wanted = {}
    for hub in range(3):
        look = truth.directions(0, hub, np.arange(70.0), np.full(70, 180.0))
        for partner in range(3):
            seen = truth.pixel(1, partner, look)[:, 0]
            shared = int(((seen >= 0.0) & (seen <= 69.0)).sum())
            if shared >= LEAST_LINES:
                wanted[hub, partner, 1] = shared
    found = {(pair.hub, pair.partner, pair.lag): pair.lines for pair in strip_pairs(frames)}
    assert found == wanted and {0 < lines < 70 for lines in wanted.values()} == {True}


def test_constants_lie_within_their_sigma(solved):
    truth, estimate = solved
    names, sigma = list(estimate.unknowns.names), np.sqrt(np.diag(estimate.covariance))
    for name, value in {"spin rate": 1e-4 / INTERVAL, "focal length": 0.0, "axis line": -4.0}.items():
        k = names.index(name)
        assert abs(estimate.x[k] - value) < 4.0 * sigma[k], name
    axis = truth.axis / np.linalg.norm(truth.axis)
    found = estimate.unknowns.spin.adjusted(estimate.x[:6]).axis
    assert np.linalg.norm(found - axis) < 4.0 * np.linalg.norm(sigma[1:3])


def test_layers_of_clouds_are_separated(solved):
    _, estimate = solved
    names = list(estimate.unknowns.names)
    rows = [names.index(f"{name} height") for name in NAMES]
    change = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    found = change @ estimate.x[rows]
    covariance = change @ estimate.covariance[np.ix_(rows, rows)] @ change.T
    error = found - change @ HEIGHTS
    assert_possible(error @ np.linalg.solve(covariance, error), 2)
    # 0.05 px of 1000 px at 1.2e8 m is 6 km for a window at the limb; hundreds of them leave below one
    assert np.sqrt(np.diag(covariance)).max() < 2e3


def test_departures_lie_within_their_sigma(solved):
    truth, estimate = solved
    error = (estimate.departures - truth.departures)[:, 0]
    sigma = estimate.departure_sigmas[:, 0]
    # their mean and slope are taken by attitude and rate
    t = np.arange(EXPOSURES) - (EXPOSURES - 1) / 2.0
    left = error - error.mean() - t * (t @ error) / (t @ t)
    square = ((left / sigma) ** 2).sum()
    # sigma holds mean and slope too, of which the error is free here: it may be a few times too large
    assert 0.1 * chi2.ppf(1e-4, EXPOSURES - 2) < square < chi2.ppf(1 - 1e-4, EXPOSURES)
    size = estimate.unknowns.departure_sigma[0]
    # of ten numbers of 3e-5: chi-square of 8 to one in a thousand
    assert 3e-5 * np.sqrt(chi2.ppf(1e-3, 8) / 8) < size < 3e-5 * np.sqrt(chi2.ppf(1 - 1e-3, 8) / 8)


def test_matches_err_as_their_rescaled_sigma_says(solved):
    _, estimate = solved
    for strip in findings(estimate).strips:
        # the sigma given is true: sqrt(2 n) of n squares, and the kept are cut at 3.7 sigma
        spread = 5.0 / np.sqrt(2.0 * strip.kept)
        assert abs(np.array(strip.scale) - 1.0).max() < max(spread, 0.05) + 0.02


def test_mismatches_are_reported_and_left_out():
    _, spin, frames, pairs, stars = case(5)
    rng = np.random.default_rng(6)
    wrong = []
    for star in stars:
        present = np.flatnonzero(star.present[:, 0])
        chosen = present[rng.random(len(present)) < 0.03]
        star.measured[chosen, 0] += 1.0  # twenty sigma
        wrong.append(chosen)
    surface = Ellipsoid(RADIUS, RADIUS)
    estimate = solve_spin(stars, unknowns_of(frames, spin, surface, heights=2e4), surface, pairs, steps=3)
    rows = estimate.rows
    bad = np.array([w in wrong[s] for s, w in zip(rows.star, rows.window, strict=True)])
    assert not estimate.kept[bad].any()
    assert estimate.kept[~bad].mean() > 0.99
    sigma = np.sqrt(estimate.covariance[0, 0])
    assert abs(estimate.x[0] - 1e-4 / INTERVAL) < 4.0 * sigma


def test_at_infinity_the_parallax_is_owned_by_the_sigma():
    _, spin, frames, pairs, stars = case(7)
    ignored = solve_spin(
        stars, unknowns_of(frames, spin, Infinity(), heights=0.0), Infinity(), pairs, steps=3
    )
    drift = float(np.linalg.norm(SPEED)) / (DISTANCE - RADIUS)
    unknowns = unknowns_of(frames, spin, Infinity(), heights=0.0, parallax=drift)
    owned = solve_spin(stars, unknowns, Infinity(), pairs, steps=3)
    error = [abs(e.x[0] - 1e-4 / INTERVAL) / np.sqrt(e.covariance[0, 0]) for e in (ignored, owned)]
    assert error[1] < 3.0
    assert np.sqrt(owned.covariance[0, 0]) > np.sqrt(ignored.covariance[0, 0])
    found = findings(owned)
    assert found.rate_sigma_parallax > found.rate_sigma_images


def test_one_lag_per_pair_confounds_rate_and_places_of_the_strips():
    """With each pair at one lag the spacing is known no better than before, with two it is."""
    _, spin, frames, pairs, stars = case(8)
    surface = Ellipsoid(RADIUS, RADIUS)
    names = ("blue line", "red line")
    spread = []
    for lags in ({(1, 0): 1, (2, 1): 1}, None):
        some = [
            star
            for star in stars
            if lags is None
            or lags.get((star.hub % 3, star.images[0] % 3)) == star.images[0] // 3 - star.hub // 3
        ]
        estimate = solve_spin(some, unknowns_of(frames, spin, surface, heights=0.0), surface, pairs, steps=2)
        rows = [estimate.unknowns.names.index(name) for name in names]
        change = np.array([1.0, -1.0])
        spread.append(float(np.sqrt(change @ estimate.covariance[np.ix_(rows, rows)] @ change)))
    assert spread[0] > 0.9 * 0.05 * np.sqrt(2.0)
    assert spread[1] < 0.3 * spread[0]


def tracked(seed, axes=1):
    """The attitude at t = 0 is hardly known, and a star tracker reads the body at every exposure."""
    truth, spin, frames, pairs, stars = case(seed, axes=axes)
    rng = np.random.default_rng(100 + seed)
    t = INTERVAL * np.arange(EXPOSURES)
    true = Rotation.from_matrix([truth.world_from_body(k) for k in range(EXPOSURES)])
    angles = (spin.at(t).inv() * true).as_rotvec()
    read = angles + 3e-5 * rng.standard_normal(3) + 2e-5 * rng.standard_normal(angles.shape)
    tracker = AttitudeSensor("st", "star-tracker", t, t, read, np.full(EXPOSURES, 2e-5), 3e-5, 0.0, 0.0)
    cameras = [frame.camera for frame in frames if frame.strip == 0]
    unknowns = replace(
        unknowns_of(frames, spin, Ellipsoid(RADIUS, RADIUS), heights=2e4),
        attitude_sigma=AttitudeSigma(0.01, 0.01),
        ties=FrameTies.of(cameras, [tracker], None),
    )
    return angles, solve_spin(stars, unknowns, Ellipsoid(RADIUS, RADIUS), pairs, steps=3)


def test_a_star_tracker_ties_the_attitude_of_a_spinning_body():
    """Pooled over seeds, both sides; its alignment of 3e-5 rad stays in the constant."""
    mean = np.kron(np.full(EXPOSURES, 1.0 / EXPOSURES), np.eye(3))
    total, seeds = 0.0, range(4)
    for seed in seeds:
        angles, found = tracked(seed)
        error, covariance = mean @ (found.angles - angles).ravel(), mean @ found.angle_covariance @ mean.T
        total += error @ np.linalg.solve(covariance, error)
        sigma = np.sqrt(np.diag(covariance))
        # about the axis to the body's centre nothing else ties it
        assert (sigma < 1.1 * np.hypot(3e-5, 2e-5 / np.sqrt(EXPOSURES))).all() and sigma.max() > 2e-5
        (use,) = found.unknowns.ties.uses(found.angles.ravel(), found.angle_covariance)
        assert use.used == EXPOSURES and use.outliers == 0
    assert_possible(total, 3 * len(seeds))


def test_the_rate_at_given_constants_is_that_of_a_gaussian_conditioned_on_them():
    """By the information: the inverse of the covariance of rate and constants, others left free."""
    rng = np.random.default_rng(9)
    scale = 10.0 ** rng.uniform(-6.0, 2.0, len(SPIN_NAMES) + 4)
    root = rng.normal(size=(len(scale), 3 * len(scale)))
    covariance = (root @ root.T) * np.outer(scale, scale)
    estimate = SimpleNamespace(
        x=scale * rng.normal(size=len(scale)), covariance=covariance,
        unknowns=SimpleNamespace(spin=SimpleNamespace(rate=0.2)),
    )  # fmt: skip
    first = len(SPIN_NAMES)
    rows = [0, *range(first, first + 3)]
    constants = scale[rows[1:]] * rng.normal(size=3)
    size = np.outer(scale[rows], scale[rows])
    information = np.linalg.inv(covariance[np.ix_(rows, rows)] / size) / size
    expected = estimate.x[0] - information[0, 1:] @ (constants - estimate.x[rows[1:]]) / information[0, 0]
    rate, sigma = at_camera(estimate, constants)
    assert rate == pytest.approx(0.2 + expected, rel=1e-9)
    assert sigma == pytest.approx(information[0, 0] ** -0.5, rel=1e-6)
