"""Poses between anchors by closed forms: even turns, cubics, and a jitter that only the images know."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.photogrammetry.steady_flight import steady

from sightline.errors import InputError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.photogrammetry.flight.interpolation import between_anchors, by_displacement
from sightline.photogrammetry.sightings import Images

LEVEL = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
T = np.arange(21) / 10.0
ANCHORS = np.array([0, 10, 20])
DETECTOR = AreaDetector("frame", (200, 300), 400.0, (99.5, 149.5))


def test_slerp_is_exact_for_even_motion_and_holds_the_ends():
    place = np.outer(T, [1.0, 2.0, 3.0])
    turn = Rotation.from_rotvec(np.outer(T, [0.1, -0.2, 0.3]))
    found = between_anchors(T, ANCHORS, place[ANCHORS], turn[ANCHORS])
    np.testing.assert_allclose(found[0], place, atol=1e-12)
    assert (turn.inv() * found[1]).magnitude().max() < 1e-12
    inner = between_anchors(T, ANCHORS[1:], place[ANCHORS[1:]], turn[ANCHORS[1:]])
    np.testing.assert_allclose(inner[0][:10], place[[10] * 10])


def test_spline_is_exact_for_a_cubic():
    place = np.stack([T**3, T**2 - T, T], axis=1)
    anchors = np.arange(0, 21, 5)
    found = between_anchors(T, anchors, place[anchors], Rotation.identity(5), "spline")
    np.testing.assert_allclose(found[0], place, atol=1e-9)


def jittery(seed: int) -> tuple[np.ndarray, Rotation, np.ndarray]:
    """Even flight, 0.5 deg of roll and pitch jitter, and where frames show the ground under their anchor."""
    rng = np.random.default_rng(seed)
    place = np.column_stack([0.0 * T, 10.0 * T, np.full(21, 100.0)])
    angles = np.column_stack([np.radians(rng.normal(0.0, 0.5, (21, 2))), np.zeros(21)])
    turn = LEVEL * Rotation.from_rotvec(angles)
    shift = np.zeros((21, 2))
    for a in (0, 10):
        axis = (turn[a] * NADIR_MOUNT).apply([0.0, 0.0, 1.0])
        ground = place[a] - axis * place[a, 2] / axis[2]
        for k in range(a + 1, a + 11):
            ray = (turn[k] * NADIR_MOUNT).inv().apply(ground - place[k])
            # columns run to the left, lines forward: where the nominal mount has x and y
            shift[k] = pixels_of(ray) - np.array(DETECTOR.principal_point_px)
    return place, turn, shift


def pixels_of(ray: np.ndarray) -> np.ndarray:
    """(line, column) that looks along `ray`, by the detector's own straight lines."""
    middle = np.array(DETECTOR.principal_point_px)
    rows = DETECTOR.directions(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    rows = rows / rows[:, 2:]
    return middle + np.linalg.solve((rows[1:] - rows[0])[:, :2].T, (ray / ray[2] - rows[0])[:2])


def followed_of(shift: np.ndarray):
    followed = steady(21, 0.0)
    motion = np.zeros((21, 4))
    for a in (0, 10):
        motion[a + 1 : a + 11, :2] = np.diff(np.vstack([np.zeros(2), shift[a + 1 : a + 11]]), axis=0)
    return replace(followed, motion=motion)


def test_displacement_carries_the_jitter_between_anchors():
    place, turn, shift = jittery(0)
    known = (T, ANCHORS, place[ANCHORS], turn[ANCHORS])
    found = by_displacement(*known, followed_of(shift), DETECTOR, NADIR_MOUNT, 100.0)
    error = (turn.inv() * found[1]).as_rotvec()
    slerp = (turn.inv() * between_anchors(*known)[1]).as_rotvec()
    # of a jitter of 0.026 rad (3 sigmas) to the second order; but about the line of sight the shift
    # says nothing: ground that is 10 m of 100 m ahead turns jitter by half of 0.1 rad into yaw
    assert np.abs(error[:, :2]).max() < 3e-4
    assert np.abs(error[:, 2]).max() < 0.05 * 0.04
    assert np.abs(slerp[:, :2]).max() > 5e-3
    np.testing.assert_allclose(found[0], place, atol=1e-12)


def test_what_a_wrong_distance_leaves_is_spread_between_anchors():
    place, turn, shift = jittery(1)
    known = (T, ANCHORS, place[ANCHORS], turn[ANCHORS])
    found = by_displacement(*known, followed_of(shift), DETECTOR, NADIR_MOUNT, 103.0)
    error = np.abs((turn.inv() * found[1]).as_rotvec()[:, :2])
    # 10 m of flight seen from 103 m instead of 100: 2.9e-3 rad at the next anchor, taken back evenly
    assert error.max() < 5e-4
    assert error[ANCHORS].max() < 1e-12


def test_without_a_link_it_is_slerp():
    place, turn, shift = jittery(2)
    followed = followed_of(shift)
    before = followed.before.copy()
    before[15] = -1
    known = (T, ANCHORS, place[ANCHORS], turn[ANCHORS])
    found = by_displacement(*known, replace(followed, before=before), DETECTOR, NADIR_MOUNT, 100.0)
    slerp = between_anchors(*known)[1]
    assert (slerp[10:].inv() * found[1][10:]).magnitude().max() < 1e-12
    assert (slerp[:10].inv() * found[1][:10]).magnitude().max() > 1e-3


@pytest.mark.parametrize(
    ("turns", "anchors"), [(True, [4, 16, 23, 31]), (True, [4, 16]), (False, [4, 16, 23, 31])]
)
def test_frames_without_a_link_depart_from_rough_poses_as_anchors_do(turns, anchors):
    # two lines flown to and fro, as followed between anchors; the carrier turns with its track, or does not
    t, anchors, rng = np.arange(40.0), np.array(anchors), np.random.default_rng(0)
    along = np.concatenate([np.arange(20.0), np.arange(19.0, -1.0, -1.0)])
    track = np.column_stack([np.repeat([0.0, 30.0], 20), 5.0 * along, np.full(40, 100.0)])
    back = np.where(np.arange(40) < 20, 0.0, np.pi)
    nose = Rotation.from_rotvec(np.outer(back, [0.0, 0.0, 1.0])) * LEVEL
    # headings along noisy tracks
    guessed = nose * Rotation.from_rotvec(np.outer(rng.normal(0.0, 0.1, 40), [0.0, 0.0, 1.0]))
    rough = Images(np.zeros(40, dtype=int), np.arange(40), t, track, guessed)
    attitude = nose * Rotation.from_rotvec([0.1, 0.0, 0.02])
    if not turns:
        attitude = Rotation.concatenate([attitude[0]] * 40)
    place = track + np.array([3.0, -2.0, 1.0])
    flight = steady(40, 0.0, breaks=(20,))
    found = by_displacement(
        t, anchors, place[anchors], attitude[anchors], flight, DETECTOR, NADIR_MOUNT, 100.0, rough
    )
    inside = [(a, b) for a, b in pairwise(anchors) if (a < 20) == (b < 20)]
    outside = np.all([(t < a) | (t > b) for a, b in inside], axis=0)
    np.testing.assert_allclose(found[0][outside], place[outside], atol=1e-9)
    # that of a heading and of an anchor's, 4.5 sigmas; none where the nose stays
    assert (found[1].inv() * attitude).magnitude()[outside].max() < (
        4.5 * 0.1 * np.sqrt(2.0) if turns else 1e-9
    )


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="slerp or spline"):
        between_anchors(T, ANCHORS, np.zeros((3, 3)), Rotation.identity(3), "linear")
    with pytest.raises(InputError, match="two anchors"):
        between_anchors(T, ANCHORS[:1], np.zeros((1, 3)), Rotation.identity(1))


