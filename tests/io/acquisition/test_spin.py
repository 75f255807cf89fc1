"""Spinning platforms and scan mirrors in an ACQUISITION.toml, against rays worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import FormatError, GeometryError, SpanError
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import tables

LEVEL = 'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0'
#: Body x north, y east, z down, 700 km above the origin; turns forward about y by 0.01 rad/s.
SPIN = """kind = "spin"
position = [0.0, 0.0, 700e3]
attitude = [0.7071067811865476, 0.7071067811865476, 0.0, 0.0]
axis = [0.0, 1.0, 0.0]
rate = 0.01
rate_sigma = 1e-6
axis_sigma = 2e-6"""
MIRROR = """[pointing]
kind = "scan-mirror"
axis = [0.0, 1.0, 0.0]
normal = [1.0, 0.0, -1.0]
angles = "mirror.csv"
"""


def local_spin(folder, **changes):
    text = SPIN
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return folder.replace(LEVEL, text).add('[world]\nframe = "local"\n')


def message(folder, kind=FormatError) -> str:
    with pytest.raises(kind) as caught:
        load_acquisition(folder.write())
    return str(caught.value)


def test_a_spin_sweeps_the_lines_over_the_ground(folder):
    """Line i at t = i / 2000 s looks 0.01 t rad ahead: y = 700 km tan(0.01 t + look ahead)."""
    acquisition = load_acquisition(local_spin(folder).write())
    pan, xs = acquisition.cameras
    lines = np.array([0.0, 100.0, 199.0])
    ground = pan.locate(np.column_stack([lines, np.full(3, 59.5)]), acquisition.surface)
    assert_allclose(ground[:, 1], 700e3 * np.tan(0.01 * 5e-4 * lines), atol=1e-6)
    ahead = xs.locate([[100.0, 59.5]], acquisition.surface)[0]
    assert ahead[1] == pytest.approx(700e3 * np.tan(5e-4 + 2e-4), abs=1e-6)
    # the same ground, 2e-4 rad of spin earlier: 20 ms = 40 lines
    assert_allclose(xs.project(ground[1:2]), [[60.0, 59.5]], atol=1e-5)
    assert acquisition.spin is not None
    assert (acquisition.spin.rate_sigma, acquisition.spin.axis_sigma) == (1e-6, 2e-6)
    assert acquisition.spin.world_rate == 0.0


def test_a_spin_over_the_earth_stands_still_among_the_stars(folder):
    """On the equator looking down: the Earth's turn drags the axes along, 7.292e-5 rad/s."""
    down = "attitude = [0.0, -0.7071067811865476, 0.0, 0.7071067811865476]"  # z to -x, x to z (north), y to y
    folder.replace(LEVEL, SPIN).replace("[0.0, 0.0, 700e3]", "[7078137.0, 0.0, 0.0]")
    folder.replace("attitude = [0.7071067811865476, 0.7071067811865476, 0.0, 0.0]", down)
    acquisition = load_acquisition(folder.write())
    look = acquisition.cameras[0].rays([[0.0, 59.5], [199.0, 59.5]]).directions
    assert_allclose(look[0], [-1.0, 0.0, 0.0], atol=1e-12)
    t = 199 * 5e-4
    spun = np.array([-np.cos(0.01 * t), 0.0, np.sin(0.01 * t)])  # forward about +y (east): to the north
    turn = 7.292115e-5 * t
    expected = [spun[0] * np.cos(turn), -spun[0] * np.sin(turn), spun[2]]
    assert_allclose(look[1], expected, atol=1e-11)


def test_the_turn_of_other_axes_is_that_given(folder):
    acquisition = load_acquisition(
        folder.replace(LEVEL, SPIN + "\nworld_rate = 1.7585e-4")
        .replace("[0.0, 0.0, 700e3]", "[0.0, 0.0, 70e6]")
        .replace("ifov = 5e-6", "ifov = 5e-5")
        .add("[surface]\nradii = [71492e3, 66854e3]\n")
        .write()
    )
    assert acquisition.spin is not None and acquisition.spin.world_rate == 1.7585e-4


def test_a_spin_with_stars_needs_no_place(folder):
    folder.replace(LEVEL, SPIN.replace("position = [0.0, 0.0, 700e3]\n", ""))
    acquisition = load_acquisition(folder.add('[surface]\nkind = "infinity"\n').write())
    assert_allclose(acquisition.cameras[0].rays([[0.0, 59.5]]).origins, [[0, 0, 0]])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rate = 0.01", "rate = 0.0", "rate = 0 is no spin"),
        ("rate_sigma = 1e-6", "rate_sigma = -1", "platform.rate_sigma = -1 is not allowed"),
        ("axis_sigma = 2e-6", "axis_sigma = inf", "platform.axis_sigma = inf is not allowed"),
        ("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "axis: [0, 0, 0] has no direction"),
        ("0.7071067811865476, 0.0, 0.0]", "0.9, 0.0, 0.0]", "has length 1.14"),
        ("axis = [0.0, 1.0, 0.0]\n", "", "key 'platform.axis' is missing"),
        ("position = [0.0, 0.0, 700e3]\n", "", 'kind = "spin" has neither positions nor position'),
        ("position = [", 'positions = "p.csv"\nposition = [', "positions and position are both given"),
        ("rate = 0.01", "rate = 0.01\nworld_rate = 1e-4", "a flat ground that does not turn"),
    ],
)
def test_what_is_wrong_with_a_spin_is_said(folder, old, new, words):
    assert words in message(local_spin(folder, change=(old, new)))


