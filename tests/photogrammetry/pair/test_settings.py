"""Settings of plans and problems: varied ones against ones made so, points by projections written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.earth import to_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.orbit_pair import OrbitPair
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.pair.settings import (
    StereoPlan,
    in_frame,
    moved,
    pixels_of_places,
    setting_of_plan,
    setting_of_problem,
    with_control,
    with_heights,
    with_points,
    with_shots,
    with_window,
)
from sightline.photogrammetry.sightings import Tracks

DETECTOR = AreaDetector("frame", (700, 700), 350.0 / np.tan(np.radians(0.75)), (349.5, 349.5))
NOISE = PoseNoise(7.5, 9e-6)


def plan(**given) -> StereoPlan:
    known = {"noise": NOISE, "shots": 16, "points": 60, "scene_size": 10e3}
    return StereoPlan(OrbitPair(separation=70.0), (DETECTOR,) * 2, (NADIR_MOUNT,) * 2, **known | given)


def problem(given: StereoPlan, *, matched: bool = True, **more) -> StereoProblem:
    """The plan's images and points as a problem, pixels as planned."""
    setting = setting_of_plan(given)
    rows = slice(None) if matched else slice(0)
    image, point = setting.image[rows], setting.point[rows]
    pixels = pixels_of_places(setting.images, setting.detectors, setting.mounts, image, setting.places[point])
    return StereoProblem(
        ("1", "2"), setting.images, np.arange(setting.shots), setting.detectors, setting.mounts,
        Tracks(image, point, pixels, np.full(len(image), given.sigma_px)), np.arange(given.points),
        setting.noise, setting.radii, **more,
    )  # fmt: skip


def test_a_plan_lays_points_evenly_over_a_level_square_along_the_track():
    given = plan(points=200, scene_size=None, sigma_px=0.3)
    setting = setting_of_plan(given)
    # nine tenths of the narrower side of what a frame sees from nearest
    nearest = np.linalg.norm(setting.images.position - given.pair.aim_point, axis=1).min()
    side = 0.9 * nearest * 2.0 * np.tan(np.radians(0.75))
    up = given.pair.world_from_local.apply([0.0, 0.0, 1.0])
    ahead = setting.images.world_from_body[8].apply([1.0, 0.0, 0.0])
    along = ahead - (ahead @ up) * up
    along /= np.linalg.norm(along)
    off = setting.places - given.pair.aim_point
    # a square turned with the track: its rows reach from side to side, and every quarter has its share
    flat = np.stack([off @ along, off @ np.cross(up, along)], axis=1) / side
    assert np.abs(flat).max() == pytest.approx(0.5, abs=0.01)
    # one after the other along the track; the Earth's curvature takes some ten-thousandths
    np.testing.assert_allclose(flat[:, 0], (np.arange(200) + 0.5) / 200 - 0.5, rtol=0.0, atol=1e-3)
    assert np.histogram2d(*flat.T, bins=4, range=[[-0.5, 0.5]] * 2)[0] == pytest.approx(12.5, abs=3.0)
    np.testing.assert_allclose(to_geodetic(setting.places, given.pair.radii)[:, 2], 0.0, atol=1e-6)
    assert set(setting.sigma_px) == {0.3} and setting.shots == 16
    assert setting.window == pytest.approx(64.0)
    apart = np.linalg.norm(setting.images.position[:16] - setting.images.position[16:], axis=1)
    assert setting.baseline == pytest.approx(apart.mean())


def test_a_place_is_shown_by_a_pinhole_of_the_planned_pose():
    setting = setting_of_plan(plan())
    rng = np.random.default_rng(1)
    image = rng.integers(0, 32, 40)
    places = setting.places[rng.integers(0, 60, 40)] + rng.normal(0.0, 3e3, (40, 3))
    found = pixels_of_places(setting.images, setting.detectors, setting.mounts, image, places)
    for pixel, k, place in zip(found, image, places, strict=True):
        turn = setting.images.world_from_body[int(k)] * NADIR_MOUNT
        x, y, z = turn.inv().apply(place - setting.images.position[k])
        focal = 350.0 / np.tan(np.radians(0.75))
        assert pixel == pytest.approx([349.5 + focal * y / z, 349.5 + focal * x / z], abs=1e-6)
    at = np.array([[-0.4, 699.4], [-0.6, 3.0], [3.0, 699.6], [np.nan, 1.0]])
    assert in_frame(setting.images, setting.detectors, np.zeros(4, int), at).tolist() == [True] + 3 * [False]


def test_points_of_a_problem_lie_where_their_rays_meet_and_its_control_where_it_says():
    given = problem(plan())
    truth = setting_of_plan(plan()).places
    control = ControlPoints(np.array([7, 3]), truth[[7, 3]] + [30.0, -20.0, 10.0], np.array([1.0, 2.0]))
    # a point seen once has no place, and those after it move up
    once = (given.tracks.point == 5) & (given.tracks.image > 0)
    tracks = Tracks(
        *(getattr(given.tracks, name)[~once] for name in ("image", "point", "pixels", "sigma_px"))
    )
    setting = setting_of_problem(replace(given, tracks=tracks, control=control))
    expected = truth.copy()
    expected[[7, 3]] = control.position
    # rays of float64 from 500 km
    np.testing.assert_allclose(setting.places, np.delete(expected, 5, axis=0), atol=1e-3)
    assert setting.control.point.tolist() == [6, 3] and setting.control.sigma.tolist() == [1.0, 2.0]
    rows = tracks.point != 5
    np.testing.assert_array_equal(setting.image, tracks.image[rows])
    np.testing.assert_array_equal(
        setting.point, np.where(tracks.point > 5, tracks.point - 1, tracks.point)[rows]
    )