def test_turns_about_the_line_of_sight_are_carried_with_their_sign():
    # yaw jitter of 2 deg; where frames show two places of the ground, by the pinhole written out above
    rng = np.random.default_rng(4)
    place = np.column_stack([0.0 * T, 0.0 * T, np.full(21, 100.0)])
    turn = LEVEL * Rotation.from_rotvec(np.outer(np.radians(rng.normal(0.0, 2.0, 21)), [0.0, 0.0, 1.0]))
    ground = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    rays = [(turn[k] * NADIR_MOUNT).inv().apply(ground - place[k]) for k in range(21)]
    seen = np.array([[pixels_of(ray) for ray in both] for both in rays])
    across = (seen[:, 1] - seen[:, 0]) @ [1.0, 1.0j]  # its angle counts from line towards column
    followed = steady(21, 0.0)
    motion = np.zeros((21, 4))
    motion[1:, 2] = np.angle(across[1:] / across[:-1])
    known = (T, ANCHORS, place[ANCHORS], turn[ANCHORS])
    found = by_displacement(*known, replace(followed, motion=motion), DETECTOR, NADIR_MOUNT, 100.0)
    slerp = (turn.inv() * between_anchors(*known)[1]).magnitude()
    assert (turn.inv() * found[1]).magnitude().max() < 1e-9
    assert slerp.max() > np.radians(1.0)
