"""One picture of all exposures, against a sky known at every direction."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.spinning import SpinningCamera, Texture

from sightline.errors import InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Ellipsoid, Infinity
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Frame
from sightline.products import frame_mosaic as module
from sightline.products.frame_mosaic import GRID, BeforeSky, CloudLayer, _grid, frame_mosaic

FOCAL, LINES, COLUMNS, EXPOSURES, TURN = 400.0, 48, 90, 5, -0.08
AXIS_LINES = (70.0, 10.0)
DISTORTION = (-0.1,)


@pytest.fixture(scope="module")
def scene():
    """Two strips of five exposures of one sky, 32 px apart and 48 high, as a pinhole sees it."""
    axis = np.array([1.0, 0.0, 0.0])
    truth = SpinningCamera(FOCAL, 44.5, AXIS_LINES, axis, TURN, np.zeros((EXPOSURES, 3)), np.eye(3))
    sky = Texture(3, FOCAL, 80)
    spin = Spin(Rotation.identity(), axis, TURN / 0.4)
    trajectory = spin.trajectory((-1.0, 3.0), np.zeros((2, 3)), (-1.0, 3.0))
    line, column = np.meshgrid(np.arange(LINES), np.arange(COLUMNS), indexing="ij")
    frames = []
    for exposure in range(EXPOSURES):
        for strip in range(2):
            pixels = sky(truth.directions(exposure, strip, line, column)).astype(np.float32)
            detector = AreaDetector("camera", (LINES, COLUMNS), FOCAL, (AXIS_LINES[strip], 44.5))
            camera = FrameCamera(detector, trajectory, FixedMount(Rotation.identity()), 0.4 * exposure)
            frames.append(Frame(f"{exposure}-{strip}", ArrayImage(pixels), camera, 0.0, exposure, strip))
    return sky, frames


def seen_sky(sky, camera: FrameCamera) -> np.ndarray:
    """What the picture should hold."""
    line, column = np.meshgrid(*(np.arange(n) for n in camera.shape), indexing="ij")
    look = camera.rays(np.column_stack([line.ravel(), column.ravel()]).astype(float)).directions
    return sky(look).reshape(camera.shape)


def test_the_picture_is_the_sky_without_seams(scene):
    sky, frames = scene
    mosaic = frame_mosaic(frames, [frame.camera for frame in frames], Infinity(), names=("a", "b"))
    assert mosaic.names == ("a", "b") and mosaic.pixels.shape[1:] == mosaic.camera.shape
    expected = seen_sky(sky, mosaic.camera)
    for picture in mosaic.pixels:
        known = np.isfinite(picture)
        # five exposures, 32 px apart and 48 high, less what the kernel cannot reach
        assert known.sum() > 0.75 * (4 * 32 + 48) * COLUMNS
        # waves of 5 px and more pass the kernel to 2e-3 of their contrast of 1; linear steps of the map add
        # 3e-4 px
        assert np.abs(picture - expected)[known].max() < 0.02
        # no gap between exposures: every column is seen in one piece
        middle = np.flatnonzero(known[:, known.shape[1] // 2])
        assert np.all(np.diff(middle) == 1)


def test_a_wrong_camera_leaves_seams(scene):
    sky, frames = scene
    slow = Spin(Rotation.identity(), np.array([1.0, 0.0, 0.0]), 0.98 * TURN / 0.4)
    trajectory = slow.trajectory((-1.0, 3.0), np.zeros((2, 3)), (-1.0, 3.0))
    cameras = [frame.camera.with_trajectory(trajectory) for frame in frames]
    mosaic = frame_mosaic(frames, cameras, Infinity())
    expected = seen_sky(sky, mosaic.camera)
    assert np.nanmax(np.abs(mosaic.pixels[0] - expected)) > 0.2


def test_masked_pixels_are_left_out_unless_asked_for(scene):
    _, frames = scene
    mask = np.zeros((LINES, COLUMNS), bool)
    mask[:, 40:60] = True
    hidden = [
        Frame(f.name, ArrayImage(f.image.array, mask), f.camera, 0.0, f.exposure, f.strip) for f in frames
    ]
    cameras = [frame.camera for frame in frames]
    without, whole = (frame_mosaic(hidden, cameras, Infinity(), masked=m).pixels for m in (True, False))
    column = whole.shape[2] // 2
    assert np.isnan(without[:, :, column]).all() and np.isfinite(whole[:, :, column]).any()


def test_rays_that_pass_a_body_end_beside_it():
    body = BeforeSky(Ellipsoid(1e6, 1e6))
    origins = np.tile([0.0, 0.0, 5e6], (2, 1))
    down = np.array([[0.0, 0.0, -1.0], [0.0, 0.6, -0.8]])
    np.testing.assert_allclose(body.intersect(origins, down), [[0, 0, 1e6], [0, 2.4e6, 1.8e6]], atol=1e-3)
    assert body.raised(1e3).intersect(origins, down)[0, 2] == pytest.approx(1e6 + 1e3)


def test_a_layer_lies_above_its_body():
    layer = CloudLayer(Ellipsoid(1e6, 1e6), 2e4)
    there = layer.intersect(np.array([[5e6, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(there, [[1.02e6, 0.0, 0.0]])


def test_a_picture_that_is_too_large_is_refused(scene, monkeypatch):
    _, frames = scene
    monkeypatch.setattr(module, "MOST_PIXELS", 1000)
    with pytest.raises(InputError, match="more than 1000; give fewer exposures"):
        frame_mosaic(frames, [frame.camera for frame in frames], Infinity())


@pytest.mark.parametrize("shape", [(40, 12), (40, 90)])
def test_strips_fade_towards_their_first_and_last_lines(shape):
    weight = module._fade(shape)
    assert weight.shape == shape and np.array_equal(weight, weight[::-1])
    assert np.all(weight == weight[:, :1])
    assert weight[0, 0] == np.float32(0.01) and np.all(weight[9:31] == 1.0)
    assert np.all(np.diff(weight[3:9, 0]) > 0.1)


def test_a_strip_is_looked_at_evenly_from_corner_to_corner():
    camera = SimpleNamespace(shape=(31, 77))
    pixels = _grid(camera).reshape(GRID, GRID, 2)
    assert pixels[0, 0].tolist() == [0.0, 0.0] and pixels[-1, -1].tolist() == [30.0, 76.0]
    assert np.diff(pixels[..., 0], axis=0) == pytest.approx(30.0 / (GRID - 1))
    assert np.diff(pixels[..., 1], axis=1) == pytest.approx(76.0 / (GRID - 1))
