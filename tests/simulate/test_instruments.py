"""Every instrument's rays and ground points against closed forms written out here, without the cameras.

Orbit: Kepler's circle in inertial axes, turned with the Earth. Rays: elementary vectors of where the camera
looks. Ground: the ellipsoid's quadratic by numpy's polynomial roots.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError
from sightline.geometry.circular_orbit import CircularOrbit
from sightline.geometry.earth import to_geodetic
from sightline.simulate.earth_view import meet_ellipsoid
from sightline.simulate.instrument_files import instrument_toml, write_instrument
from sightline.simulate.instruments import INSTRUMENT_CASES, INSTRUMENT_OPTIONS, instrument_case

GM, EARTH, A, B = 3.986004418e14, 7.292115e-5, 6378137.0, 6356752.314245179
SMALL = {"lines": 96, "columns": 64, "motion": "none"}


def turned(vector, axis, angle):
    """Rodrigues' formula: `vector` turned about the unit `axis`, right-handed."""
    cross = np.cross(axis, vector)
    return vector * np.cos(angle) + cross * np.sin(angle) + axis * (axis @ vector) * (1 - np.cos(angle))


def state(options, t):
    """Earth-fixed position and velocity on the circle, by hand: node at longitude 0.2, phase 0.7 or 0."""
    radius = A + options.altitude
    rate = np.sqrt(GM / radius**3)
    phase = (0.7 if options.altitude < 2e6 else 0.0) + rate * t
    node, tilt = 0.2, options.inclination
    x = np.array([np.cos(node), np.sin(node), 0.0])
    y = np.array([-np.sin(node) * np.cos(tilt), np.cos(node) * np.cos(tilt), np.sin(tilt)])
    position, velocity = np.cos(phase) * x + np.sin(phase) * y, -np.sin(phase) * x + np.cos(phase) * y
    z = np.array([0.0, 0.0, 1.0])
    fixed = turned(radius * position, z, -EARTH * t)
    return fixed, turned(radius * rate * velocity, z, -EARTH * t) - np.cross(EARTH * z, fixed)


def level(options, t):
    """Forward, right, down of the orbit; at geostationary height forward is east."""
    position, velocity = state(options, t)
    if options.altitude > 2e6:
        velocity = np.cross([0.0, 0.0, 1.0], position)
    down = -position / np.linalg.norm(position)
    right = np.cross(down, velocity)
    right /= np.linalg.norm(right)
    return np.cross(right, down), right, down


def look(scenario, line, across=0.0, ahead=0.0):
    """Direction of a pixel `across` the line's middle and `ahead` of the boresight (tangents), by hand."""
    options = scenario.options
    t, middle = line * options.line_period, 0.5 * options.duration
    sweep = options.scan_rate * (t - middle)
    if options.scan == "pushbroom":
        forward, right, down = level(options, t)
        # rolled to the right: right goes up, the line of sight to the right; columns grow to the left
        sight = np.cos(options.off_nadir) * down + np.sin(options.off_nadir) * right
        left = np.sin(options.off_nadir) * down - np.cos(options.off_nadir) * right
        return sight + ahead * forward + across * left
    if options.scan == "spin":
        forward, right, down = level(options, middle)
        axis = forward if options.altitude < 2e6 else -right
        # the stars stand still: back from the middle's Earth-fixed axes to those of t, z turns with the Earth
        z = np.array([0.0, 0.0, 1.0])
        sight = turned(turned(down, axis, options.off_nadir + sweep), z, -EARTH * (t - middle))
        axis = turned(axis, z, -EARTH * (t - middle))
        # lines run with the sweep, columns against the axis
        return sight + ahead * np.cross(axis, sight) - across * axis
    forward, right, down = level(options, t)
    angle = options.off_nadir + sweep
    if options.altitude < 2e6:  # the mirror sweeps to the left about the roll axis; columns grow forward
        sight, lines = turned(down, forward, angle), turned(-right, forward, angle)
        return sight + ahead * lines + across * forward
    # sweeps east about the pitch axis; columns grow to the right
    sight, lines = turned(down, right, angle), turned(forward, right, angle)
    return sight + ahead * lines + across * right


def ground(position, direction):
    """First root of the ellipsoid's quadratic along a ray."""
    scale = np.array([A, A, B])
    p, d = position / scale, direction / np.linalg.norm(direction) / scale
    roots = np.roots([d @ d, 2 * p @ d, p @ p - 1.0])
    return position + roots.real.min() * direction / np.linalg.norm(direction)


@pytest.mark.parametrize("case", INSTRUMENT_CASES)
def test_every_instrument_looks_where_geometry_by_hand_says(case):
    scenario = instrument_case(case, 0, **{**SMALL, "offset_sigma_px": 0.0, "rotation_sigma": 0.0})
    options = scenario.options
    for band, camera in zip(scenario.bands, scenario.cameras, strict=True):
        detector = band.options
        middle = (options.width(detector) - 1) / 2.0
        for line, column in ((0.0, 0.0), (50.0, 20.0), (95.0, middle)):
            across = (column - middle + detector.aside) * options.ifov * detector.fineness
            direction = look(scenario, line, across, -detector.behind * options.ifov)
            rays = camera.rays([[line, column]])
            # the true trajectory is a table: nodes 0.1 s apart, cubic in the attitude
            assert_allclose(rays.directions[0], direction / np.linalg.norm(direction), atol=1e-10)
            assert_allclose(rays.origins[0], state(options, line * options.line_period)[0], atol=1e-5)
            there = meet_ellipsoid(rays.origins, rays.directions)[0]
            # 1e-10 rad seen from 36,000 km: 4 mm, ten times that at the limb
            assert_allclose(there, ground(rays.origins[0], direction), atol=0.05)
            assert abs(to_geodetic([there])[0, 2]) < 1e-6


