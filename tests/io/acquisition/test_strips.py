"""``[[camera.strip]]`` and the keys of a spinning camera, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from tests.io.conftest import noise, write_tif

from sightline.errors import FormatError, GeometryError, SightlineError
from sightline.io.acquisition.describe import describe_acquisition
from sightline.io.acquisition.load import load_acquisition

TOML = """
[platform]
kind = "spin"
attitude = [0.0, 0.0, 0.0, 1.0]
axis = [1.0, 0.0, 0.0]
axis_sigma = 0.01
rate = -0.2
rate_sigma = 1e-3
attitude_sigma = 0.01
attitude_turn_sigma = 0.05

[surface]
kind = "infinity"
parallax_sigma = 1e-4

[camera]
body_from_camera = [0.0, 0.0, 0.0, 1.0]
focal_length_px = 600.0
principal_point_px = [70.0, 100.0]
common_line_sigma_px = 10.0

[[camera.strip]]
name = "blue"
first_line = 0
lines = 70
axis_line = 100.0
axis_line_sigma_px = 0.1

[[camera.strip]]
name = "red"
first_line = 80
lines = 70
scale_sigma = 1e-4
height_sigma = 2e4

[[frame]]
image = "f0.tif"
mask = "m0.tif"
time = 0.0

[[frame]]
image = "f1.tif"
time = 0.4

[[frame]]
image = "f2.tif"
time = 0.8
"""


@pytest.fixture
def strips(folder):
    for k in range(3):
        write_tif(folder.path / f"f{k}.tif", noise(k, (150, 201)))
    mask = np.zeros((150, 201), np.uint8)
    mask[80:85] = 1
    write_tif(folder.path / "m0.tif", mask)
    folder.text = TOML
    return folder


def message(folder, kind: type[SightlineError] = FormatError) -> str:
    with pytest.raises(kind) as caught:
        load_acquisition(folder.write())
    return str(caught.value)


def test_every_strip_of_every_frame_is_an_image(strips):
    acquisition = load_acquisition(strips.write())
    frames = acquisition.frames
    assert [frame.name for frame in frames[:3]] == ["f0 blue", "f0 red", "f1 blue"]
    assert [(frame.exposure, frame.strip) for frame in frames[2:5]] == [(1, 0), (1, 1), (2, 0)]
    blue, red = frames[0], frames[1]
    assert blue.image.shape == red.image.shape == (70, 201)
    # of red no axis_line is given: the frame's own, less its first line
    assert blue.camera.detector.principal_point_px == (100.0, 100.0)
    assert red.camera.detector.principal_point_px == (-10.0, 100.0)
    whole = noise(0, (150, 201)).astype(np.float32)
    np.testing.assert_array_equal(red.image.read((0, 70), (3, 9)), whole[80:, 3:9])
    assert red.image.mask((0, 70), (0, 201))[:5].all()
    assert frames[2].image.mask((0, 70), (0, 201)) is None
    # looking along the optical axis at t = 0, and 0.4 s later 0.08 rad further
    look = red.camera.rays([[-10.0, 100.0]]).directions[0]
    np.testing.assert_allclose(look, [0.0, 0.0, 1.0], atol=1e-12)
    later = frames[3].camera.rays([[-10.0, 100.0]]).directions[0]
    np.testing.assert_allclose(later, [0.0, np.sin(0.08), np.cos(0.08)], atol=1e-9)


def test_what_is_known_of_the_chip_is_that_of_the_file(strips):
    acquisition = load_acquisition(strips.write())
    chip = acquisition.chip
    assert chip.names == ("blue", "red") and chip.common_line_sigma_px == 10.0
    assert chip.line_sigma_px == (0.1, 0.0) and chip.scale_sigma == (0.0, 1e-4)
    assert chip.height_sigma == (0.0, 2e4)
    assert acquisition.attitude_sigma is not None
    assert (acquisition.attitude_sigma.across, acquisition.attitude_sigma.about) == (0.01, 0.05)
    assert acquisition.parallax_sigma == 1e-4


def test_check_says_which_strips_see_each_other(strips):
    said = describe_acquisition(load_acquisition(strips.write()))
    # 48 px per exposure, strips 110 lines apart and 70 high: red is followed by blue after one (8 lines) and
    # two (56), and by itself after one (22)
    pairs = [(pair["a"], pair["b"], pair["exposures"]) for pair in said["pairs"]]
    assert {("red", "blue", 1), ("red", "blue", 2), ("red", "red", 1)} <= set(pairs)
    assert ("blue", "red", 1) not in pairs
    assert any("3 exposures of 2 strips on a spinning platform" in line for line in said["understood"])
    assert any("-0.08 rad an exposure" in line for line in said["understood"])
    assert any("directions may drift by 0.0001 rad/s" in line for line in said["understood"])


def test_check_warns_of_one_lag_alone(strips):
    strips.text = strips.text[: strips.text.rindex("[[frame]]")]
    said = describe_acquisition(load_acquisition(strips.write()))
    assert any("a second lag of any pair of strips" in line for line in said["missing"])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('name = "red"', 'name = "blue"', "two strips are called 'blue'"),
        ("first_line = 80", "first_line = 81", "'red' ends at line 151, a frame has 150 lines"),
        ("first_line = 80", "first_line = 60", "'blue' and 'red' share lines from 60 on"),
        ("first_line = 80", "first_line = -1", "first_line"),
        ("lines = 70\nscale", "lines = 0\nscale", "lines"),
        ("scale_sigma = 1e-4", "scale_sigma = -1e-4", "scale_sigma"),
        ("height_sigma = 2e4", "height_sigma = nan", "height_sigma"),
        ("axis_line_sigma_px = 0.1", "axis_line_sigma_px = -1", "axis_line_sigma_px"),
        ("axis_line = 100.0", "axis_lines = 100.0", "axis_line"),
        ('kind = "infinity"', "radii = [7e7, 7e7]", "parallax_sigma is for kind = "),
        ("attitude_sigma = 0.01", "attitude_sigma = -1", "attitude_sigma"),
        ("attitude_turn_sigma = 0.05", 'attitude_turn_sigma = "much"', "attitude_turn_sigma"),
        ("common_line_sigma_px = 10.0", "common_line_sigma_px = -1", "common_line_sigma_px"),
    ],
)
def test_a_wrong_key_is_one_clear_error(strips, old, new, expected):
    assert expected in message(strips.replace(old, new))


def test_a_frame_of_the_sky_alone_may_be_masked(strips):
    write_tif(strips.path / "m0.tif", np.ones((150, 201), np.uint8))
    assert load_acquisition(strips.write()).frames[0].image.mask((0, 70), (0, 201)).all()


def test_a_common_line_without_strips_is_refused(strips):
    first, last = strips.text.index("[[camera.strip]]"), strips.text.index("[[frame]]")
    strips.text = strips.text[:first] + strips.text[last:]
    assert "common_line_sigma_px is given without a [[camera.strip]]" in message(strips)


def test_a_body_that_no_image_sees_is_refused(strips):
    strips.replace('kind = "infinity"\nparallax_sigma = 1e-4', "radii = [7e7, 7e7]")
    strips.replace("attitude = [", "position = [0.0, 0.0, 2e8]\nattitude = [")
    assert "no image sees the ground; check attitude" in message(strips, GeometryError)
