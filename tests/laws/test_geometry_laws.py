"""What must hold for every camera, surface and motion: round trips, and rays of a closed form.

The closed form here is hand geometry for level flight: Rodrigues' rotation and similar triangles, no code of
the package.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera, PushbroomCamera
from sightline.geometry.earth import fixed_from_inertial, to_geodetic
from sightline.geometry.instrument import AreaDetector, LineDetector
from sightline.geometry.pointing import FixedMount, ScanMirror
from sightline.geometry.rotations import NADIR_MOUNT, orbital_axes
from sightline.geometry.surface import Dem, Ellipsoid, Infinity, Plane
from sightline.geometry.trajectory import Motion, Trajectory

ALTITUDE, SPEED, IFOV, PERIOD = 680e3, 6800.0, 5e-6, 5e-4
LINES, COLUMNS = 1200, 1000


def shaking(t: np.ndarray, size: float = 1e-6) -> np.ndarray:
    """Roll, pitch, yaw: a drift, a slow swing and three tones. At most 0.2 px of movement per line."""
    tones = np.stack([np.sin(2 * np.pi * f * t + f) for f in (47.0, 83.0, 121.0)], axis=1)
    slow = 40.0 * np.stack([np.sin(t), np.cos(0.7 * t), t], axis=1)
    return size * (tones + slow)


def rough(t: np.ndarray) -> np.ndarray:
    """A random walk of 0.06 px per line and axis."""
    return np.cumsum(np.random.default_rng(5).normal(size=(len(t), 3)) * 3e-7, axis=0)


MOTIONS = {"still": None, "shaking": shaking, "rough": rough}


def with_motion(trajectory: Trajectory, motion) -> Trajectory:
    """The trajectory with one of MOTIONS, on the grid of the line times."""
    if motion is None:
        return trajectory
    t = PERIOD * np.arange(-40, LINES + 40)
    return trajectory.with_motion(Motion(t, motion(t)))


@cache
def level_flight() -> Trajectory:
    return Trajectory.level_flight(ALTITUDE, SPEED, -1.0, 2.0)


@cache
def orbit() -> Trajectory:
    """A polar orbit at 680 km over the turning Earth, one node per second, looking down."""
    radius, rate, inclination = 7058e3, np.sqrt(3.986e14 / 7058e3**3), np.deg2rad(98.0)
    t = np.arange(-8.0, 12.0)
    u = 0.75 + rate * t
    across = np.array([0.0, np.cos(inclination), np.sin(inclination)])
    position = radius * (np.cos(u)[:, None] * [1.0, 0, 0] + np.sin(u)[:, None] * across)
    velocity = radius * rate * (-np.sin(u)[:, None] * [1.0, 0, 0] + np.cos(u)[:, None] * across)
    position, velocity = fixed_from_inertial(t, position, velocity, angle=0.5)
    return Trajectory(t, position, t, orbital_axes(position, velocity), velocity=velocity)


def off_nadir(trajectory: Trajectory, *angles: float) -> Trajectory:
    """The same platform turned by large roll, pitch, yaw."""
    turned = trajectory.world_from_body * Rotation.from_euler("XYZ", angles)
    return Trajectory(
        trajectory.t_position,
        trajectory.position,
        trajectory.t_attitude,
        turned,
        velocity=trajectory.velocity,
    )


def hills(x: np.ndarray, y: np.ndarray, wavelength: float) -> np.ndarray:
    """Heights (len(y), len(x)) between 0 and 800 m, north up."""
    k = 2 * np.pi / wavelength
    return (400.0 + 200.0 * (np.sin(k * x)[np.newaxis] + np.cos(1.3 * k * y)[:, np.newaxis]))[::-1]


def dem_around(points: np.ndarray, crs: str | None) -> Dem:
    """A DEM of hills that covers `points` and 40 km around them."""
    if crs is None:
        x, y, step, margin = points[:, 0], points[:, 1], 90.0, 40e3
    else:
        lon_lat = np.rad2deg(to_geodetic(points)[:, :2])
        x, y, step, margin = *lon_lat.T, 90.0 / 111e3, 0.5
        if crs != "EPSG:4326":
            from pyproj import Transformer

            x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(x, y)
            step, margin = 90.0, 40e3
    east = np.arange(np.min(x) - margin, np.max(x) + margin, step)
    north = np.arange(np.min(y) - margin, np.max(y) + margin, step)
    transform = (step, 0.0, east[0] - step / 2, 0.0, -step, north[-1] + step / 2)
    return Dem(hills(east, north, 60 * step), transform, crs)


def pixels_over(lines: int, columns: int, margin: float = 0.0, count: int = 400) -> np.ndarray:
    """Random pixels of the image, its corners among them."""
    rng = np.random.default_rng(2)
    low, high = np.array([-0.5, -margin]), np.array([lines - 0.5, columns - 1 + margin])
    corners = np.array([low, [low[0], high[1]], [high[0], low[1]], high])
    inside = np.clip(corners, low + 1e-6, high - 1e-6)
    return np.concatenate([rng.uniform(low, high, (count, 2)), inside])


def assert_round_trip(camera, surface, pixels: np.ndarray) -> None:
    """locate then project returns to the pixel within a millionth."""
    points = camera.locate(pixels, surface)
    assert np.isfinite(points).all()
    assert_allclose(camera.project(points), pixels, rtol=0, atol=1e-6)


def rodrigues(vector: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """`vector` turned about `angles` (rotation vectors): v cos + (k x v) sin + k (k.v)(1 - cos)."""
    size = np.sqrt((angles**2).sum(axis=1, keepdims=True))
    axis = angles / np.where(size > 0, size, 1.0)
    inner = (axis * vector).sum(axis=1, keepdims=True)
    return vector * np.cos(size) + np.cross(axis, vector) * np.sin(size) + axis * inner * (1 - np.cos(size))


def ground_by_hand(pixels, angles, look_ahead=0.0, rotation=0.0, offset=(0.0, 0.0), height=0.0):
    """Where pixels of the level flight look, from similar triangles."""
    line, column = pixels.T
    across = IFOV * ((column - (COLUMNS - 1) / 2) * np.cos(rotation) + offset[1])
    ahead = np.tan(look_ahead) + IFOV * ((column - (COLUMNS - 1) / 2) * np.sin(rotation) + offset[0])
    body = np.stack([ahead, -across, np.ones_like(across)], axis=1)  # forward, right, down
    forward, right, down = rodrigues(body, angles).T
    reach = (ALTITUDE - height) / down
    return np.stack(
        [reach * right, SPEED * PERIOD * line + reach * forward, np.full_like(reach, height)], axis=1
    )


@pytest.mark.parametrize("look_ahead", [0.0, 0.5, -0.3])
@pytest.mark.parametrize("rotation", [0.0, 0.1, -3e-4])
@pytest.mark.parametrize("motion", MOTIONS)
def test_rays_of_level_flight_are_those_of_hand_geometry(look_ahead, rotation, motion):
    """At whole lines the pose table is exact. 1e-8 m is rounding: 680 km x 1e-16 x a few operations."""
    rng = np.random.default_rng(3)
    pixels = np.stack([rng.integers(0, LINES, 300), rng.uniform(0, COLUMNS - 1, 300)], axis=1)
    shake = MOTIONS[motion]
    t = PERIOD * np.arange(-40, LINES + 40)
    angles = np.zeros((300, 3)) if shake is None else shake(t)[pixels[:, 0].astype(int) + 40]
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD, look_ahead, (0.7, -1.2), rotation)
    camera = PushbroomCamera(detector, with_motion(level_flight(), shake), FixedMount(), 0.0, LINES)
    expected = ground_by_hand(pixels, angles, look_ahead, rotation, (0.7, -1.2), height=30.0)
    assert_allclose(camera.locate(pixels, Plane(30.0)), expected, rtol=0, atol=1e-8)


def test_between_lines_rays_follow_the_motion_to_the_error_of_the_cubic():
    """A 121 Hz tone of 1 urad: w^4 h^4 (9/16) / 24 of it = 1 urad x 0.00049, over 680 km 0.33 mm."""
    rng = np.random.default_rng(4)
    pixels = np.stack([rng.uniform(2, LINES - 3, 500), rng.uniform(0, COLUMNS - 1, 500)], axis=1)
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD)
    camera = PushbroomCamera(detector, with_motion(level_flight(), shaking), FixedMount(), 0.0, LINES)
    error = camera.locate(pixels, Plane()) - ground_by_hand(pixels, shaking(PERIOD * pixels[:, 0]))
    bound = ALTITUDE * 1e-6 * (2 * np.pi * 121 * PERIOD) ** 4 * (9 / 16) / 24
    assert np.abs(error[:, :2]).max() < 1.1 * bound


@pytest.mark.parametrize("surface", ["plane", "dem", "infinity"])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("look_ahead", [0.0, 0.5])
def test_a_pushbroom_pixel_over_a_flat_world_survives_the_round_trip(surface, motion, look_ahead):
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD, look_ahead, rotation=0.1)
    trajectory = with_motion(level_flight(), MOTIONS[motion])
    camera = PushbroomCamera(detector, trajectory, FixedMount(), 0.0, LINES)
    pixels = pixels_over(LINES, COLUMNS, margin=49.0)
    if surface == "infinity":
        # the camera turns too little to scan the sky by itself: only the direction returns
        rays = camera.rays(pixels)
        far = camera.locate(pixels, Infinity())
        assert_allclose(far / np.sqrt((far**2).sum(axis=1, keepdims=True)), rays.directions, atol=1e-13)
        return
    plane = camera.locate(pixels, Plane())
    assert_round_trip(camera, Plane(-50.0) if surface == "plane" else dem_around(plane, None), pixels)


@pytest.mark.parametrize("surface", ["ellipsoid", "raised", "EPSG:4326", "EPSG:32612"])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.52, 0.0, 0.05), (-0.2, 0.4, 0.0)])
def test_a_pushbroom_pixel_over_the_turning_earth_survives_the_round_trip(surface, motion, turn):
    """Also 30 degrees off nadir to the side, and ahead."""
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD, 0.1, rotation=-0.1)
    trajectory = with_motion(off_nadir(orbit(), *turn), MOTIONS[motion])
    camera = PushbroomCamera(detector, trajectory, FixedMount(), 0.0, LINES, lever_arm=(1.0, -0.5, 2.0))
    pixels = pixels_over(LINES, COLUMNS, margin=49.0)
    if surface == "ellipsoid":
        ground = Ellipsoid()
    elif surface == "raised":
        ground = Ellipsoid().raised(3000.0)
    else:
        ground = dem_around(camera.locate(pixels, Ellipsoid()), surface)
    assert_round_trip(camera, ground, pixels)


@pytest.mark.parametrize("kind", ["uneven lines", "measured detector", "mirror", "turned mount", "short"])
def test_unusual_pushbroom_cameras_survive_the_round_trip(kind):
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD)
    trajectory, mount, times, lines = with_motion(level_flight(), shaking), FixedMount(), None, LINES
    if kind == "uneven lines":
        times = PERIOD * np.arange(LINES) + 1e-4 * np.sin(np.arange(LINES) / 150.0)
    elif kind == "measured detector":
        x = np.linspace(-1, 1, COLUMNS)
        bent = detector.tangents + 1e-5 * np.stack([0.3 * x**3, x**2], axis=1)
        detector = LineDetector("bent", unit(bent), PERIOD)
    elif kind == "mirror":
        towards = NADIR_MOUNT * Rotation.from_euler("X", -np.pi / 2)
        mount = ScanMirror(towards, [0.0, 1.0, 0.0], [-1.0, 0, 1.0], [-2, 0, 2], [-0.02, 0.0, 0.02])
    elif kind == "turned mount":
        mount = FixedMount(NADIR_MOUNT * Rotation.from_euler("Z", np.pi))
    else:
        lines = 2
    camera = PushbroomCamera(detector, trajectory, mount, 0.0, lines, line_times=times)
    assert_round_trip(camera, Plane(), pixels_over(lines, COLUMNS, margin=40.0))


def unit(tangents: np.ndarray) -> np.ndarray:
    vectors = np.concatenate([tangents, np.ones((len(tangents), 1))], axis=1)
    return vectors / np.sqrt((vectors**2).sum(axis=1, keepdims=True))


@pytest.mark.parametrize("readout", [0.0, 0.03, -0.02])
@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 1e-3, -5e-4, 0.01)])
@pytest.mark.parametrize("world", ["flat", "earth"])
def test_a_frame_pixel_survives_the_round_trip(readout, distortion, world):
    """A field of 17 x 23 degrees at 680 km: all of it on the ground."""
    detector = AreaDetector("frame", (1200, 1600), 4000.0, (610.0, 790.0), distortion)
    trajectory = level_flight() if world == "flat" else off_nadir(orbit(), 0.2, -0.1, 0.3)
    camera = FrameCamera(detector, with_motion(trajectory, shaking), FixedMount(), 0.1, readout)
    surface = Plane() if world == "flat" else Ellipsoid(height=500.0)
    assert_round_trip(camera, surface, pixels_over(1200, 1600))


@settings(max_examples=60, deadline=None)
@given(
    roll=st.floats(-0.6, 0.6),
    pitch=st.floats(-0.6, 0.6),
    yaw=st.floats(-3.1, 3.1),
    look_ahead=st.floats(-0.5, 0.5),
    rotation=st.floats(-0.1, 0.1),
    shake=st.floats(0.0, 3e-6),
    line=st.floats(-0.49, LINES - 0.51),
    column=st.floats(-49.0, COLUMNS + 48.0),
)
def test_any_attitude_survives_the_round_trip(roll, pitch, yaw, look_ahead, rotation, shake, line, column):
    """Where the scene moves across the row. Flying along the row there is no image, so yaw near 90 degrees
    (and attitudes that come to the same) is left out by the speed of the scan itself."""
    t = PERIOD * np.arange(-40, LINES + 40)
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD, look_ahead, rotation=rotation)
    trajectory = off_nadir(level_flight(), roll, pitch, yaw).with_motion(Motion(t, shaking(t, shake)))
    camera = PushbroomCamera(detector, trajectory, FixedMount(), 0.0, LINES)
    pixel = np.array([[line, column]])
    point = camera.locate(pixel, Plane())
    around = np.clip(line + np.linspace(-30, 30, 61), -0.5, LINES - 0.5)
    seen = camera.camera_tangents(np.repeat(point, 61, axis=0), around) @ [
        -detector.axis[1],
        detector.axis[0],
    ]
    steps = np.diff(seen) / np.maximum(np.diff(around), 1e-12)
    assume(np.isfinite(point).all())
    assume((np.abs(steps[np.diff(around) > 0]) > 0.5 * IFOV).all())
    assert_allclose(camera.project(point), pixel, rtol=0, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    point=st.tuples(st.floats(-2000, 2000), st.floats(100, 3900), st.floats(0, 700)),
    look_ahead=st.floats(-0.3, 0.3),
)
def test_project_then_the_ray_passes_through_the_point(point, look_ahead):
    """The other way round: within 1e-6 px = 3.4e-6 m of ground."""
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD, look_ahead)
    start = -ALTITUDE * np.tan(look_ahead) / SPEED
    flight = Trajectory.level_flight(ALTITUDE, SPEED, start - 1.0, start + 2.0)
    camera = PushbroomCamera(detector, flight, FixedMount(), start, LINES)
    pixel = camera.project(point)
    assume(np.isfinite(pixel).all())
    rays = camera.rays(pixel)
    towards = np.asarray(point) - rays.origins
    across = towards - (towards * rays.directions).sum(axis=1, keepdims=True) * rays.directions
    assert np.abs(across).max() < 3.4e-6


def test_turning_world_and_camera_together_turns_the_points():
    """Nothing may depend on where zero longitude lies."""
    turn = Rotation.from_rotvec([0.0, 0.0, 2.1])
    plain = orbit()
    turned = Trajectory(
        plain.t_position,
        turn.apply(plain.position.copy()),
        plain.t_attitude,
        turn * plain.world_from_body,
        velocity=turn.apply(plain.velocity.copy()),
    )
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD)
    pixels = pixels_over(LINES, COLUMNS)
    here, there = (
        PushbroomCamera(detector, path, FixedMount(), 0.0, LINES).locate(pixels, Ellipsoid(height=100.0))
        for path in (plain, turned)
    )
    assert_allclose(turn.apply(here), there, rtol=0, atol=2e-8)


def test_a_constant_shift_of_the_motion_equals_a_turned_mount():
    """body * small * mount = body * (small * mount): two ways of the same product."""
    angles = np.array([3e-4, -2e-4, 5e-4])
    detector = LineDetector.from_ifov("B", COLUMNS, IFOV, PERIOD)
    moved = level_flight().with_motion(Motion.zero(-1.0, 2.0).shifted(angles))
    one = PushbroomCamera(detector, moved, FixedMount(), 0.0, LINES)
    other = PushbroomCamera(
        detector, level_flight(), FixedMount(Rotation.from_rotvec(angles) * NADIR_MOUNT), 0.0, LINES
    )
    pixels = pixels_over(LINES, COLUMNS)
    assert_allclose(one.locate(pixels, Plane()), other.locate(pixels, Plane()), rtol=0, atol=1e-8)
