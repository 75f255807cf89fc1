"""Spacecraft that look at one point, against S2's own formulas (tests/photogrammetry/s2_scene.py)."""

from __future__ import annotations

import numpy as np
import pytest
from tests.photogrammetry import s2_scene

from sightline.errors import GeometryError, InputError
from sightline.geometry.aim import aimed_axes
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.geometry.orbit_pair import OrbitPair

CASES = [
    {},
    {"cross_track": 120e3, "offset": 20.0, "separation": 40.0},
    {"inclination": np.radians(51.6), "latitude": 0.0, "separation": 90.0, "altitude": 420e3},
]


def pair_and_times(case):
    case = dict(case)
    offset = case.pop("offset", 0.0)
    pair = OrbitPair(**case)
    return pair, pair.shot_times(64.0, 9, offset)


@pytest.mark.parametrize("case", CASES)
def test_places_are_those_of_the_closed_form(case):
    expected, _, _ = s2_scene.camera_places(shots=9, **case)
    pair, t = pair_and_times(case)
    d = (pair.positions(t) - pair.aim_point) @ pair.world_from_local.as_matrix()
    south_east_zenith = np.stack([-d[..., 1], d[..., 0], d[..., 2]], axis=-1)
    # the Earth's rate is known to 1e-8: 1000 s from the node it moves a place by 0.06 m; the velocity of the
    # closed form is a difference over 1 ms, good to 1e-10 of the distance moved aside
    np.testing.assert_allclose(south_east_zenith, expected, atol=0.1)


@pytest.mark.parametrize("case", CASES)
def test_axes_are_those_of_the_closed_form(case):
    places, _, _ = s2_scene.camera_places(shots=9, **case)
    expected = s2_scene.camera_axes(*places)
    pair, t = pair_and_times(case)
    # local x south, y east of the prototype, in our east, north, up
    local = pair.world_from_local.as_matrix() @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for ours, theirs in zip(pair.world_from_body(t), expected, strict=True):
        np.testing.assert_allclose(np.swapaxes(ours, 1, 2) @ local, theirs, atol=1e-6)


@pytest.mark.parametrize("leader", [1, 2])
def test_body_x_is_forward_whichever_camera_leads(leader):
    pair = OrbitPair(leader=leader)
    t = pair.shot_times(64.0, 9)
    velocity = pair.positions(t + 0.5) - pair.positions(t - 0.5)
    axes = pair.world_from_body(t)
    along = np.einsum("cki,cki->ck", axes[..., 0], velocity)
    down = np.einsum("cki,cki->ck", axes[..., 2], pair.aim_point - pair.positions(t))
    assert (along > 0.6 * np.linalg.norm(velocity, axis=-1)).all()
    np.testing.assert_allclose(down, np.linalg.norm(pair.positions(t) - pair.aim_point, axis=-1), rtol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)


def test_the_leader_sees_the_aim_point_behind_it():
    for leader, ahead in ((1, 0), (2, 1)):
        pair = OrbitPair(leader=leader)
        t = pair.shot_times(1.0, 1)
        places = pair.positions(t)[:, 0]
        forward = pair.positions(t + 0.5)[:, 0] - pair.positions(t - 0.5)[:, 0]
        lead = np.einsum("ci,ci->c", places - pair.aim_point, forward)
        assert lead[ahead] > 0.0 > lead[1 - ahead]


def test_axes_of_a_pair_are_s2_axes_and_their_y_turns_with_the_numbering():
    pair = OrbitPair()
    t = pair.shot_times(64.0, 3)
    first, second = pair.positions(t)
    body = pair.world_from_body(t)
    np.testing.assert_allclose(np.stack(aimed_axes(first, second, pair.aim_point)), body, atol=1e-12)
    swapped = np.stack(aimed_axes(second, first, pair.aim_point))[::-1]
    np.testing.assert_allclose(swapped, body * np.array([-1.0, -1.0, 1.0]), atol=1e-12)