def test_the_lag_is_the_separation_over_the_scan_rate():
    """Claim 18: bands 97 px apart behind a sweep of one pixel per line see the same ground 97 lines apart."""
    scenario = instrument_case("spin-geo", 0, lines=400, columns=64, motion="none", offset_sigma_px=0.0)
    first, second = scenario.nominal_cameras[:2]
    rays = first.rays([[250.0, 31.5]])
    seen = second.project(meet_ellipsoid(rays.origins, rays.directions))[0]
    # the satellite stands still over the Earth, which turns 7.292e-5 rad/s against the 0.10472 of the sweep;
    # tangents of 97 px are no angles: (97 * 28e-6)^2 / 3 of them, 0.0002 px
    assert seen[0] - 250.0 == pytest.approx(97.0 / (1.0 - EARTH / 0.10472), abs=1e-3)


def test_a_ray_that_misses_the_earth_meets_nothing_and_its_pixel_is_dark():
    scenario = instrument_case("spin-geo", 0, lines=800, columns=32, off_nadir=np.radians(8.4), motion="none")
    camera = scenario.cameras[0]
    rays = camera.rays([[0.0, 15.0], [799.0, 15.0]])
    hit = np.isfinite(meet_ellipsoid(rays.origins, rays.directions)).all(axis=1)
    # the disc's edge is asin(6378 / 42164) = 8.70 degrees off; the sweep ends 0.64 degrees after 8.4
    assert hit.tolist() == [True, False]
    image = scenario.image(0)
    assert image[0].mean() > 500 and image[-1].mean() < 100


def test_a_circular_orbit_keeps_its_height_and_keplers_period():
    orbit = CircularOrbit(700e3, np.radians(98.0), 0.3, 1.0)
    t = np.linspace(0.0, 6000.0, 61)
    position, _ = orbit.inertial(t)
    assert_allclose(np.linalg.norm(position, axis=1), 7078137.0, rtol=1e-14)
    # 2 pi sqrt(r^3 / GM) = 5926.4 s for 7078 km
    again, _ = orbit.inertial(np.array([2 * np.pi * np.sqrt(7078137.0**3 / GM)]))
    assert_allclose(again[0], position[0], atol=1e-5)
    step = 0.01
    ahead, _ = orbit.earth_fixed(t + step)
    behind, _ = orbit.earth_fixed(t - step)
    # a central difference is wrong by step^2 / 6 of the third derivative: 1e-4 / 6 * 7500 * 1e-6 = 1e-7
    assert_allclose(orbit.earth_fixed(t)[1], (ahead - behind) / (2 * step), atol=1e-5)
    with pytest.raises(InputError, match="`altitude` of an orbit must be positive"):
        CircularOrbit(-1.0, 0.0)


def test_a_view_past_the_earth_is_refused():
    with pytest.raises(InputError, match="looks past the Earth: off-nadir angle 80 degrees"):
        instrument_case("spin-leo", 0, off_nadir=np.radians(80.0))
    with pytest.raises(InputError, match="unknown case: got 'spin'"):
        instrument_case("spin")
    with pytest.raises(InputError, match="unknown option: colour"):
        instrument_case("spin-leo", colour=1)
    with pytest.raises(InputError, match="`lines` must be from 16"):
        instrument_case("spin-leo", lines=8)


@pytest.mark.parametrize("case", ["staggered", "mirror-leo", "spin-geo"])
def test_files_hold_what_a_user_knows_and_no_truth(case, tmp_path):
    from sightline.io.acquisition.load import load_acquisition

    scenario = instrument_case(case, 3, lines=200 if case != "staggered" else 400, columns=48)
    written = write_instrument(scenario, tmp_path)
    assert {"acquisition.toml", "positions.csv", "truth.csv", "truth-bands.csv"} <= set(written)
    text = instrument_toml(scenario)
    for band in scenario.bands:
        assert repr(band.offset_px[0]) not in text
    acquired = load_acquisition(written["acquisition.toml"])
    pixels = np.array([[0.0, 0.0], [120.0, 30.0], [199.0, 47.0]])
    for loaded, known in zip(acquired.cameras, scenario.nominal_cameras, strict=True):
        a, b = loaded.rays(pixels), known.rays(pixels)
        # tables of half and quarter seconds against the true ones of a tenth: far below a pixel of 5e-6 rad
        assert_allclose(a.directions, b.directions, atol=1e-9)
        assert_allclose(a.origins, b.origins, atol=1e-3)


def test_every_line_of_a_detector_may_be_an_image():
    names = [d.name for d in INSTRUMENT_OPTIONS["every-line"]["detectors"]]
    assert len(names) == 16 and names[-1] == "L60"
