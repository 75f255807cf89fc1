"""Points that flight lines have in common: which frames are compared, whether the places found are true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.flight.cross_links import CrossPlan, cross_pairs, link_stretches
from sightline.photogrammetry.sightings import Images, Tracks, joined

SHAPE, FOCAL, HEIGHT = (140, 180), 200.0, 50.0
#: world_from_body (x forward, y right, z down) of level flight north, and south.
NORTH = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SOUTH = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
MIDDLE = 0.5 * (np.array(SHAPE) - 1.0)


def flight() -> Images:
    """Three frames north, and three south beside them, 27 m (of 45 m) apart."""
    position = np.array([[0.0, y, HEIGHT] for y in (0, 6, 12)] + [[27.0, y, HEIGHT] for y in (12, 6, 0)])
    attitude = Rotation.from_matrix(np.stack([NORTH] * 3 + [SOUTH] * 3))
    t = np.array([0.0, 1.0, 2.0, 50.0, 51.0, 52.0])
    return Images(np.zeros(6), np.arange(6), t, position, attitude)


def on_ground(images: Images, frame: int, pixels: np.ndarray) -> np.ndarray:
    """x and y (n, 2) that pixels see, by plain geometry: level camera, flat ground; columns go left."""
    sign = 1.0 if frame < 3 else -1.0
    forward, left = ((pixels - MIDDLE) * HEIGHT / FOCAL).T
    return images.position[frame, :2] + sign * np.column_stack([-left, forward])


def pictures(images: Images, mosaic: np.ndarray | None = None, finest: float = 1.5) -> list[ArrayImage]:
    """What each frame sees of a ground of waves of `finest` m and more, perhaps behind a mosaic filter."""
    rng = np.random.default_rng(0)
    wave = rng.standard_normal((120, 2)) * 2.0 * np.pi / rng.uniform(finest, 12.0, (120, 1))
    gain = np.ones(SHAPE) if mosaic is None else np.tile(mosaic, np.array(SHAPE) // len(mosaic))
    phase = rng.uniform(0.0, 2.0 * np.pi, 120)
    grid = np.stack(np.indices(SHAPE), axis=-1).reshape(-1, 2).astype(float)
    out = []
    for frame in range(len(images)):
        light = np.cos(on_ground(images, frame, grid) @ wave.T + phase).sum(axis=1)
        noise = 0.5 * rng.standard_normal(len(grid))
        out.append(ArrayImage(gain * (1000.0 + 20.0 * (light + noise)).reshape(SHAPE)))
    return out


def detector(nm: tuple[float, float] | None = None) -> AreaDetector:
    by_line = None if nm is None else np.linspace(*nm, SHAPE[0])
    return AreaDetector("frame", SHAPE, FOCAL, (MIDDLE[0], MIDDLE[1]), (), by_line)


GROUP = np.array([0, 0, 0, 1, 1, 1])


def test_pairs_are_of_different_lines_that_see_the_same_ground():
    pairs = cross_pairs(flight(), detector(), NADIR_MOUNT, Plane(0.0), GROUP, 2)
    assert pairs and all(GROUP[i] == 0 and GROUP[j] == 1 for i, j, _ in pairs)
    # frame 0 is nearest to frame 5 and 4, which lie beside it and one further
    assert {j for i, j, _ in pairs if i == 0} == {4, 5}
    left_out = cross_pairs(flight(), detector(), NADIR_MOUNT, Plane(0.0), np.array([0, 0, 0, -1, -1, 1]), 2)
    assert {j for _, j, _ in left_out} == {5}


def test_frames_are_compared_that_moved_on_by_an_eighth_of_their_lines():
    # 0.12 of the 139 px from the first line to the last are 16.68 px; both lines begin anew, whatever lies
    # between them; the last frame is of the second line and sees all that the others do
    moved_px = np.array([0.0, 16.5, 16.8, 33.4, 33.6, 33.6, 20.0])
    group = np.array([0, 0, 0, 0, 0, -1, 1])
    position = np.column_stack([np.zeros(7), moved_px * HEIGHT / FOCAL, np.full(7, HEIGHT)])
    attitude = Rotation.from_matrix(np.stack([NORTH] * 7))
    images = Images(np.zeros(7), np.arange(7), np.arange(7.0), position, attitude)
    pairs = cross_pairs(images, detector(), NADIR_MOUNT, Plane(0.0), group, 5)
    assert [(i, j) for i, j, _ in pairs] == [(0, 6), (2, 6), (4, 6)]


def test_lines_of_like_wavelengths_only_are_compared():
    # lines run forward: what line l of a northbound frame sees, line 139 - l of a southbound one beside it
    # sees; over 450 to 900 nm they are alike within 90 nm in 140 * 90 / 450 = 28 lines about the middle
    pairs = cross_pairs(flight(), detector((450.0, 900.0)), NADIR_MOUNT, Plane(0.0), GROUP, 1)
    beside = [lines for i, j, lines in pairs if i + j == 5]
    step = (SHAPE[0] - 1) / 16.0  # between the lines that are probed
    for lines in beside:
        rows = np.flatnonzero(lines)
        assert abs(rows.mean() - MIDDLE[0]) < step and 28 - 2 * step < len(rows) < 28 + 2 * step


@pytest.fixture(scope="module")
def linked() -> Tracks:
    images = flight()
    found = link_stretches(
        pictures(images), images, detector(), NADIR_MOUNT, Plane(0.0), GROUP, CrossPlan(0.5, 0.005)
    )
    assert found is not None
    return found


def apart_px(linked: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """How far apart the two frames of each point put it (n, 2), and what is stated of that (n,); px."""
    images = flight()
    order = np.lexsort((linked.image, linked.point))
    first, second = order[::2], order[1::2]
    assert (linked.point[first] == linked.point[second]).all()
    ground = [
        np.concatenate([on_ground(images, int(linked.image[n]), linked.pixels[n : n + 1]) for n in rows])
        for rows in (first, second)
    ]
    apart = (ground[0] - ground[1]) * FOCAL / HEIGHT
    return apart, np.sqrt(linked.sigma_px[first] ** 2 + linked.sigma_px[second] ** 2)


def test_places_found_are_of_the_same_ground(linked):
    apart, stated = apart_px(linked)
    # good windows err by less than what is stated of them with the other wavelengths they do not have here
    assert np.abs(np.median(apart, axis=0)).max() < 0.05
    assert np.sqrt((apart**2).mean()) < np.sqrt((stated**2).mean()) < 0.4


def test_the_pattern_of_a_mosaic_is_not_taken_for_ground():
    # cells of 0.6 to 1.4 of the mean; as they are, windows lie where their patterns meet
    mosaic = np.random.default_rng(2).permutation(np.linspace(0.6, 1.4, 4)).reshape(2, 2)
    images = flight()
    plan = CrossPlan(0.5, 0.005, window=11, reduction=2)
    found = link_stretches(
        pictures(images, mosaic, finest=4.0), images, detector(), NADIR_MOUNT, Plane(0.0), GROUP, plan
    )
    assert found is not None
    apart, stated = apart_px(found)
    assert len(apart) > 50 and np.sqrt((apart**2).mean()) < np.sqrt((stated**2).mean()) < 0.4
    # of cells that counted for as much as they are bright the means would lie 0.27 px apart
    assert np.abs(np.median(apart, axis=0)).max() < 0.05


def test_lines_that_tables_turn_apart_are_linked_all_the_same(linked):
    # a constant that nothing states: the second line 12 px from where the poses, good to 2 px, have it
    images = flight()
    off = np.where(GROUP[:, None] == 1, 12.0 * HEIGHT / FOCAL * np.array([0.6, -0.8, 0.0]), 0.0)
    wrong = replace(images, position=images.position + off)
    plan = CrossPlan(0.5, 1.0 / FOCAL)
    found = link_stretches(pictures(images), wrong, detector(), NADIR_MOUNT, Plane(0.0), GROUP, plan)
    assert found is not None and len(found) > 0.5 * len(linked)
    apart, stated = apart_px(found)
    assert np.sqrt((apart**2).mean()) < np.sqrt((stated**2).mean()) < 0.4


def test_grounds_that_differ_are_not_linked():
    rng = np.random.default_rng(1)
    noise = [ArrayImage(rng.normal(100.0, 10.0, SHAPE)) for _ in range(6)]
    plan = CrossPlan(0.5, 0.005)
    assert link_stretches(noise, flight(), detector(), NADIR_MOUNT, Plane(0.0), GROUP, plan) is None


def test_tracks_are_joined_as_numbered():
    one = Tracks(np.array([0, 1]), np.array([0, 0]), np.zeros((2, 2)), np.array(0.1))
    two = Tracks(np.array([2]), np.array([7]), np.ones((1, 2)), np.array(0.2))
    both = joined([one, two])
    assert both.point.tolist() == [0, 0, 7] and both.sigma_px.tolist() == [0.1, 0.1, 0.2]
