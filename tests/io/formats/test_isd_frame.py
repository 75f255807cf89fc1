"""Frame ISDs: a mapping camera over the Moon, written here, compared with `tests/csm_reference.py`."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests import csm_reference as reference
from tests.io.conftest import noise

from sightline.errors import FormatError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.isd_frame import read_frame_model

ET = 302228504.5
LINES, SAMPLES = 1024, 1280


def frame_isd(later: float = 0.0, **changes) -> dict:
    """A frame ISD at ET + later: 100 km above the Moon, looking down, turned by what a mount has."""
    angle = 9e-4 * later
    place = 1837.4 * np.array([np.cos(angle), 0.0, np.sin(angle)])
    down, ahead = -place / 1837.4, np.array([-np.sin(angle), 0.0, np.cos(angle)])
    inertial_from_sensor = np.stack([ahead, np.cross(down, ahead), down], axis=-1)
    mount = Rotation.from_euler("xyz", [0.01, -0.02, 0.3]).as_matrix()
    pointing = Rotation.from_matrix(inertial_from_sensor.T).as_quat(scalar_first=True)
    body = Rotation.from_rotvec([0.0, 0.0, 2.66e-6 * later]).as_quat(scalar_first=True)
    et = ET + later
    return {
        "name_model": "USGS_ASTRO_FRAME_SENSOR_MODEL", "image_lines": LINES, "image_samples": SAMPLES,
        "center_ephemeris_time": et, "radii": {"semimajor": 1737.4, "semiminor": 1737.4, "unit": "km"},
        "body_rotation": {"ephemeris_times": [et], "quaternions": [body.tolist()], "reference_frame": 1},
        "instrument_pointing": {
            "ephemeris_times": [et], "quaternions": [pointing.tolist()], "reference_frame": 1,
            "constant_rotation": mount.ravel().tolist(),
        },
        "instrument_position": {
            "ephemeris_times": [et], "positions": [place.tolist()], "velocities": [[0.0, 1.6, 0.0]],
            "reference_frame": 1, "unit": "km",
        },
        "detector_sample_summing": 2, "detector_line_summing": 2,
        "focal_length_model": {"focal_length": 76.2}, "detector_center": {"line": 1030.5, "sample": 1270.0},
        "focal2pixel_lines": [0.0, 3.0, 71.0], "focal2pixel_samples": [0.0, 71.0, -3.0],
        "optical_distortion": {"radial": {"coefficients": [1e-4, -2e-5, 1e-8]}},
        "starting_detector_line": 6, "starting_detector_sample": 4,
    } | changes  # fmt: skip


def write(folder, name="f.json", **changes):
    (folder / name).write_text(json.dumps(frame_isd(**changes)))
    return folder / name


@pytest.mark.parametrize(
    "distortion",
    [{"radial": {"coefficients": [1e-4, -2e-5, 1e-8]}}, {"radial": {"coefficients": [0.0, 0.0, 0.0]}}],
)
def test_rays_are_those_of_the_reference(tmp_path, distortion):
    model = read_frame_model(write(tmp_path, optical_distortion=distortion))
    isd = frame_isd(optical_distortion=distortion)
    at = model.world_from_body * FixedMount().body_from_camera
    rng = np.random.default_rng(3)
    for pixel in [(0, 0), (LINES - 1, SAMPLES - 1), *rng.integers(0, LINES, (30, 2))]:
        origin, direction = reference.frame_ray(isd, pixel[0] + 0.5, pixel[1] + 0.5)
        looked = at.apply(model.detector.directions([pixel])[0])
        assert np.linalg.norm(looked - direction) * model.detector.focal_length_px < 2e-3
        assert np.linalg.norm(model.position - origin) < 1e-6
    assert model.lens_px < 1e-3
    # 142 px of the detector per mm, summed by two
    assert model.detector.focal_length_px == pytest.approx(76.2 * np.hypot(71.0, 3.0) / 2.0, rel=2e-3)
    assert model.radii == (1737400.0, 1737400.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"focal2pixel_samples": [0.0, -71.0, 3.0]}, "the image is mirrored"),
        (
            {"focal2pixel_samples": [0.0, 80.0, -3.0]},
            "these leave .* px, 0.01 px are allowed; are its pixels",
        ),
        (
            {"name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"},
            "USGS_ASTRO_FRAME_SENSOR_MODEL is read here",
        ),
        ({"image_lines": 1}, "'image_lines' is 1"),
        (
            {"optical_distortion": {"lunarorbiter": {}}},
            "'lunarorbiter' is not read: it is that of a film camera",
        ),
    ],
)
def test_what_is_no_lens_of_ours_is_refused(tmp_path, changes, said):
    with pytest.raises(FormatError, match=rf"f\.json: .*{said}"):
        read_frame_model(write(tmp_path, **changes))


ACQUISITION = """
[platform]
kind = "camera-model"
[surface]
height_sigma = 50.0
"""


def flown(folder, count=3, extra=""):
    """Frames 5 s (8 km) apart, of 80 km side."""
    text = ACQUISITION
    for k in range(count):
        np.save(folder / f"{k}.npy", noise(k, (LINES, SAMPLES)))
        write(folder, f"{k}.json", later=5.0 * k)
        text += f'[[frame]]\nimage = "{k}.npy"\nmodel = "{k}.json"\n{extra}'
    (folder / "acquisition.toml").write_text(text)
    return folder / "acquisition.toml"


def test_frames_take_lens_time_and_pose_from_their_models(tmp_path):
    acquisition = load_acquisition(flown(tmp_path))
    for k, camera in enumerate(acquisition.cameras):
        assert isinstance(camera, FrameCamera)
        assert camera.t == pytest.approx(5.0 * k, abs=1e-7)
        pixels = np.array([[10.0, 20.0], [1000.0, 1200.0], [512.0, 640.0]])
        rays = camera.rays(pixels)
        for n, (line, column) in enumerate(pixels):
            origin, direction = reference.frame_ray(frame_isd(5.0 * k), line + 0.5, column + 0.5)
            assert np.linalg.norm(rays.origins[n] - origin) < 1e-3
            assert np.linalg.norm(rays.directions[n] - direction) * 2700.0 < 2e-3
    assert acquisition.surface.a == 1737400.0


def test_what_the_model_brings_is_not_given_beside_it(tmp_path):
    with pytest.raises(FormatError, match="time is given, but model brings it"):
        load_acquisition(flown(tmp_path, extra="time = 1.0\n"))


def test_frames_of_two_cameras_are_refused(tmp_path):
    toml = flown(tmp_path)
    write(tmp_path, "1.json", later=5.0, focal_length_model={"focal_length": 80.0})
    with pytest.raises(FormatError, match=r"number 2: 1\.json is of another camera than 0\.json"):
        load_acquisition(toml)


def test_a_frame_without_a_time_is_refused(tmp_path):
    np.save(tmp_path / "0.npy", noise(0, (64, 64)))
    (tmp_path / "acquisition.toml").write_text(
        '[platform]\nkind = "level-flight"\naltitude = 1e3\nground_speed = 10.0\n'
        '[camera]\nfocal_length_px = 100.0\n[[frame]]\nimage = "0.npy"\n'
        'time = 0.0\n[[frame]]\nimage = "1.npy"\n'
    )
    with pytest.raises(FormatError, match=r"\[\[frame\]\] number 2: time is missing"):
        load_acquisition(tmp_path / "acquisition.toml")
