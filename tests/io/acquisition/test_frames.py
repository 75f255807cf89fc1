from __future__ import annotations

import numpy as np
import pytest
from tests.io.conftest import noise, write_tif

from sightline.cli.main import run
from sightline.errors import FormatError
from sightline.io.acquisition.load import load_acquisition

TOML = """
[acquisition]
epoch = "2026-01-01T00:00:00Z"

[platform]
kind = "level-flight"
altitude = 400e3
ground_speed = 7000.0

[camera]
focal_length_px = 1000.0
focal_length_sigma_px = 20.0

[[frame]]
image = "f0.tif"
time = 0.0

[[frame]]
image = "f1.tif"
time = "2026-01-01T00:00:06.5Z"
time_sigma = 0.29
"""


@pytest.fixture
def frames(folder):
    for k in range(2):
        write_tif(folder.path / f"f{k}.tif", noise(k, (150, 201)))
    folder.text = TOML
    return folder


def message(folder) -> str:
    with pytest.raises(FormatError) as caught:
        load_acquisition(folder.write())
    return str(caught.value)


def test_frames_lie_where_geometry_puts_them(frames):
    acquisition = load_acquisition(frames.write())
    first, second = acquisition.frames
    assert (first.name, second.name, second.time_sigma, second.camera.t) == ("f0", "f1", 0.29, 6.5)
    # 10 px to the left and 5 px ahead of the middle: one pixel is 400 m on the ground
    ground = first.camera.locate([[74.5 + 5, 100.0 + 10]], acquisition.surface)
    np.testing.assert_allclose(ground, [[-4000.0, 2000.0, 0.0]], atol=1e-6)
    # 6.5 s later the platform is 45.5 km = 113.75 px further north: the point lies that much behind
    np.testing.assert_allclose(second.camera.project(ground), [[79.5 - 113.75, 110.0]], atol=1e-6)
    said = repr(acquisition)
    assert said.startswith("<Acquisition: ") and "frames 2 (f0, f1)" in said
    assert "\n" not in said and len(said) < 400


def test_sigmas_of_the_lens_are_those_of_the_file(frames):
    lens = load_acquisition(frames.write()).lens
    assert (lens.focal_length_sigma_px, lens.principal_point_sigma_px, lens.distortion_sigma) == (
        20.0,
        0.0,
        0.0,
    )


def test_an_unknown_lens_starts_wide(frames):
    frames.replace("focal_length_px = 1000.0\nfocal_length_sigma_px = 20.0", 'focal_length_px = "estimate"')
    frames.replace("[[frame]]", 'distortion = "estimate"\nprincipal_point_px = "estimate"\n\n[[frame]]')
    acquisition = load_acquisition(frames.write())
    detector = acquisition.cameras[0].detector
    assert detector.focal_length_px == 201.0 and detector.principal_point_px == (74.5, 100.0)
    lens = acquisition.lens
    assert lens.focal_length_sigma_px == pytest.approx(0.4 * 201) and lens.distortion_sigma > 0.1
    assert lens.principal_point_sigma_px > 5.0


def test_frames_out_of_order_are_refused(frames):
    said = message(frames.replace("time = 0.0", "time = 10.0"))
    assert "[[frame]] number 2 (f1.tif) has a time before the one before it (6.5 s, 10 s)" in said


def test_two_frames_of_one_time_are_refused(frames):
    said = message(frames.replace("time = 0.0", "time = 6.5"))
    assert "[[frame]] number 2 (f1.tif) has the same time as the one before it" in said


def test_frames_of_different_shapes_are_refused(frames):
    write_tif(frames.path / "f1.tif", noise(1, (201, 150)))
    assert "f1.tif: 201 lines x 150 columns; f0.tif has 150 x 201" in message(frames)


