"""Frames of a matrix instrument end to end, on rendered photographs whose truth is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from consistency import assert_possible
from sightline.applications.frame_attitude import mount_by_motion, recover_frame_attitude
from sightline.errors import EstimationError, InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Frame, LensKnowledge
from sightline.motion.frames.hidden import relative_covariance, without
from sightline.motion.frames.passes import FrameOptions
from sightline.simulate.frames import FrameScenario, frames_case
from sightline.stages import Stages

OPTIONS = FrameOptions(windows=90, passes=2)
SMALL = {"frames": 5, "shape": (224, 256), "interval": 3.0, "focal_length_px": 1000.0, "distortion": ()}


def as_frames(scene: FrameScenario, detector: AreaDetector | None = None) -> list[Frame]:
    """What a user has: photographs, times as written, nominal cameras without motion."""
    return [
        Frame(
            f"f{k}",
            ArrayImage(scene.image(k).astype(np.float32)),
            FrameCamera(detector or scene.detector, scene.reference, FixedMount(), float(t)),
            scene.options.time_sigma,
        )
        for k, t in enumerate(scene.nominal_times)
    ]


def normalised_square(result, scene) -> tuple[float, int]:
    """Error of the attitudes less the hidden part against its covariance, and its degrees of freedom."""
    n = len(result.motion.t)
    scale = np.tile(result.scale, n)
    error = without(result.motion.angles - scene.truth[:, 1:], result.hidden, result.scale).ravel() / scale
    covariance = relative_covariance(result.estimate.angle_covariance, result.hidden, result.scale)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    seen = values > 1e-9 * values.max()
    return float(((vectors.T @ error)[seen] ** 2 / values[seen]).sum()), int(seen.sum())


@pytest.fixture(scope="module")
def known():
    """Two scenes with a known camera, and what was recovered of them."""
    out = []
    for seed in (0, 1):
        scene = frames_case(seed, **SMALL)
        out.append((scene, recover_frame_attitude(as_frames(scene), Plane(), options=OPTIONS)))
    return out


def test_relative_attitudes_lie_within_their_sigma_of_the_truth(known):
    squares = [normalised_square(result, scene) for scene, result in known]
    low, high = chi2.ppf([1e-3, 1 - 1e-3], sum(number for _, number in squares))
    assert low < sum(square for square, _ in squares) < high
    # a hundred windows of 0.01 px each and the floor of the matcher, 0.0012 px per frame: three thousandths
    # are allowed
    for _, result in known:
        assert (np.sqrt((result.sigma**2).mean(axis=0)) / result.scale < 3e-3).all()


def test_matches_of_passes_that_were_kept_give_the_same_bits(known, tmp_path):
    scene, undisturbed = known[0]
    kept = Stages(tmp_path)
    whole = recover_frame_attitude(as_frames(scene), Plane(), options=OPTIONS, stages=kept)
    assert kept.computed == [f"matches-{k}" for k in range(len(kept.computed))] and len(kept.computed) > 2
    # as if the run had been stopped in its second pass
    for name in kept.computed[2:]:
        kept.drop(name)
    again = Stages(tmp_path)
    resumed = recover_frame_attitude(as_frames(scene), Plane(), options=OPTIONS, stages=again)
    assert again.found == kept.computed[:2] and again.computed == kept.computed[2:]
    for result in (whole, resumed):
        assert np.array_equal(result.motion.angles, undisturbed.motion.angles)
        assert np.array_equal(result.absolute_sigma, undisturbed.absolute_sigma)
        for a, b in zip(result.after_px, undisturbed.after_px, strict=True):
            assert np.array_equal(a, b, equal_nan=True)


def test_the_result_has_what_the_report_and_the_files_need(known):
    scene, result = known[0]
    assert result.hidden_names[:3] == ("constant of roll", "constant of pitch", "constant of yaw")
    assert result.observed.all()
    np.testing.assert_allclose(result.motion.t, scene.times)
    assert result.image_names == tuple(f"f{k}" for k in range(5))
    lag = [pair for pair in result.pairs if pair.images[1] - pair.images[0] == 1]
    assert all(pair.rms_after_px < 0.02 < pair.rms_before_px for pair in lag)
    assert result.changes[-1] < 1.0


def test_windows_beyond_a_frame_are_not_counted_as_masked(known):
    for _, result in known:
        # nothing is masked in these scenes; frames four apart share no ground at all
        assert all("masked" not in pair.rejected for pair in result.pairs)
        apart = next(pair for pair in result.pairs if pair.images == (0, 4))
        assert (apart.tried, apart.kept) == (0, 0)


def test_an_unknown_focal_length_is_found_from_the_frames():
    scene = frames_case(2, **{**SMALL, "focal_length_px": 500.0, "interval": 5.0})
    guess = replace(scene.detector, focal_length_px=700.0)
    lens = LensKnowledge(300.0)
    result = recover_frame_attitude(as_frames(scene, guess), Plane(), lens=lens, options=OPTIONS)
    (focal,) = (static for static in result.statics if static.name == "focal length")
    assert focal.sigma < 2.0
    assert abs(700.0 + focal.value - 500.0) < 4.0 * focal.sigma
    square, number = normalised_square(result, scene)
    assert_possible(square, number)


def test_wrong_times_are_part_of_the_sigma():
    scene = frames_case(3, **SMALL, time_sigma=2e-3)
    result = recover_frame_attitude(as_frames(scene), Plane(), options=OPTIONS)
    # 2 ms at 7200 m/s seen from 420 km are 0.034 px of pitch, which the times imitate
    sigma = np.sqrt((result.sigma**2).mean(axis=0)) / result.scale
    assert 0.01 < sigma[1] < 0.06
    assert sigma[0] < 0.01
    square, number = normalised_square(result, scene)
    assert_possible(square, number)


def test_a_camera_mounted_the_other_way_round_is_an_error_that_says_the_mount():
    scene = frames_case(0, **SMALL)
    turned = FixedMount(FixedMount().body_from_camera * Rotation.from_rotvec([0.0, 0.0, np.pi]))
    frames = [replace(f, camera=replace(f.camera, pointing=turned)) for f in as_frames(scene)]
    with pytest.raises(EstimationError, match=r"1(79|80) degrees away .* body_from_camera = \["):
        recover_frame_attitude(frames, Plane(), options=OPTIONS)
    found = mount_by_motion(frames, Plane()).body_from_camera
    assert (found * FixedMount().body_from_camera.inv()).magnitude() < 0.1


def test_a_known_focal_length_that_is_far_off_is_an_error():
    scene = frames_case(0, **SMALL)
    frames = as_frames(scene, replace(scene.detector, focal_length_px=3000.0))
    with pytest.raises(EstimationError, match='set focal_length_px = "estimate"'):
        recover_frame_attitude(frames, Plane(), options=OPTIONS)


def test_bad_frames_are_refused_before_any_work():
    scene = frames_case(0, **SMALL)
    frames = as_frames(scene)
    with pytest.raises(InputError, match="one frame cannot show motion"):
        recover_frame_attitude(frames[:1], Plane())
    with pytest.raises(InputError, match="sort them"):
        recover_frame_attitude(frames[::-1], Plane())
    with pytest.raises(InputError, match="`height_sigma` must be 0 or more"):
        recover_frame_attitude(frames, Plane(), height_sigma=-1.0)
    small = replace(frames[1], image=ArrayImage(np.zeros((10, 12))))
    with pytest.raises(InputError, match="give the camera the size of its image"):
        recover_frame_attitude([frames[0], small], Plane())


def test_the_command_recovers_frames_and_writes_one_row_per_frame(tmp_path):
    from sightline.cli.main import run
    from sightline.simulate.files import write_frames

    scene, result = tmp_path / "scene", tmp_path / "result"
    scene.mkdir()
    write_frames(frames_case(1, **SMALL), scene)
    with (scene / "acquisition.toml").open("a") as toml:
        toml.write("\n[matching]\npasses = 2\n")
    assert run(["recover", str(scene / "acquisition.toml"), "--out", str(result)]) == 0
    rows = (result / "motion.csv").read_text().splitlines()
    assert rows[0].startswith("t,roll,pitch,yaw,sigma_roll") and len(rows) == 6
    summary = json.loads((result / "summary.json").read_text())
    assert summary["residual_rms_px"] < 0.05
    squares = [pair["kept"] * pair["rms_after_px"] ** 2 for pair in summary["pairs"] if pair["kept"]]
    square = sum(squares) / summary["matches"]["kept"]
    np.testing.assert_allclose(summary["residual_rms_px"] ** 2, square, rtol=1e-12)
    assert (result / "report.html").stat().st_size > 100_000