def mirror(folder, t, angle, text=MIRROR):
    """A mirror at 45 degrees: the camera looks along body x, the mirror sends it down (z)."""
    tables.write_columns(folder.path / "mirror.csv", {"t": t, "angle": angle})
    # camera x, y, z = body y, z, x: behind the mirror columns run to the right, lines forward
    camera = "[camera]\nbody_from_camera = [0.5, 0.5, 0.5, 0.5]\n"
    return folder.add(camera + text)


def test_a_scan_mirror_moves_the_lines_by_twice_its_angle(folder):
    """Level flight at 7 km/s and a mirror that turns 0.005 rad/s: y = V t + H tan(2 * 0.005 t)."""
    t = np.array([-0.1, 0.3])
    acquisition = load_acquisition(mirror(folder, t, 0.005 * t).write())
    lines = np.array([0.0, 100.0, 199.0])
    seen = 5e-4 * lines
    ground = acquisition.cameras[0].locate(np.column_stack([lines, np.full(3, 60.5)]), acquisition.surface)
    ahead = 700e3 * np.tan(0.01 * seen)
    # one column to the right of the boresight: 5e-6 rad of the slant range, 3.5 m east
    expected = np.column_stack([3.5 / np.cos(0.01 * seen), 7000.0 * seen + ahead, 0 * seen])
    assert_allclose(ground, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "axis: [0, 0, 0] has no direction"),
        ("normal = [1.0, 0.0, -1.0]", "normal = [0, 0, 0]", "normal: [0, 0, 0] has no direction"),
        ("normal = [1.0, 0.0, -1.0]", "normal = [0, -2.0, 1e-4]", "is parallel to axis = [0.0, 1.0, 0.0]"),
        ('angles = "mirror.csv"', 'angles = "none.csv"', "none.csv: no such file"),
        ('angles = "mirror.csv"\n', "", "key 'pointing.angles' is missing"),
        ('kind = "scan-mirror"', 'kind = "scan"', "pointing.kind = 'scan' is not known"),
        ('kind = "scan-mirror"\n', "", "key 'pointing.kind' is missing; allowed: fixed, scan-mirror"),
    ],
)
def test_what_is_wrong_with_a_mirror_is_said(folder, old, new, words):
    assert old in MIRROR
    assert words in message(mirror(folder, [-0.1, 0.3], [0.0, 0.0], MIRROR.replace(old, new)))


def test_mirror_angles_in_degrees_are_recognised(folder):
    said = message(mirror(folder, [-0.1, 0.3], [-5.0, 12.5]))
    assert "mirror.csv: the mirror angles of [pointing] reach 12.5; allowed are -3.2 to 3.2 rad" in said


def test_mirror_angles_must_reach_over_the_images(folder):
    said = message(mirror(folder, [0.0, 0.05], [0.0, 1e-4]), SpanError)
    assert "mirror.csv: the mirror angles cover [0.000000, 0.050000] s" in said


def test_a_table_of_mirror_angles_may_end_with_the_images(folder):
    t = np.array([0.0, 199 * 5e-4])
    acquisition = load_acquisition(mirror(folder, t, 0.005 * t).write())
    assert np.isfinite(acquisition.cameras[0].rays([[0.0, 0.0], [199.0, 0.0]]).directions).all()


def test_a_sensor_model_takes_no_mirror(folder):
    folder.replace(LEVEL, 'kind = "camera-model"\nmodel = "m.json"')
    assert 'kind = "camera-model" brings its own; remove [pointing]' in message(
        mirror(folder, [0, 1], [0, 0])
    )


def test_a_sweep_may_begin_and_end_past_the_limb(folder):
    """From 700 km the northern limb is atan(6357 / sqrt(7078^2 - 6378^2)) = 64.23 degrees off.

    A spin that starts at 64.05 turns by 0.28 degrees during the image: a third of it looks past.
    """
    tilt = np.radians(64.05)
    half = -np.pi / 4 + tilt / 2  # looking down, turned forward about y
    down = [0.0, float(np.sin(half)), 0.0, float(np.cos(half))]
    spin = SPIN.replace("[0.0, 0.0, 700e3]", "[7078137.0, 0.0, 0.0]").replace("rate = 0.01", "rate = 0.05")
    spin = spin.replace("[0.7071067811865476, 0.7071067811865476, 0.0, 0.0]", repr(down))
    acquisition = load_acquisition(folder.replace(LEVEL, spin).write())
    ground = acquisition.cameras[0].locate([[0.0, 59.5], [199.0, 59.5]], acquisition.surface)
    assert np.isfinite(ground[0]).all() and np.isnan(ground[1]).all()
    over = SPIN.replace("[0.0, 0.0, 700e3]", "[7078137.0, 0.0, 0.0]")
    # the attitude of a flat world points the other way: nothing is seen
    said = message(folder.replace(spin, over), GeometryError)
    assert "100 % of PAN looks past the ground" in said


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ('[["PAN", "NIR"]]', "[matching] pairs names 'NIR', which is no [[band]]; there are: PAN, XS"),
        ('[["PAN", "PAN"]]', "[matching] pairs: 'PAN' with itself"),
        ('[["PAN"]]', "matching.pairs"),
        ("[]", "matching.pairs = [] is not allowed"),
    ],
)
def test_what_is_wrong_with_pairs_is_said(folder, pairs, words):
    assert words in message(folder.add(f"[matching]\npairs = {pairs}\n"))


def test_pairs_reach_the_recovery_by_name(folder):
    acquisition = load_acquisition(folder.add('[matching]\npairs = [["PAN", "XS"]]\n').write())
    assert acquisition.matching["pairs"] == (("PAN", "XS"),)