def test_a_shape_that_disagrees_with_the_frames_is_refused(frames):
    said = message(frames.replace("[camera]", "[camera]\nshape = [201, 150]"))
    assert "[camera] shape = [201, 150], f0.tif has [150, 201] (lines, columns)" in said and "swapped" in said


def test_an_instant_without_an_epoch_is_refused(frames):
    said = message(frames.replace('epoch = "2026-01-01T00:00:00Z"\n', ""))
    assert "is an instant and [acquisition] has no epoch" in said


def test_an_instant_that_cannot_be_read_is_refused(frames):
    said = message(frames.replace("2026-01-01T00:00:06.5Z", "6.5 s after"))
    assert "'6.5 s after' is not a UTC instant" in said


def test_filters_on_a_frame_need_a_spin(frames):
    frames.replace("[[frame]]", '[[camera.strip]]\nname = "red"\nfirst_line = 0\nlines = 10\n\n[[frame]]')
    assert '[[camera.strip]] needs [platform] kind = "spin"' in message(frames)


def test_one_frame_alone_is_refused(frames):
    frames.text = frames.text[: frames.text.rindex("[[frame]]")]
    assert "1 [[frame]] given; motion is seen between two or more images" in message(frames)


def test_photographs_of_the_space_station_load_with_time_and_place_from_exif(real_data, tmp_path):
    from sightline.io.formats.exif import read_exif, write_photo_acquisition

    photos = sorted(real_data("iss_astropi_a").glob("*.jpg"))
    entry = read_exif(photos[0])
    # read off the EXIF by another program: 30 deg 48' 54.8" N, 58 deg 50' 54.8" E
    assert entry.time == "2023-05-05T03:28:50Z"
    assert entry.latitude_deg == pytest.approx(30 + 48 / 60 + 54.8 / 3600)
    assert entry.longitude_deg == pytest.approx(58 + 50 / 60 + 54.8 / 3600)
    # lines run against the flight: the camera is turned by half a turn about its axis, (0, 0, 1, 1) / sqrt 2
    half = np.sqrt(0.5)
    toml = write_photo_acquisition(photos, tmp_path, height=420e3, body_from_camera=(0, 0, half, half))
    acquisition = load_acquisition(toml)
    assert len(acquisition.frames) == 10 and acquisition.images[0].shape == (972, 1296)
    assert [camera.t for camera in acquisition.cameras][-1] == 55.0
    # features move about 98.5 px down the image per frame, as counted on the photographs; the unknown focal
    # length (start 1296 px, really about 980) makes that 130: within its 40 %
    middle = np.array([[485.5, 647.5]])
    moved = (
        acquisition.cameras[1].project(acquisition.cameras[0].locate(middle, acquisition.surface)) - middle
    )
    assert 98.5 * 0.6 < moved[0, 0] < 98.5 * 1.4 and abs(moved[0, 1]) < 10


def test_a_photograph_without_exif_time_is_named(frames):
    said = message(frames.replace('time = "2026-01-01T00:00:06.5Z"', 'time = "exif"'))
    assert "f1.tif: has no EXIF time" in said


def test_a_frame_that_is_not_there_is_described(frames, capsys):
    """Its size is that of the others, or of ``[camera] shape``; `recover` refuses it."""
    toml = frames.write()
    (frames.path / "f1.tif").unlink()
    assert run(["check", str(toml)]) == 1
    said = capsys.readouterr()
    assert "[[frame]] 2 image" in said.err and "f1.tif: no such file; its geometry" in said.err
    assert "150 lines x 201 columns" in said.err and "observable:" in said.out
    with pytest.raises(FormatError, match=r"f1\.tif: no such file"):
        load_acquisition(toml)
    (frames.path / "f0.tif").unlink()
    assert run(["check", str(toml)]) == 2
    frames.replace("[camera]\n", "[camera]\nshape = [150, 201]\n")
    assert run(["check", str(frames.write())]) == 1
    assert "(and 1 more images)" in capsys.readouterr().err
