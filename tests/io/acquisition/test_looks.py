"""Where a push-broom looks: a circular orbit northwards over the equator, in closed form, straight down."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.formats_text import FORMATS

from sightline.errors import GeometryError
from sightline.io.acquisition.describe import describe_acquisition
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.tables import read_star_tracker

RADIUS, SPEED, LONGITUDE = 6378137.0 + 700e3, 7500.0, 10.0
HEADERS = {
    "orbit": "t,x,y,z",
    "attitude": "t,qx,qy,qz,qw",
    "star": "t,roll,pitch,yaw,sigma",
    "aocs": "t,qx,qy,qz,qw",
}


def orbit(t):
    """Positions (N, 3) and world_from_body at times t (N,): over 10 E, the equator at t = 0."""
    turned = Rotation.from_euler("z", LONGITUDE, degrees=True)
    angle = SPEED / RADIUS * t
    up = turned.apply(np.column_stack([np.cos(angle), np.zeros(len(t)), np.sin(angle)]))
    forward = turned.apply(np.column_stack([-np.sin(angle), np.zeros(len(t)), np.cos(angle)]))
    axes = np.stack([forward, np.cross(forward, up), -up], axis=2)  # x forward, y right, z down
    return RADIUS * up, Rotation.from_matrix(axes)


def table(folder, name, t, values):
    rows = [",".join(f"{v:.15g}" for v in (a, *row)) for a, row in zip(t, values, strict=True)]
    (folder.path / f"{name}.csv").write_text("\n".join([HEADERS[name], *rows]) + "\n")


@pytest.fixture
def flown(folder):
    """Writes the orbit with its attitudes changed, its quaternions in another order."""
    folder.replace('kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0\n',
                   'kind = "ephemeris"\npositions = "orbit.csv"\nattitudes = "attitude.csv"\n')  # fmt: skip

    def write(turn=(0.0, 0.0, 0.0), written=lambda q: q):
        t = np.linspace(-1.0, 1.0, 9)
        position, body = orbit(t)
        table(folder, "orbit", t, position)
        given = (body * Rotation.from_euler("xyz", turn, degrees=True)).as_quat()
        table(folder, "attitude", t, np.array([written(q) for q in given]))
        return folder.write()

    return write


def said(path):
    description = describe_acquisition(load_acquisition(path))
    return description["understood"], [w for w in description["missing"] if w.startswith("suspicious")]


def test_where_the_camera_is_and_looks_is_said(flown):
    understood, doubts = said(flown())
    assert not doubts
    assert any(w.startswith("at t = 0 s: 10 E 0 N, 700000 m, flies north; the middle of PAN sees 10 E")
               for w in understood)  # fmt: skip
    # 2e-4 rad are 0.0115 degrees; the nominal camera has its columns increase to the left
    assert any("XS 0.011 degrees (0.011 ahead, 0 right)" in w for w in understood)
    assert any("body x points 0 degrees" in w and "column 0 lies on the right" in w for w in understood)


def test_level_flight_says_so_in_its_own_axes(folder):
    understood, doubts = said(folder.write())
    assert not doubts and any("x 0, y 0, z 700000 m, flies north" in w for w in understood)


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        ((20.0, 0.0, 0.0), None),  # agile: to the side
        ((0.0, 25.0, 0.0), r"looks 25 degrees \(25 ahead, 0 right\) from straight down"),
        ((0.0, 0.0, 90.0), None),  # no ground in common: refused
        ((0.0, 0.0, 180.0), r"lines follow each other 180 degrees .*of the flown direction"),
    ],
)
def test_looks_far_from_nadir_and_track_are_asked_about(flown, turn, words):
    path = flown(turn)
    if turn[2] == 90.0:
        with pytest.raises(GeometryError):
            load_acquisition(path)
        return
    doubts = said(path)[1]
    assert bool(doubts) == bool(words)
    if words:
        assert re.search(words, doubts[0])
        assert load_acquisition(path).doubts


@pytest.mark.parametrize(
    ("written", "how"),
    [
        (lambda q: np.roll(q, 1), "with the scalar first"),
        (lambda q: q * [-1.0, -1.0, -1.0, 1.0], "as body_from_world, the inverse,"),
        (lambda q: np.roll(q * [-1.0, -1.0, -1.0, 1.0], 1), "with the scalar first and as body_from_world"),
    ],
)
def test_quaternions_written_otherwise_are_recognised(flown, written, how):
    try:
        doubts = "".join(said(flown(written=written))[1])
    except GeometryError as error:  # the other way looks past the ground
        doubts = str(error)
    assert f"; read {how}" in doubts and "0 degrees from straight down and 0 degrees" in doubts


def test_lines_and_pixels_that_are_no_squares_are_noted(folder):
    assert not any("times as far apart" in w for w in said(folder.write())[0])
    folder.replace("line_period = 5e-4", "line_period = 1e-3")
    # 7 m a line, 3.5 m a pixel
    assert any(
        "note: lines are 2 times as far apart on the ground as pixels" in w for w in said(folder.write())[0]
    )


SENSOR = '\n[[attitude_sensor]]\nname = "ST"\nkind = "star-tracker"\ntable = "star.csv"\n'


@pytest.mark.parametrize("size", [1e-4, 1.2])
def test_a_sensor_in_degrees_is_asked_about(folder, size):
    t = np.linspace(-0.1, 0.2, 31)
    table(folder, "star", t, np.column_stack([np.full((31, 3), size), np.full(31, 1e-5)]))
    folder.add(SENSOR)
    path = folder.write()
    doubts = said(path)[1]
    assert bool(doubts) == (size > 1.0)
    if doubts:
        assert "star-tracker ST: up to 1.2 rad (68.8 degrees) from the reference attitude" in doubts[0]


def test_the_documented_ephemeris_is_read_as_it_is_described(folder, monkeypatch):
    platform = re.search(r"```toml\n(\[platform\]\nkind = \"ephemeris\".*?)```", FORMATS, re.DOTALL)
    folder.replace(
        '[platform]\nkind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0\n', platform[1]
    )
    for name in ("orbit", "attitude"):
        text = re.search(rf"`{name}\.csv`:\n\n```csv\n(.*?)```", FORMATS, re.DOTALL)[1]
        (folder.path / f"{name}.csv").write_text(text)
    understood, doubts = said(folder.write())
    assert not doubts
    assert any("at t = 0 s: 10 E 0 N, 500000 m, flies north" in w for w in understood)
    assert any("PAN 0 degrees" in w for w in understood) and any(
        "body x points 0 degrees" in w for w in understood
    )
    # the recipe beside it makes angles of a star tracker of a body turned by 20, -30 and 10 urad
    monkeypatch.chdir(folder.path)
    given = np.genfromtxt("attitude.csv", delimiter=",", names=True)
    quat = np.column_stack([given[name] for name in ("qx", "qy", "qz", "qw")])
    turned = (Rotation.from_quat(quat) * Rotation.from_rotvec([20e-6, -30e-6, 10e-6])).as_quat()
    table(folder, "aocs", given["t"], turned)
    exec(re.search(r"```python\n(import numpy as np\n.*?Slerp.*?)```", FORMATS, re.DOTALL)[1], {})
    t, angles, _ = read_star_tracker(folder.path / "star_tracker.csv")
    assert np.array_equal(t, given["t"])
    np.testing.assert_allclose(angles, np.tile([20e-6, -30e-6, 10e-6], (3, 1)), atol=2e-9)
