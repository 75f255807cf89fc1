"""What a run is said to take, beside what runs took."""

from __future__ import annotations

import numpy as np
import pytest
from tests.motion import pinholes

from sightline.applications.expected_cost import BASE_BYTES, Cost, frames_cost, maps_cost
from sightline.errors import InputError
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Frame
from sightline.motion.frames.passes import FrameOptions


def flight(count: int) -> list[Frame]:
    image = ArrayImage(np.zeros(pinholes.SHAPE, dtype=np.float32))
    return [Frame(f"f{k}", image, camera) for k, camera in enumerate(pinholes.cameras(count))]


def test_windows_that_share_an_image_cost_by_the_square_and_are_held_in_blocks():
    wide, dense, denser = (
        frames_cost(flight(3), Plane(), FrameOptions(step=step), 0.0) for step in (32, 4, 2)
    )
    assert dense.seconds > 5 * wide.seconds and denser.seconds > 10 * dense.seconds
    assert denser.bytes - BASE_BYTES < 8 * (dense.bytes - BASE_BYTES)
    assert "windows each ([matching] step)" in dense.of


def test_unknown_heights_are_one_dense_solution_that_may_not_fit():
    known, unknown = (frames_cost(flight(3), Plane(), FrameOptions(step=4), sigma) for sigma in (0.0, 50.0))
    assert unknown.bytes > 2 * known.bytes and "height_sigma" in unknown.of
    with pytest.raises(InputError, match=r"of memory, .* may be used; give less"):
        frames_cost(flight(3), Plane(), FrameOptions(step=1), 50.0).check()


def test_frames_without_common_ground_cost_no_matches():
    apart = frames_cost(flight(40)[::39], Plane(), FrameOptions(step=2), 0.0)
    assert apart.seconds == 12.0


def test_maps_that_the_disk_has_no_room_for_are_said(tmp_path):
    maps = maps_cost(10, (100, 100), (200_000, 200_000), 20)
    assert maps.disk == 4.0 * 200_000**2 * 20
    flown = Cost(1.0, 1e8, "10 frames").then(maps)
    said = flown.lacks_room(tmp_path / "not" / "yet")
    assert said.startswith(f"{tmp_path / 'not' / 'yet'}: the files need 3.2 TB, ") and "gsd" in said
    assert maps_cost(10, (100, 100), (20, 20), 1).lacks_room(tmp_path) == ""
