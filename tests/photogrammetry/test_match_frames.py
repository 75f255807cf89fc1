"""Points found in rendered frames: where they truly are, as well as stated, by poses that are wrong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.applications.stereo_orientation import orient
from sightline.errors import EstimationError, InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.geometry.trajectory import Trajectory
from sightline.imaging.source import ArrayImage, MaskedImage
from sightline.photogrammetry.frame_cameras import frame_cameras
from sightline.photogrammetry.match_frames import TrackPlan, choose_hubs, match_frames, shared_views
from sightline.photogrammetry.pair.match_problem import match_problem
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.simulate.stereo import stereo_case
from sightline.simulate.stereo_images import Sensor, render_frame, render_frames, textured

FRAME, SHOTS = 240, 2
FOV = 2.0 * np.arctan(FRAME / 700 * np.tan(np.radians(0.75)))


class Pass:
    """Four frames of two cameras 35 degrees apart over 400 m of relief, rendered."""

    def __init__(self) -> None:
        self.scenario = stereo_case(
            "A_paper_T6_K64", 5, separation=46.0, shots=SHOTS, window=10.0, columns=FRAME, fov=FOV, points=20,
            scene_size=3e3, ground_size=24e3,
        )  # fmt: skip
        scenario = self.scenario
        self.true = frame_cameras(scenario.true_images, scenario.detectors, scenario.mounts)
        self.planned = frame_cameras(scenario.images, scenario.given_detectors, scenario.mounts)
        level = scenario.pair.aim_point, scenario.pair.world_from_local
        self.ground = textured(scenario.surface, *level, self.true, 5, 0.2)
        self.images = [ArrayImage(pixels) for pixels in render_frames(self.true, self.ground, Sensor(), 5)]
        self.problem = StereoProblem(**scenario.problem())
        self.level = Ellipsoid(*scenario.pair.radii)


@pytest.fixture(scope="module")
def flown() -> Pass:
    return Pass()


@pytest.fixture(scope="module")
def tracks(flown):
    return match_frames(flown.images, flown.planned, flown.level, TrackPlan(height_range=400.0))


def errors_of_pairs(flown, tracks):
    """Errors (N, 2) px of all but the hub's sightings about the hub's, and their stated sigma (N,)."""
    _, hub = np.unique(tracks.point, return_index=True)
    assert (tracks.image[hub] == tracks.image[hub[0]]).all()
    ground = flown.true[tracks.image[hub[0]]].locate(tracks.pixels[hub], flown.scenario.surface)
    error = np.full((len(tracks), 2), np.nan)
    for image, camera in enumerate(flown.true):
        rows = tracks.image == image
        error[rows] = tracks.pixels[rows] - camera.project(ground[tracks.point[rows]])
    others = np.setdiff1d(np.arange(len(tracks)), hub)
    sigma = np.hypot(tracks.sigma_px, tracks.sigma_px[hub][tracks.point])
    return error[others], sigma[others]


def test_points_lie_where_the_ground_is_seen_and_as_well_as_stated(flown, tracks):
    error, sigma = errors_of_pairs(flown, tracks)
    assert len(error) > 250  # of 121 windows in three other frames, less those whose rim leaves the frame
    white = error / sigma[:, None]
    # The hub's noise is in three matches each: 2 x 110 independent numbers and more, 5 % of chance. Relief
    # that windows of a pair do not follow widens the sigma of all its matches: too large, if so.
    assert 0.65 < np.sqrt((white**2).mean()) < 1.2
    assert np.abs(white).max() < 6.0
    assert np.sqrt((error**2).mean()) < 0.025  # S/N 80 over 21 x 21 px


def test_the_errors_of_a_point_in_two_frames_share_no_more_than_the_hub(flown, tracks):
    error, sigma = errors_of_pairs(flown, tracks)
    _, hub = np.unique(tracks.point, return_index=True)
    others = np.setdiff1d(np.arange(len(tracks)), hub)
    white = np.full((4, tracks.point.max() + 1, 2), np.nan)
    white[tracks.image[others], tracks.point[others]] = error / sigma[:, None]
    used = [row for row in range(4) if np.isfinite(white[row]).any()]
    shared = np.nanmean([white[a] * white[b] for a in used for b in used if a < b])
    # Half of each match's variance is the hub's, in units of a sigma that may be a third too large; three
    # pairs of images times 220 products of spread 1 about the hub's own chance (9 %): 0.07.
    assert 0.2 < shared < 0.7


def test_what_the_noise_does_not_show_is_added_to_the_variance_of_every_sighting(flown, tracks):
    more = match_frames(flown.images, flown.planned, flown.level, TrackPlan(height_range=400.0, floor_px=0.3))
    np.testing.assert_array_equal(more.pixels, tracks.pixels)
    np.testing.assert_allclose(more.sigma_px**2, tracks.sigma_px**2 + 0.09, rtol=1e-9)


def test_images_in_angles_out(flown):
    found = orient(match_problem(flown.problem, flown.images))
    whitened = (found.angles - flown.scenario.angles).ravel()
    assert found.rejected.mean() < 0.02
    # chi-square with six degrees of freedom: above 22.5 once in a thousand
    assert whitened @ np.linalg.solve(found.covariance, whitened) < 22.5


def level_camera(x: float, y: float, tilt: float = 0.0, height: float = 1000.0) -> FrameCamera:
    """Flying north (world x east, y north, z up), tilted forward by `tilt`; 101 x 201 px of 2 mrad."""
    north = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    turn = north * Rotation.from_rotvec([[0.0, tilt, 0.0]])
    flight = Trajectory(np.zeros(1), np.array([[x, y, height]]), np.zeros(1), turn)
    return FrameCamera(AreaDetector("frame", (101, 201), 500.0, (50.0, 100.0)), flight, FixedMount(), 0.0)


def test_a_frame_shares_the_part_that_the_other_sees_times_the_cosine_between_their_views():
    # 200 m forward and 400 m across from first to last of 5 x 5 probes, which lie 50 and 100 m apart
    cameras = [level_camera(0.0, 0.0), level_camera(90.0, 40.0), level_camera(0.0, 0.0, height=4000.0)]
    cameras += [level_camera(5000.0, 0.0), level_camera(0.0, 90.0, tilt=1.5)]
    shared = shared_views(cameras, Plane(0.0), 0.5)

    def views(x: float, y: float, height: float, probes: np.ndarray) -> np.ndarray:
        sight = np.column_stack([probes - [x, y], np.full(len(probes), -height)])
        return sight / np.linalg.norm(sight, axis=1, keepdims=True)

    across, forward = np.meshgrid(np.linspace(-200.0, 200.0, 5), np.linspace(-100.0, 100.0, 5))
    probes = np.column_stack([across.ravel(), forward.ravel()])
    seen = probes[(probes[:, 0] >= -110.0) & (probes[:, 1] >= -60.0)]
    assert len(seen) == 4 * 4
    cosine = (views(0.0, 0.0, 1000.0, seen) * views(90.0, 40.0, 1000.0, seen)).sum(axis=1).mean()
    assert shared[0, 1] == pytest.approx(16 / 25 * cosine, rel=1e-9)
    # all of it is seen from above, of which it shows one of 25 probes: too little
    cosine = (views(0.0, 0.0, 1000.0, probes) * views(0.0, 0.0, 4000.0, probes)).sum(axis=1).mean()
    assert shared[0, 2] == pytest.approx(cosine, rel=1e-9)
    assert shared[2, 0] == 0.0 < shared_views(cameras, Plane(0.0), 0.5, 1 / 25)[2, 0]
    # what lies elsewhere, and oneself
    assert not shared[3].any() and not shared[:, 3].any() and not np.diag(shared).any()


def test_a_frame_that_looks_past_the_horizon_shares_the_ground_that_it_sees():
    # from 1.5 rad off the vertical: four of five probed lines look 1.40 to 1.55 rad, one past the horizon; of
    # their five columns the one at the border is out of sight of the other, 50 m to the east
    tilted = [level_camera(0.0, 0.0, tilt=1.5), level_camera(50.0, 0.0, tilt=1.48)]
    assert shared_views(tilted, Plane(0.0), 0.5)[0, 1] == pytest.approx(16 / 25, rel=1e-3)


def test_a_masked_part_has_no_points(flown):
    cloud = np.zeros((FRAME, FRAME), dtype=bool)
    cloud[:, : FRAME // 2] = True
    images = [MaskedImage(image, cloud) for image in flown.images]
    seen = match_frames(images, flown.planned, flown.level, TrackPlan(height_range=400.0))
    assert (seen.pixels[:, 1] > FRAME // 2).all()


def test_frames_of_other_ground_give_no_points_but_an_error(flown):
    rng = np.random.default_rng(3)
    noise = [ArrayImage(rng.normal(1000.0, 50.0, (FRAME, FRAME))) for _ in flown.images]
    with pytest.raises(EstimationError, match="no point"):
        match_frames(noise, flown.planned, flown.level)


def test_bad_calls_say_what_is_wrong(flown):
    with pytest.raises(InputError, match="as many images"):
        match_frames(flown.images[:2], flown.planned, flown.level)
    with pytest.raises(InputError, match="pixels, its camera"):
        match_frames([ArrayImage(np.zeros((9, 9)))] * 4, flown.planned, flown.level)
    with pytest.raises(InputError, match="one image per pose"):
        match_problem(flown.problem, flown.images[:3])
    with pytest.raises(InputError, match="window"):
        TrackPlan(window=5)
    with pytest.raises(InputError, match="pointing_error"):
        TrackPlan(pointing_error=-1.0)


def test_hubs_are_as_few_as_see_all_that_is_shared():
    near = np.abs(np.subtract.outer(np.arange(7), np.arange(7)))
    shared = np.where((near > 0) & (near <= 2), 1.0 - 0.1 * near, 0.0)
    hubs = choose_hubs(shared)
    assert len(hubs) == 2
    assert all(shared[list(hubs), frame].any() or frame in hubs for frame in range(7))


def test_views_too_far_apart_are_not_shared(flown):
    apart = shared_views(flown.planned, flown.level, np.radians(20.0))
    all_of_them = shared_views(flown.planned, flown.level, np.radians(60.0))
    cameras = flown.scenario.images.camera
    assert (apart[cameras[:, None] != cameras] == 0.0).all()
    assert ((all_of_them > 0.0) == ~np.eye(len(cameras), dtype=bool)).all()


def test_the_blur_of_a_frame_is_that_asked_for(flown):
    # noise-free frames at two blurs: their spectra's ratio is the ratio of Gaussian transfer functions
    sharp, soft = (render_frame(flown.true[0], flown.ground, mtf) for mtf in (0.4, 0.1))
    taper = np.outer(*[np.hanning(FRAME)] * 2)
    power = [np.abs(np.fft.fft2((image - image.mean()) * taper)) ** 2 for image in (sharp, soft)]
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(FRAME), np.fft.fftfreq(FRAME)))
    ring = (f > 0.14) & (f < 0.16)
    measured = np.sqrt(power[1][ring].sum() / power[0][ring].sum())
    # the texture falls by half over the ring, the ratio of blurs by 3 %
    assert measured == pytest.approx(0.25 ** ((0.15 / 0.5) ** 2), rel=0.03)
