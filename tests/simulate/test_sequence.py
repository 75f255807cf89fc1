"""Flights of a filter camera against pinholes, spectra and sinusoids worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import GeometryError, InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Trajectory
from sightline.simulate.scene import Relief, relief_at
from sightline.simulate.sequence import sequence_case
from sightline.simulate.sequence_ground import SimulatedGround
from sightline.simulate.sequence_motion import draw_flight, unseen_motion
from sightline.simulate.sequence_options import CASE_OPTIONS, SequenceOptions
from sightline.simulate.sequence_render import _meet, render_channels

LEVEL = {"jitter": 0.0, "position_jitter": 0.0, "relief": 0.0, "spectra": "law"}


def small(**overrides):
    return sequence_case("small", 1, **{"frames": 4, "spectra": "law", **overrides})


def dots(scenario, spacing_px=40, size_px=3.0):
    """The scenario over a tilted plane with single B-spline bumps on dark ground, and their places (N, 3)."""
    seen, step = scenario.seen, size_px * scenario.options.gsd
    rows, columns = (int(np.ceil(length / step)) + 1 for length in reversed(seen.size))
    amounts = np.zeros((rows + 3, columns + 3, 4), np.float32)
    every = int(spacing_px / size_px)
    i, j = np.meshgrid(np.arange(4, rows - 4, every), np.arange(4, columns - 4, every), indexing="ij")
    amounts[i, j] = 1.0
    # the spline of a coefficient stands over its own node
    x, y = seen.west + step * j.ravel(), seen.south + step * i.ravel()
    posting = 20.0 * scenario.options.gsd
    posts = [int(np.ceil(length / posting)) + 1 for length in reversed(seen.size)]
    north = seen.south + (posts[0] - 1) * posting
    px, py = seen.west + posting * np.arange(posts[1]), north - posting * np.arange(posts[0])
    relief = Relief(0.1 * px[None, :] - 0.05 * py[:, None], seen.west, north, (posting, posting))
    ground = dataclasses.replace(
        scenario.ground,
        amounts=amounts,
        grid=np.array([seen.west, seen.south, step, step]),
        mean=np.full(4, 0.25),
        relief=relief,
    )
    return dataclasses.replace(scenario, ground=ground), np.column_stack([x, y, 0.1 * x - 0.05 * y])


def centroids(image, pixels, half=7):
    """Centroids (N, 2) of what stands within `half` px of `pixels` (N, 2)."""
    out = []
    for line, column in np.rint(pixels).astype(int):
        i, j = np.mgrid[line - half : line + half + 1, column - half : column + half + 1]
        light = image[i, j]
        out.append([(i * light).sum() / light.sum(), (j * light).sum() / light.sum()])
    return np.array(out)


def by_hand(points, position, attitude, options):
    """Pixels (N, 2): lines grow forward, columns to the left, body x forward, y right, z down."""
    forward, right, down = ((points - position) @ attitude.as_matrix()).T
    f, (line, column) = options.focal_length_px, options.centre_px
    return np.column_stack([line + f * forward / down, column - f * right / down])


def inside(pixels, shape, margin=9):
    return ((pixels > margin) & (pixels < np.array(shape) - 1 - margin)).all(axis=1)


# A bump of 1.7 px sigma seen in perspective: its centroid departs from its middle by the second derivative of
# the map, sigma^2 x tangent x slope / f ~ 3 x 0.4 x 0.1 / 250 + 3 x 0.4^2 / 250 < 0.005 px.
CENTROID_PX = 0.01


@pytest.mark.parametrize("frame", [0, 3])
def test_a_point_of_the_relief_appears_where_the_true_pose_projects_it(frame):
    scenario, points = dots(small(filter="pan"))
    _, position, attitude = scenario.poses
    pixels = by_hand(points, position[frame], attitude[frame], scenario.options)
    pixels = pixels[inside(pixels, scenario.options.shape)]
    assert len(pixels) >= 9
    image = scenario.signal(frame)[0]
    np.testing.assert_allclose(centroids(image, pixels), pixels, atol=CENTROID_PX)


def test_a_rolling_shutter_exposes_each_line_at_its_own_pose():
    # strong motion: the last line sees 8 px beside where the pose of the first would show it
    scenario, points = dots(small(filter="pan", readout_time=0.03, jitter=0.02, overlap=0.9))
    options, frame = scenario.options, 2
    t = scenario.flight.time(frame)
    pixels = by_hand(points, *(v[0] for v in scenario.flight.at(0, np.array([t]))), options)
    still = pixels.copy()
    for _ in range(40):
        for n, line in enumerate(pixels[:, 0].copy()):
            when = np.array([t + 0.03 * np.clip(line, -30, 189) / 159])
            place, turn = scenario.flight.at(0, when)
            pixels[n] = by_hand(points[n : n + 1], place[0], turn[0], options)[0]
    kept = inside(pixels, options.shape, 14)
    assert kept.sum() >= 9 and np.abs(still - pixels)[kept].max() > 2.0
    found = centroids(scenario.signal(frame)[0], pixels[kept])
    # the pose moves on while the bump is read: its centroid by the same second order as above, and the lines
    # stretch by 2 %
    np.testing.assert_allclose(found, pixels[kept], atol=2 * CENTROID_PX)


def test_the_packages_own_camera_agrees_with_lens_and_shutter():
    scenario, points = dots(small(filter="pan", readout_time=0.03, distortion=(-0.1, 0.02)))
    frame = 1
    t = scenario.flight.time(frame) + np.linspace(-0.01, 0.05, 601)
    position, attitude = scenario.flight.at(0, t)
    trajectory = Trajectory(t, position, t, attitude)
    camera = FrameCamera(scenario.detector, trajectory, FixedMount(), scenario.flight.time(frame), 0.03)
    pixels = camera.project(points)
    pixels = pixels[inside(pixels, scenario.options.shape)]
    found = centroids(scenario.signal(frame)[0], pixels)
    np.testing.assert_allclose(found, pixels, atol=2 * CENTROID_PX)


def test_rays_end_where_they_first_meet_the_relief():
    scenario = small()
    relief, rng = scenario.ground.relief, np.random.default_rng(5)
    corner = np.array([relief.west, relief.north, *relief.posting])
    for _ in range(200):
        u, v = rng.uniform(-0.6, 0.6, 2)
        x, y = rng.uniform(-20.0, 20.0), rng.uniform(0.0, 10.0)
        height = _meet(x, y, u, v, 0.0, relief.heights, corner, 1e-8)
        assert height == pytest.approx(float(relief_at(relief, x + u * height, y + v * height)), abs=1e-7)
        above = np.linspace(height + 1e-3, 5.0, 2000)
        assert (above > relief_at(relief, x + u * above, y + v * above)).all()
    assert np.ptp(relief.heights) == pytest.approx(0.06 * 80.0)


def test_a_ray_that_looks_up_is_refused():
    scenario = small()
    upside = np.diag([1.0, 1.0, 1.0])[None]
    with pytest.raises(GeometryError, match="looks upwards"):
        render_channels(
            scenario._tangents[0],
            upside,
            np.array([[0.0, 0.0, 80.0]]),
            scenario.ground,
            scenario._weights[0],
            0.3,
        )


@pytest.mark.parametrize(
    ("changes", "wavelength"),
    [
        ({"filter": "lvf"}, lambda line, column: 450.0 + 450.0 * line / 159),
        # 16 groups of ten lines: the mean of lines 10 k to 10 k + 9
        (
            {"filter": "stepwise", "bands": 16},
            lambda line, column: 450.0 + 450.0 * (line // 10 * 10 + 4.5) / 159,
        ),
        (
            {"filter": "mosaic", "pattern": 2},
            lambda line, column: 450.0 + 150.0 * (2 * (line % 2) + column % 2),
        ),
    ],
)
def test_every_pixel_sees_its_own_wavelength_of_the_true_bands(changes, wavelength):
    scenario = small(**LEVEL, **changes)
    gsd = scenario.options.gsd
    light = scenario.signal(2)[0] * scenario.radiometry.mean_dn
    for line, column in [(0, 0), (35, 120), (36, 121), (97, 40), (159, 199)]:
        # flying north: columns grow to the west
        x, y = -gsd * (column - 99.5), 2 * scenario.options.step + gsd * (line - 79.5)
        true = scenario.band_signal(np.array(x), np.array(y), np.array([wavelength(line, column)]))
        assert light[line, column] == pytest.approx(float(true[0]), rel=1e-4)


def test_the_channels_of_plain_colour_are_red_green_and_blue():
    scenario = small(**LEVEL, filter="rgb")
    gsd = scenario.options.gsd
    light = scenario.signal(0)[:, 80, 100] * scenario.radiometry.mean_dn
    true = scenario.band_signal(np.array(-0.5 * gsd), np.array(0.5 * gsd), np.array([620.0, 540.0, 460.0]))
    np.testing.assert_allclose(light, true, rtol=1e-4)
    assert scenario.image(0).shape == (3, 160, 200) and scenario.image(0).dtype == np.uint8


def test_a_linear_filter_may_be_given_in_groups():
    scenario = small(bands=32)
    given, true = (v[0, :, 0] for v in (scenario.filter.given_nm, scenario.filter.wavelength_nm))
    assert len(np.unique(given)) == 32 and len(np.unique(true)) == 160
    np.testing.assert_allclose(
        given.reshape(32, 5), true.reshape(32, 5).mean(axis=1, keepdims=True) @ np.ones((1, 5))
    )


def test_plants_are_dark_in_red_and_bright_beyond_and_the_mean_ground_is_even():
    scenario = small()
    spectra, layout = scenario.ground.spectra, scenario.filter
    red, infrared = spectra.at(np.array([668.0, 840.0]))
    # plants, soil, stone, shade
    assert red[0] < red[1] < red[2] and infrared[0] > infrared[2] > infrared[1] > infrared[3]
    # a filter of no width sees the spectrum itself
    narrow = dataclasses.replace(layout, fwhm_nm=1e-6).at(np.array([668.0, 840.0]), spectra)
    np.testing.assert_allclose(narrow, [red, infrared], rtol=1e-6)
    # the mean ground gives the detector's response, 1 at 620 nm
    weights = scenario._weights[0][0, :, 0] @ scenario.ground.mean
    assert weights.max() == pytest.approx(1.0, abs=1e-3)
    assert np.argmax(weights) == pytest.approx((620 - 450) / 450 * 159, abs=1)


def test_kinds_of_ground_cover_their_shares():
    ground = sequence_case("small", 3, spectra="law", frames=200).ground
    # patches of 250 px on some 800 x 400 px: a handful of each, and brightness is drawn apart from the kinds
    np.testing.assert_allclose(ground.mean / ground.mean.sum(), ground.spectra.share, atol=0.05)


def slerp_errors(options, seed, stride):
    """Rms rotation error about each body axis, deg, between true attitudes `stride` frames apart."""
    t, _, attitude = draw_flight(options, np.random.SeedSequence(seed)).poses()
    between = np.array([k for k in range(len(t) // stride * stride - stride) if k % stride])
    guess = Slerp(t[::stride], attitude[::stride])(t[between])
    return np.sqrt((np.degrees((attitude[between].inv() * guess).as_rotvec()) ** 2).mean(axis=0))


def test_interpolation_between_one_attitude_in_twenty_leaves_a_third_of_a_degree():
    options = SequenceOptions()
    for stride, wanted in ((20, 0.34), (10, 0.15)):
        error = np.sqrt(np.mean([slerp_errors(options, seed, stride) ** 2 for seed in range(6)], axis=0))
        # 26 s of sinusoids with periods up to 10 s: single flights scatter by a tenth, six of them by 4 %
        np.testing.assert_allclose(error, wanted, rtol=0.12)


def test_the_jitter_keeps_its_size_at_another_frame_rate():
    slow = SequenceOptions(frame_rate=6.25)
    error = np.mean([slerp_errors(slow, seed, 20) for seed in range(6)])
    assert error == pytest.approx(0.34, rel=0.1)


def test_what_interpolation_leaves_of_a_sinusoid_is_that_of_its_parabola():
    # slow: between samples a sinusoid is a parabola of curvature w^2, rms (w gap)^2 / sqrt(240)
    gap, f = 0.8, 0.01
    assert unseen_motion(np.array(f), gap) == pytest.approx(
        (2 * np.pi * f * gap) ** 2 / np.sqrt(240.0), rel=1e-3
    )


def test_a_level_flight_is_a_straight_line_with_the_body_forward_right_down():
    scenario = sequence_case("two-lines", 0, **LEVEL, frames=5, shape=(32, 40))
    t, position, attitude = scenario.poses
    options = scenario.options
    gsd = 80.0 / 500.0
    np.testing.assert_allclose(position[4], [0.0, 4 * 0.01 * 32 * gsd, 80.0])
    # the way back: beside it by 60 % of a frame, southwards
    np.testing.assert_allclose(position[5], [0.6 * 40 * gsd, 4 * 0.01 * 32 * gsd, 80.0])
    np.testing.assert_allclose(position[9], [0.6 * 40 * gsd, 0.0, 80.0], atol=1e-9)
    np.testing.assert_allclose(attitude[0].as_matrix(), [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-12)
    np.testing.assert_allclose(attitude[9].as_matrix(), [[0, -1, 0], [-1, 0, 0], [0, 0, -1]], atol=1e-12)
    # the turn is a half circle at the speed of the lines
    assert t[5] - t[4] > 0.5 * np.pi * options.spacing / options.speed
    np.testing.assert_allclose(np.diff(t[:5]), 0.04)


def test_lines_across_cross_the_others():
    scenario = sequence_case("small", 0, **LEVEL, frames=10, flight_lines=2, cross_lines=1)
    _, position, attitude = scenario.poses
    assert len(position) == 30
    np.testing.assert_allclose(position[20:, 1], position[:10, 1].mean())
    np.testing.assert_allclose(attitude[25].as_matrix()[:, 0], [1.0, 0.0, 0.0], atol=1e-12)


def test_poses_are_given_with_a_constant_bias_and_white_noise():
    scenario = sequence_case("small", 2, frames=1000, shape=(16, 16), spectra="law")
    _, position, attitude = scenario.poses
    place, turn = scenario.biases
    miss = scenario.given_positions - position - place
    # 1000 draws of three: relative sd of a standard deviation 1.3 %, of a mean 0.02 sigma; four of them
    assert miss.std() == pytest.approx(1.0, rel=0.06) and np.abs(miss.mean(axis=0)).max() < 0.13
    unbiased = (attitude * Rotation.from_rotvec(turn.copy())).inv() * scenario.given_attitudes
    assert np.degrees(unbiased.as_rotvec()).std() == pytest.approx(0.5, rel=0.06)


def test_any_frame_is_the_same_whichever_was_rendered_before():
    first, second = small(), small()
    alone = second.image(3)
    for frame in range(4):
        last = first.image(frame)
    np.testing.assert_array_equal(last, alone)
    assert not np.array_equal(first.image(0), sequence_case("small", 2, frames=4, spectra="law").image(0))
    noise = [first.image(k) - first.signal(k) * first.radiometry.mean_dn for k in (0, 1)]
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.05


def test_frames_over_water_show_nothing_but_noise():
    scenario = small(frames=60, water=((30, 32),))
    signal = scenario.signal(31)[0]
    # per line the same number: the wavelength of the line
    assert np.ptp(signal, axis=1).max() < 1e-6
    # the rear half of the first frame ends before the water begins
    assert np.ptp(scenario.signal(0)[0, :80], axis=1).min() > 0.1
    water = scenario.band_signal(np.array(0.0), np.array(31 * scenario.options.step), np.array([620.0]))
    assert float(water[0]) == pytest.approx(0.5 * scenario.radiometry.mean_dn, rel=1e-3)


def test_a_blurred_frame_has_lost_its_detail():
    sharp, blurred = small().signal(1)[0], small(blurred=(1,)).signal(1)[0]
    assert np.diff(blurred, axis=1).std() < 0.3 * np.diff(sharp, axis=1).std()


def test_everything_that_is_seen_lies_within_the_ground():
    for seed in range(3):
        scenario = sequence_case("small", seed, spectra="law")
        _, position, attitude = scenario.poses
        corners = np.array([[a, b, 1.0] for a in (-0.4, 0.4) for b in (-0.32, 0.32)])
        mount = Rotation.from_matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        rays = np.einsum("nij,kj->nki", (attitude * mount).as_matrix(), corners)
        reach = (position[:, None, 2:] + 2.4) / -rays[..., 2:]
        places = position[:, None, :2] + reach * rays[..., :2]
        seen = scenario.seen
        assert places[..., 0].min() > seen.west and places[..., 0].max() < seen.east
        assert places[..., 1].min() > seen.south and places[..., 1].max() < seen.north


@pytest.mark.parametrize("case", [name for name in CASE_OPTIONS if name != "long"])
def test_every_case_renders(case):
    scenario = sequence_case(case, 0, frames=2, shape=(40, 48), bands=8, spectra="law")
    image = scenario.image(1)
    # neither black nor burnt out
    assert 0.05 < image.mean() / 2**scenario.options.bits < 0.6
    assert isinstance(scenario.ground, SimulatedGround)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"filter": "prism"}, "`filter` must be one of lvf, stepwise"),
        ({"spectra": "moon"}, "`spectra` must be one of"),
        ({"texture": "moon"}, "`texture` must be one of"),
        ({"overlap": 1.0}, "`overlap` must be from 0 to 0.999"),
        ({"altitude": -1.0}, "`altitude` must be from 1 to 1e\\+07, got -1"),
        ({"altitude": float("nan")}, "`altitude` must be finite"),
        ({"position_sigma": -1.0}, "`position_sigma` must be from 0 to"),
        ({"readout_time": 0.05}, "`readout_time` must be shorter than the 0.04 s"),
        ({"shape": (8, 100)}, "`shape` must be from 16 to 40000, got 8"),
        ({"wavelengths_nm": (900.0, 450.0)}, "must rise"),
        ({"filter": "stepwise", "bands": 1}, "`bands` must be from 2 to the 160 lines"),
        ({"pattern": 1}, "`pattern` must be from 2 to 8"),
        ({"jitter": 0.335}, "`jitter` must be from 0 to 0.02 rad, got 0.335; 0.335 degrees are 0.005847 rad"),
        ({"frames": 1}, "`frames` must be from 2 to"),
        ({"missing": (4,)}, "`missing` names frame 4; there are 0 to 3"),
        ({"missing": (0, 1, 2)}, "leaves fewer than two frames"),
        ({"water": ((2, 9),)}, "`water` must be frames from 0 to 3"),
        ({"wings": 2}, "unknown option: wings"),
    ],
)
def test_what_cannot_be_flown_is_refused(changes, words):
    with pytest.raises(InputError, match=words):
        small(**changes)


def test_an_unknown_case_is_answered_with_all_of_them():
    with pytest.raises(InputError, match="cube-60"):
        sequence_case("zeppelin")
