"""Coarse shifts of whole frames, what stands still in them, and the mount they ask for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from tests.motion import pinholes

from sightline.errors import EstimationError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.frames.start import (
    CoarseShift,
    coarse_frames,
    coarse_shifts,
    standing_still,
    turn_about_axis,
    turned_mount,
)

SIZE = (240, 300)


def frames(count: int, step: tuple[int, int], dust: bool = False) -> list[ArrayImage]:
    """Cut-outs of one random texture: what is at p in one frame is at p + step in the next."""
    rng = np.random.default_rng(4)
    reach = (abs(step[0]) * count, abs(step[1]) * count)
    ground = gaussian_filter(rng.normal(size=(SIZE[0] + 2 * reach[0], SIZE[1] + 2 * reach[1])), 2.0)
    out = []
    for k in range(count):
        line, column = reach[0] - k * step[0], reach[1] - k * step[1]
        pixels = 100.0 + 200.0 * ground[line : line + SIZE[0], column : column + SIZE[1]]
        if dust:
            pixels[100:108, 40:48] = 0.0
        out.append(ArrayImage(pixels.astype(np.float32)))
    return out


def test_the_shift_of_neighbours_is_found_without_any_camera():
    for shift in coarse_shifts(frames(3, (37, -12))):
        assert np.abs(shift.shift_px - [37, -12]).max() <= shift.sigma_px


def test_contrast_is_evened_out_down_to_a_fifth_of_the_usual_one():
    # noise of 100 over three quarters of a frame and of 30, 15 or 5 over the last; contrast of 1 is wanted
    rng = np.random.default_rng(4)
    noise = rng.normal(size=SIZE)
    for weak, wanted in ((30.0, 1.0), (15.0, 15.0 / 20.0), (5.0, 5.0 / 20.0)):
        pixels = 1000.0 + np.where(np.arange(SIZE[1]) < 225, 100.0, weak) * noise
        flat, factor = coarse_frames([ArrayImage(pixels.astype(np.float32))])
        assert factor == 1 and flat.shape == (1, *SIZE)
        # over 13 x 13 px contrast is known to 6 %, and the usual one is the median of all
        assert flat[0, :, :210].std() == pytest.approx(1.0, rel=0.06)
        assert flat[0, :, 240:].std() == pytest.approx(wanted, rel=0.06)
        assert np.abs(flat).max() <= 3.0


def test_dust_that_stands_still_does_not_pretend_that_the_ground_does():
    images = frames(10, (40, 4), dust=True)
    for shift in coarse_shifts(images):
        assert np.abs(shift.shift_px - [40, 4]).max() <= shift.sigma_px
    still = standing_still(images)
    assert still is not None
    assert still[101:107, 41:47].all()
    assert still.mean() < 0.05


def test_four_frames_are_too_few_to_tell_what_stands_still():
    assert standing_still(frames(4, (40, 4), dust=True)) is None


def test_frames_of_unrelated_ground_are_refused():
    rng = np.random.default_rng(1)
    images = [ArrayImage(rng.normal(size=SIZE).astype(np.float32)) for _ in range(2)]
    with pytest.raises(EstimationError, match="check the order of the frames and that neighbours overlap"):
        coarse_shifts(images)


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, -100.0])
def test_a_mount_turned_about_the_axis_is_recovered_from_the_way_the_ground_moves(degrees):
    true = pinholes.cameras(2)
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)])
    turned = [FrameCamera(c.detector, c.trajectory, FixedMount(NADIR_MOUNT * turn), c.t) for c in true]
    # flying forward, lines forward: the ground moves back by f B / H lines
    back = pinholes.FOCAL * pinholes.SPEED * pinholes.INTERVAL / pinholes.ALTITUDE
    shift = CoarseShift(0, 1, np.array([-back, 0.0]), 1.0, 99.0)
    angle, scale = turn_about_axis([shift], turned, Plane())
    assert scale == pytest.approx(1.0, abs=1e-6)
    found = turned_mount(turned[0].pointing, angle).body_from_camera
    assert (found * NADIR_MOUNT.inv()).magnitude() < 1e-6