@pytest.mark.parametrize("cross_track", [0.0, 80e3])
def test_the_aim_point_lies_on_the_ellipsoid_that_far_to_the_left(cross_track):
    pair = OrbitPair(radii=WGS84, longitude=0.3, cross_track=cross_track, aim_height=500.0)
    longitude, latitude, height = to_geodetic(pair.aim_point, WGS84)[0]
    assert height == pytest.approx(500.0, abs=1e-6)
    if cross_track:
        moved = pair.aim_point - OrbitPair(radii=WGS84, longitude=0.3, aim_height=500.0).aim_point
        t = np.array([pair.middle_time])
        forward = (pair.positions(t + 0.5) - pair.positions(t - 0.5)).mean(axis=(0, 1))
        left = np.cross(pair.aim_point, forward)
        # the Earth's radius differs by 0.3 % from the equator's, and inertial left by 4 degrees from ours
        assert moved @ left / np.linalg.norm(left) == pytest.approx(80e3, rel=1e-2)
    else:
        assert longitude == pytest.approx(0.3, abs=1e-9)
        # geocentric 55 degrees: geodetic by tan = tan / (b/a)^2
        flat = (WGS84[1] / WGS84[0]) ** 2
        # the nadir meets the ellipsoid square to it, not towards the centre: 0.02 degrees of latitude
        assert latitude == pytest.approx(np.arctan(np.tan(np.radians(55.0)) / flat), abs=4e-4)


def test_more_spacecraft_stand_between():
    pair = OrbitPair(cameras=3)
    t = pair.shot_times(64.0, 3)
    places = pair.positions(t)
    np.testing.assert_allclose(places[[0, 2]], OrbitPair().positions(t), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(places[1] - places[0], axis=1), 266e3, rtol=0.01)
    assert (pair.world_from_body(t)[..., 0] @ (places[0] - places[2]).T).min() > 0.0


def test_two_orbits_side_by_side():
    pair = OrbitPair(separation=0.0, node_offset=0.05)
    t = pair.shot_times(64.0, 3)
    # longitudes of two orbits apart by the node's: 0.05 rad at the pole's distance cos(55 deg)
    apart = np.linalg.norm(pair.positions(t)[0] - pair.positions(t)[1], axis=1)
    np.testing.assert_allclose(apart, 0.05 * np.cos(np.radians(55.0)) * 6871e3, rtol=0.08)


@pytest.mark.parametrize(
    ("case", "word"),
    [
        ({"separation": 0.0}, "no baseline"),
        ({"latitude": np.radians(85.0)}, "below 82.6 degrees"),
        ({"cameras": 1}, "`cameras`"),
        ({"cameras": 3, "leader": 2}, "`leader`"),
        ({"altitude": -1.0}, "`altitude`"),
        ({"inclination": 0.0}, "`inclination`"),
        ({"separation": -1.0}, "`separation`"),
    ],
)
def test_impossible_orbits_are_refused(case, word):
    with pytest.raises(InputError, match=word):
        OrbitPair(**case)


def test_a_point_below_the_horizon_is_refused():
    pair = OrbitPair()
    with pytest.raises(GeometryError, match="below the horizon"):
        pair.positions(pair.shot_times(1000.0, 10))
    for window, shots in ((0.0, 3), (64.0, 0)):
        with pytest.raises(InputError):
            pair.shot_times(window, shots)


def test_cameras_that_meet_in_a_single_shot_are_refused():
    pair = OrbitPair(separation=70.0)
    t = pair.shot_times(64.0, 3)
    places = np.array(pair.positions(t))
    places[1, 1] = places[0, 1]
    with pytest.raises(GeometryError, match="no baseline"):
        pair.world_from_body(t, places)


@pytest.mark.parametrize("case", CASES)
def test_elevations_are_those_of_the_closed_form(case):
    pair, t = pair_and_times(case)
    for places, found in zip(s2_scene.camera_places(shots=9, **case)[0], pair.elevations(t), strict=True):
        zenith = places[:, 2] / np.sqrt(places[:, 0] ** 2 + places[:, 1] ** 2 + places[:, 2] ** 2)
        np.testing.assert_allclose(np.sin(found), zenith, atol=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_cameras_converge_by_the_angle_between_their_lines_of_sight(case):
    first, last = s2_scene.camera_places(shots=9, **case)[0]
    cosine = (first * last).sum(axis=-1) / np.linalg.norm(first, axis=-1) / np.linalg.norm(last, axis=-1)
    pair, t = pair_and_times(case)
    # places to 0.1 m, some 500 km away
    np.testing.assert_allclose(pair.convergence(t), np.arccos(cosine), atol=1e-6)
    assert pair.convergence(t).min() > 0.1