def test_points_laid_out_over_a_problem_are_in_the_middle_frame_and_another():
    setting = setting_of_problem(problem(plan(), matched=False, sigma_px=0.2))
    assert set(setting.sigma_px) == {0.2} and 280 <= len(setting.places) <= 320
    np.testing.assert_allclose(to_geodetic(setting.places, setting.radii)[:, 2], 0.0, atol=1e-3)
    middle = np.full(len(setting.places), 8)
    pixels = pixels_of_places(setting.images, setting.detectors, setting.mounts, middle, setting.places)
    assert in_frame(setting.images, setting.detectors, middle, pixels).all()
    assert (np.bincount(setting.point) >= 2).all()
    # evenly: each quarter of what is seen by others too
    assert np.histogram2d(*pixels.T, bins=3, range=[[-0.5, 699.5]] * 2)[0].min() > 15


def test_moved_images_are_those_of_other_plans():
    base = setting_of_plan(plan())
    pair = base.images
    # a window of 40 s in place of 64: on the cubic through the positions, to parts of a metre
    short = with_window(base, 40.0 / 64.0).images
    made = setting_of_plan(plan(window=40.0)).images
    np.testing.assert_allclose(short.position, made.position, atol=5.0)
    turned = (short.world_from_body.inv() * made.world_from_body).magnitude()
    assert turned.max() < 1e-4
    # twice the window: beyond the positions, where the cubic leaves a circle by 4th order
    long, made = with_window(base, 2.0).images, setting_of_plan(plan(window=128.0)).images
    arc = 64.0 * 2.0 * np.pi / 5677.0
    np.testing.assert_allclose(long.position, made.position, atol=6871e3 * arc**4)
    # more shots of the same window
    more, made = with_shots(base, 32).images, setting_of_plan(plan(shots=32)).images
    order = np.lexsort((more.shot, more.camera))
    np.testing.assert_allclose(more.t[order], made.t, atol=1e-9)
    np.testing.assert_allclose(more.position[order], made.position, atol=5.0)
    # further apart, still looking at the middle
    apart = moved(base, pair.t, 1.5)
    assert apart.baseline == pytest.approx(1.5 * base.baseline)
    middle = base.places.mean(axis=0)
    for setting in (base, apart):
        seen = pixels_of_places(
            setting.images, setting.detectors, setting.mounts, np.arange(32), np.tile(middle, (32, 1))
        )
        assert np.abs(seen - 349.5).max() < 25.0


def test_points_are_thinned_and_repeated_and_control_is_kept():
    base = with_control(setting_of_plan(plan()), 5, 1.0)
    for count in (20, 60, 150):
        fewer = with_points(base, count)
        assert len(fewer.places) == count and len(np.unique(fewer.point)) == count
        np.testing.assert_array_equal(fewer.places[fewer.control.point], fewer.control.position)
        assert len(fewer.image) == 32 * count
    more = with_control(base, 2, 3.0)
    assert len(np.unique(more.control.point)) == 7
    np.testing.assert_array_equal(more.control.sigma, [1.0] * 5 + [3.0] * 2)
    # each is further from the others and the middle than any place left
    places = base.places
    among = np.vstack([places[base.control.point], places.mean(axis=0)])
    apart = np.linalg.norm(among[:, None] - among[None], axis=2) + 1e9 * np.eye(6)
    from_others = np.linalg.norm(places[:, None] - among[None], axis=2).min(axis=1)
    assert apart.min() >= from_others.max()


@pytest.mark.parametrize("flat", [True, False])
def test_heights_are_known_about_their_mean(flat):
    base = setting_of_plan(plan())
    if flat:
        base = replace(base, places=np.random.default_rng(2).normal(50.0, 5.0, (60, 3)), radii=None)
    prior = with_heights(base, 3.0).heights
    found = prior.above(np.asarray(base.places))[0]
    assert prior.sigma == 3.0 and found.mean() == pytest.approx(0.0, abs=1e-3)


def test_one_camera_moved_in_time_keeps_its_own_path_and_look():
    """Shots of one image each have no baseline: their axes are those of the flight."""
    base = setting_of_plan(plan())
    rows = np.flatnonzero(np.asarray(base.images.shot) % 2 == base.images.camera)
    images = base.images
    single = replace(
        base, images=type(images)(
            images.camera[rows], np.arange(len(rows)), images.t[rows], images.position[rows],
            images.world_from_body[rows],
        ),
    )  # fmt: skip
    assert single.baseline == 0.0
    later = moved(single, single.images.t + 0.5)
    whole = setting_of_plan(plan(offset=0.5)).images
    np.testing.assert_allclose(later.images.position, whole.position[rows], atol=5.0)
    # half a second on a circle of 5677 s, and what the mean direction of the path is off
    back = later.images.world_from_body.inv() * whole.world_from_body[rows]
    assert np.degrees(Rotation.magnitude(back)).max() < 0.1
