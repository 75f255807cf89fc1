"""`orient` and `orient_pushbroom`: methods side by side, what they refuse, what they warn of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from tests.photogrammetry.stereo_scene import ARCSEC, TRUTH, Noise, Plan, ground, our_angles, shoot

from consistency import assert_consistent, assert_possible
from sightline.applications.stereo_orientation import METHODS, orient, orient_pushbroom
from sightline.errors import EstimationError, InputError, SightlineError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.instrument import AreaDetector, LineDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.geometry.trajectory import Trajectory
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.sightings import Images, Tracks
from sightline.simulate.stereo import stereo_case

PLAN = Plan(shots=16)


def problem(seed=0, *, relief=200.0, noise=None, **given):
    rng = np.random.default_rng(seed)
    points = ground(rng, 80, 11e3, relief, "smooth")
    shooting = shoot(PLAN, noise or Noise(), points, rng)
    middle, f = (PLAN.width - 1) / 2.0, 1.0 / PLAN.pixel
    pixels = np.stack([middle + f * shooting.m[..., 0], middle - f * shooting.m[..., 1]], axis=-1)
    k, n = shooting.m.shape[1:3]
    shot = np.tile(np.arange(k), 2)
    images = Images(
        np.repeat([0, 1], k), shot, shot * 4.0, shooting.d.reshape(-1, 3),
        Rotation.from_matrix(np.swapaxes(shooting.r, -1, -2).reshape(-1, 3, 3)),
    )  # fmt: skip
    tracks = Tracks(
        np.repeat(np.arange(2 * k), n), np.tile(np.arange(n), 2 * k), pixels.reshape(-1, 2), np.array(0.1)
    )
    detector = AreaDetector("frame", (PLAN.width, PLAN.width), f, (middle, middle))
    fields = {
        "cameras": ("1", "2"), "images": images, "shot_names": np.arange(k), "detectors": (detector,) * 2,
        "mounts": (NADIR_MOUNT,) * 2, "tracks": tracks, "point_names": np.arange(n),
        "noise": PoseNoise(7.5, 1.8 * ARCSEC), "radii": None,
    }  # fmt: skip
    return StereoProblem(**(fields | given)), points


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_angles_within_its_own_sigmas(method):
    given, _ = problem(0)
    found = orient(given, method)
    error = (found.angles - our_angles(TRUTH)).ravel()
    # chi-square of 6 at 1e-4; the plane's covariance is mostly relief's, alike in both yaws
    assert error @ np.linalg.solve(found.covariance, error) < 27.9
    assert np.abs(error / found.sigma.ravel()).max() < 4.0
    assert found.sigma[0, 0] < 10.0 * ARCSEC


def test_better_methods_have_smaller_sigmas():
    given, _ = problem(1)
    sigma = {method: orient(given, method).sigma[0] for method in METHODS}
    assert (sigma["ml-track"] < sigma["ml-pair"]).all()
    assert (sigma["ml-pair"] <= 1.02 * sigma["epipolar"]).all()  # it weights what the other does not
    assert sigma["plane"][2] > sigma["epipolar"][2]  # relief spoils the plane's yaw


def test_points_come_with_the_angles_by_every_method():
    given, points = problem(2)
    for method in METHODS:
        found = orient(given, method)
        height = found.points[:, 2] - points[:, 2]
        sigma = np.sqrt(found.point_covariance[:, 2, 2])
        assert np.isfinite(height).all()
        # all heights share the error of pitch: one draw
        assert_possible(np.mean((height / sigma) ** 2), 1)


@pytest.mark.parametrize("method", ["epipolar", "plane"])
def test_linear_methods_refuse_what_they_do_not_know(method):
    given, _ = problem(3)
    with pytest.raises(InputError, match="cannot estimate a drift"):
        orient(given, method, drift=True)
    with pytest.raises(InputError, match="cannot estimate the focal length"):
        orient(replace(given, focal_sigma=(0.01, 0.01)), method)


def test_an_unknown_method_is_refused_with_those_there_are():
    given, _ = problem(3)
    with pytest.raises(InputError, match="allowed are ml-track, ml-pair, epipolar, plane"):
        orient(given, "bundle")
    with pytest.raises(InputError, match="`raw` is for the method epipolar only"):
        orient(given, "ml-pair", raw=True)


def test_ml_pair_needs_pairs():
    given, _ = problem(4)
    alone = replace(given.images, camera=np.zeros(32), shot=np.arange(32))
    one = replace(given, cameras=("1",), images=alone, detectors=given.detectors[:1], mounts=given.mounts[:1])
    with pytest.raises(InputError, match="no shot has them: use ml-track"):
        orient(one, "ml-pair")


def test_sigmas_that_do_not_fit_the_residuals_are_spoken_of():
    given, _ = problem(5, noise=Noise(image=0.3))
    said = orient(given).warnings
    assert len(said) == 1 and "residuals are" in said[0] and "times what sigma_px" in said[0]
    assert orient(problem(5)[0]).warnings == ()


def test_a_focal_length_that_is_not_observable_is_flagged():
    # 1.5 degrees of field over level ground: what both cameras stretch alike is the size of the ground
    given, _ = problem(6, relief=0.0)
    found = orient(replace(given, focal_sigma=(1e-3, 1e-3)))
    assert found.stretch_sigma.shape == (2,)
    assert sum("not observable" in text for text in found.warnings) == 2
    points = ControlPoints(np.arange(10), problem(6, relief=0.0)[1][:10], np.array(0.1))
    tied = orient(replace(given, focal_sigma=(1e-3, 1e-3), control=points))
    assert not any("not observable" in text for text in tied.warnings)
    assert (tied.stretch_sigma < 0.5 * found.stretch_sigma).all()


def test_wrong_control_points_are_weighed_down_and_named():
    given, points = problem(6)
    rng = np.random.default_rng(6)
    place = points[:12] + rng.standard_normal((12, 3))
    good = orient(replace(given, control=ControlPoints(np.arange(12), place, np.array(1.0))))
    assert good.warnings == ()
    wrong = place.copy()
    wrong[:4] += rng.choice([-1.0, 1.0], (4, 3)) * 30.0
    found = orient(replace(given, control=ControlPoints(np.arange(12), wrong, np.array(1.0))))
    assert len(found.warnings) == 4
    assert all(f"control point {k} at (" in said for k, said in enumerate(found.warnings))
    # a third of them less: the angles differ by chance of what these gave, sqrt(1.5 - 1) of a sigma
    assert (np.abs(found.angles - good.angles) < 3.0 * np.sqrt(0.5) * good.sigma).all()
    # of two halves that contradict each other nothing shows which is right
    wrong[:8] = place[:8] + rng.uniform(-300.0, 300.0, (8, 3))
    with pytest.raises(EstimationError, match=r"of 12 control points do not go with the others"):
        orient(replace(given, control=ControlPoints(np.arange(12), wrong, np.array(1.0))))


def test_ml_pair_says_that_it_counts_known_heights_again_in_every_shot():
    given, _ = problem(7, relief=0.0)
    known = replace(given, heights=HeightPrior(Plane(0.0), 10.0, None))
    assert any("takes a point of every shot as new" in text for text in orient(known, "ml-pair").warnings)


def test_a_drift_comes_in_rad_per_second():
    given, _ = problem(8)
    found = orient(given, drift=True)
    assert found.drift.shape == found.drift_sigma.shape == (2, 3)
    # there is none
    assert (np.abs(found.drift) < 4.0 * found.drift_sigma).all()


# ---------------------------------------------------------------- pushbroom
HEIGHT, SPEED, IFOV, PERIOD = 600e3, 7000.0, 1e-5, 8e-4
LINES, COLUMNS = 4000, 2000


def pushbroom(look, start, first):
    """A strip over a flat world in level flight north, looking ahead by `look` rad, over the same ground."""
    detector = LineDetector.from_ifov("line", COLUMNS, IFOV, PERIOD, look_ahead=look)
    flight = Trajectory.level_flight(HEIGHT, SPEED, start - 2.0, start + LINES * PERIOD + 2.0)
    return PushbroomCamera(detector, flight, FixedMount(), first, LINES)


def sighted(point, look, start, angles):
    """(line, column) at which a camera turned by `angles` about its body axes sees a point, by bisection."""
    turn = Rotation.from_rotvec(angles).inv()

    def body(line):
        t = start + PERIOD * line
        x, y, z = point - np.array([0.0, SPEED * t, HEIGHT])
        return turn.apply([y, x, -z])  # forward, right, down

    def miss(line):
        forward, _, down = body(line)
        return forward / down - np.tan(look)

    line = brentq(miss, -2000.0, LINES + 2000.0, xtol=1e-9)
    _, right, down = body(line)
    return line, (COLUMNS - 1) / 2.0 - right / down / IFOV  # columns run to the left


def test_pushbroom_strips_give_the_constant_error_of_each_camera():
    looks = (0.35, 0.0, -0.35)
    truth = 1e-4 * np.array([[1.0, -1.0, 2.0], [-0.5, 1.0, 1.0], [0.5, 0.7, -1.5]])
    starts = [-HEIGHT * np.tan(look) / SPEED - LINES * PERIOD / 2.0 for look in looks]
    rng = np.random.default_rng(0)
    points = np.column_stack([
        rng.uniform(-4e3, 4e3, 200), rng.uniform(-8e3, 8e3, 200), rng.uniform(-300.0, 300.0, 200)
    ])  # fmt: skip
    pixels = np.array([
        [sighted(point, look, start, angles) for point in points]
        for look, start, angles in zip(looks, starts, truth, strict=True)
    ])  # fmt: skip
    cameras = [pushbroom(look, start, start) for look, start in zip(looks, starts, strict=True)]
    image, point = np.repeat([0, 1, 2], 200), np.tile(np.arange(200), 3)
    noise = PoseNoise(0.0, 0.0)
    tracks = Tracks(image, point, pixels.reshape(-1, 2), np.array(0.1))
    exact = orient_pushbroom(cameras, tracks, noise)
    # three strips tie the differences of the angles; a turn of all about a common axis moves the ground along
    seen = ~exact.observability.hidden
    assert seen.sum() >= 3
    control = ControlPoints(np.arange(6), points[:6], np.array(0.5))
    tied = orient_pushbroom(cameras, tracks, noise, priors=PointPriors(None, control))
    # windows of rays: the pose of the measured line is used as it is, so only rounding is left
    assert np.abs(tied.angles - truth).max() < 1e-9
    noisy = Tracks(image, point, pixels.reshape(-1, 2) + 0.1 * rng.standard_normal((600, 2)), np.array(0.1))
    found = orient_pushbroom(cameras, noisy, noise, priors=PointPriors(None, control))
    error = (found.angles - truth).ravel()
    assert error @ np.linalg.solve(found.covariance, error) < 27.9  # chi-square of 9 at 1e-3
    assert found.cameras == ("1", "2", "3")


@pytest.mark.parametrize("method", ["ml-track", "ml-pair", "epipolar"])
def test_of_one_shot_no_angle_is_given_that_a_hidden_direction_touches(method):
    scenario = stereo_case("A_paper_T6_K64", 0, shots=1)
    found = orient(StereoProblem(**scenario.problem()), method)
    touched = found.observability.touched
    assert touched.any()
    np.testing.assert_array_equal(np.isnan(found.angles.ravel()), touched)
    np.testing.assert_array_equal(np.isinf(found.sigma.ravel()), touched)


# ---------------------------------------------------------------- what is easily got wrong
def with_mismatches(given, seed, share):
    """The problem with a share of the second camera's pixels off by 2 to 50 px."""
    rng = np.random.default_rng(seed)
    pixels = np.array(given.tracks.pixels)
    bad = (rng.random(len(pixels)) < share) & (given.images.camera[given.tracks.image] == 1)
    turn, far = rng.uniform(0.0, 2.0 * np.pi, bad.sum()), rng.uniform(2.0, 50.0, bad.sum())
    pixels[bad] += far[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    tracks = Tracks(given.tracks.image, given.tracks.point, pixels, given.tracks.sigma_px)
    return replace(given, tracks=tracks), bad


@pytest.mark.parametrize("method", ["ml-track", "ml-pair"])
def test_mismatches_in_a_small_block_do_no_harm(method):
    nees, lost = [], []
    for seed in range(50):
        given, bad = with_mismatches(problem(seed)[0], 100 + seed, 0.05)
        found = orient(given, method)
        error = (found.angles - our_angles(TRUTH)).ravel()
        nees.append(error @ np.linalg.solve(found.covariance, error))
        half = len(bad) // 2
        wrong = bad[half:]  # a pair loses both its sightings
        lost.append((found.rejected[half:] & ~wrong).mean())
    assert np.mean(lost) < 2e-3
    assert_consistent(nees, 6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(3))
def test_one_shot_hides_the_turn_about_the_baseline_by_every_method(method, seed):
    given, _ = problem(seed)
    first = given.tracks.image % 16 == 0
    images = Images(
        np.array([0, 1]), np.array([0, 0]), given.images.t[[0, 16]], given.images.position[[0, 16]],
        given.images.world_from_body[[0, 16]],
    )  # fmt: skip
    tracks = given.tracks[first]
    one = replace(
        given,
        images=images,
        shot_names=np.arange(1),
        tracks=Tracks(tracks.image // 16, tracks.point, tracks.pixels, tracks.sigma_px),
    )
    found = orient(one, method)
    assert found.observability.hidden.any()
    assert np.isnan(found.angles[:, [0, 2]]).all()  # roll and yaw take part in it
    if method.startswith("ml"):
        assert found.observability.hidden.sum() == 1


def test_epipolar_takes_out_the_bias_of_the_noise_that_there_is():
    # noise is declared, and there is none: taking the declared out would leave 10 arcsec of pitch
    given, _ = problem(10, noise=Noise(0.0, 0.0, 0.0))
    found = orient(given, "epipolar")
    assert np.abs(found.angles - our_angles(TRUTH)).max() < 0.1 * ARCSEC
    assert any("measured scatter" in text for text in found.warnings)
    assert orient(problem(10)[0], "epipolar").warnings == ()


def test_raw_epipolar_says_that_its_bias_is_left_in():
    found = orient(problem(11)[0], "epipolar", raw=True)
    assert any("bias of noise times noise" in text for text in found.warnings)


@pytest.mark.parametrize("method", ["epipolar", "plane"])
def test_linear_methods_give_no_angles_beyond_what_is_linear(method):
    given, _ = problem(12)
    swapped = Tracks(
        given.tracks.image, given.tracks.point, np.array(given.tracks.pixels)[:, ::-1], given.tracks.sigma_px
    )
    try:
        found = orient(replace(given, tracks=swapped), method)
    except SightlineError:
        return
    assert np.isnan(found.angles).all() and found.warnings


def test_pose_noise_that_is_larger_than_declared_is_spoken_of():
    given, _ = problem(13, noise=Noise(0.1, 22.5, 5.4 * ARCSEC))
    said = orient(given).warnings
    assert any("times what sigma_position and sigma_attitude say" in text for text in said)


@pytest.mark.parametrize("method", ["ml-track", "ml-pair"])
def test_points_and_poses_of_a_result_belong_together(method):
    given, _ = problem(14, noise=Noise(0.01))
    given = replace(
        given, tracks=Tracks(*(getattr(given.tracks, k) for k in ("image", "point", "pixels")), 0.01)
    )
    found = orient(given, method)
    turn = found.angles[given.images.camera] + found.attitude
    world_from_body = given.images.world_from_body * Rotation.from_rotvec(turn)
    place = given.images.position + found.position
    image, point = given.tracks.image, given.tracks.point
    body = world_from_body[image].inv().apply(found.points[point] - place[image])
    middle, f = (PLAN.width - 1) / 2.0, 1.0 / PLAN.pixel
    seen = middle + f * np.column_stack([body[:, 0] / body[:, 2], -body[:, 1] / body[:, 2]])
    miss = np.sqrt(np.mean((given.tracks.pixels - seen) ** 2))
    # tracked points fit as stated; a pair's own poses differ from shot to shot in what pairs cannot see
    assert miss < (0.011 if method == "ml-track" else 1.0)
