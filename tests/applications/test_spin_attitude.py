"""A spinning camera with filter strips end to end, on images rendered by a closed form of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.motion.spinning import SpinningCamera, Texture

from consistency import assert_possible
from sightline.applications.spin_attitude import SpinOptions, recover_spin_attitude
from sightline.errors import EstimationError, InputError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.spin import Spin
from sightline.geometry.surface import Infinity
from sightline.imaging.source import ArrayImage
from sightline.motion.band import ChipKnowledge, Frame, LensKnowledge
from sightline.motion.frames.hidden import without
from sightline.motion.spin.solve import AttitudeSigma
from sightline.stages import Stages

INTERVAL, EXPOSURES, LINES, COLUMNS, FOCAL = 0.4, 7, 72, 220, 600.0
TURN = -0.075  # rad per exposure: 45 px
NOMINAL = (90.0, 10.0, -70.0)  # strips 80 lines apart
OPTIONS = SpinOptions(window=(24, 44), passes=2)
NOISE = 0.02  # of a contrast of 1
NAMES = ("blue", "green", "red")
CHIP = ChipKnowledge(NAMES, 10.0, (0.1,) * 3, (0.0,) * 3, (0.0,) * 3)


def truth_of(seed: int) -> SpinningCamera:
    """Rate, axis and chip a little off, and a roll that swings: of another family than the white prior."""
    rng = np.random.default_rng(seed)
    k = np.arange(EXPOSURES)
    swing = 1e-4 * np.sin(2.0 * np.pi * k / 5.0 + rng.uniform(0.0, 6.0))
    departures = np.column_stack([swing, np.zeros(EXPOSURES), np.zeros(EXPOSURES)])
    lines = tuple(line + 3.0 + shift for line, shift in zip(NOMINAL, rng.normal(0.0, 0.05, 3), strict=True))
    axis = np.array([1.0, *rng.normal(0.0, 2e-3, 2)])
    return SpinningCamera(FOCAL, 110.0, lines, axis, TURN + 2e-4, departures, np.eye(3))


def frames_of(truth: SpinningCamera, seed: int, spin: Spin) -> list[Frame]:
    """Images of three bands that share most of their texture, with nominal cameras."""
    shared, rng = Texture(seed, FOCAL), np.random.default_rng(seed + 1000)
    own = [Texture(seed + 10 + strip, FOCAL, 60) for strip in range(3)]
    line, column = np.meshgrid(np.arange(LINES), np.arange(COLUMNS), indexing="ij")
    span = (-1.0, INTERVAL * EXPOSURES + 1.0)
    trajectory = spin.trajectory(span, np.zeros((2, 3)), span)
    out = []
    for exposure in range(EXPOSURES):
        for strip in range(3):
            look = truth.directions(exposure, strip, line, column)
            pixels = shared(look) + 0.15 * own[strip](look) + NOISE * rng.normal(size=look.shape[:2])
            detector = AreaDetector("camera", (LINES, COLUMNS), FOCAL, (NOMINAL[strip], 110.0))
            camera = FrameCamera(detector, trajectory, FixedMount(Rotation.identity()), INTERVAL * exposure)
            image = ArrayImage(pixels.astype(np.float32))
            out.append(Frame(f"{exposure} {NAMES[strip]}", image, camera, 0.0, exposure, strip))
    return out


def nominal_spin() -> Spin:
    return Spin(Rotation.identity(), np.array([1.0, 0.0, 0.0]), TURN / INTERVAL, 0.0, 0.01, 2e-3)


@pytest.fixture(scope="module")
def frames():
    """Rendered once for all tests of this file."""
    return frames_of(truth_of(0), 0, nominal_spin())


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    """Those of `case`, kept."""
    folder = tmp_path_factory.mktemp("stages")
    return folder, Stages(folder)


def recovered(frames, stages):
    return recover_spin_attitude(
        frames, Infinity(), nominal_spin(), lens=LensKnowledge(0.6, 0.0, 0.0), chip=CHIP,
        attitude_sigma=AttitudeSigma(0.0, 0.0), options=OPTIONS, stages=stages,
    )  # fmt: skip


@pytest.fixture(scope="module")
def case(frames, stages):
    """Truth, and what was recovered of it."""
    return truth_of(0), recovered(frames, stages[1])


def test_matches_of_passes_that_were_kept_give_the_same_bits(frames, case, stages):
    folder, kept = stages
    again = Stages(folder)
    resumed = recovered(frames, again)
    assert kept.computed and again.found == kept.computed and not again.computed
    assert np.array_equal(resumed.motion.angles, case[1].motion.angles)
    assert np.array_equal(resumed.absolute_sigma, case[1].absolute_sigma)


def test_rate_axis_and_chip_lie_within_their_sigma_of_the_truth(case):
    truth, result = case
    found = {static.name: static for static in result.statics}
    expected = {"spin rate": 2e-4 / INTERVAL, "focal length": 0.0, "axis line": 3.0}
    # 4 sigma: one in 16,000 for each of six numbers
    for name, value in expected.items():
        assert abs(found[name].value - value) < 4.0 * found[name].sigma, name
    axis = truth.axis / np.linalg.norm(truth.axis)
    across = result.spin.axis - axis
    assert np.linalg.norm(across) < 4.0 * np.linalg.norm(result.found.axis_sigma)
    # spacing of the outer strips: known to 0.14 px before, the images tell it much better
    names = list(result.estimate.unknowns.names)
    rows = [names.index("blue line"), names.index("red line")]
    difference = np.array([1.0, -1.0])
    sigma = np.sqrt(difference @ result.estimate.covariance[np.ix_(rows, rows)] @ difference)
    error = difference @ result.estimate.x[rows] - (truth.axis_lines[0] - truth.axis_lines[2] - 160.0)
    assert abs(error) < 4.0 * sigma
    assert sigma < 0.03
    # a swing of 7e-5 rad rms, taken for white, leaves the slope over 7 exposures 7e-5 sqrt(12 / 7^3) = 1.3e-5
    assert result.found.rate_sigma_images * INTERVAL < 2.5e-5


def test_the_motion_lies_within_its_sigma_of_the_truth(case):
    truth, result = case
    t = result.motion.t
    reference = [nominal_spin().at([at])[0] for at in t]
    actual = [Rotation.from_matrix(truth.world_from_body(k)) for k in range(EXPOSURES)]
    true = np.array([(r.inv() * a).as_rotvec() for r, a in zip(reference, actual, strict=True)])
    error = without(result.motion.angles - true, result.hidden, result.scale)
    square = ((error / np.maximum(result.sigma, 1e-12)) ** 2)[:, 0].sum()
    # roll is what moved; its hidden directions (constant, drift) take two of its seven numbers
    assert_possible(square, EXPOSURES - 2)
    assert np.sqrt((error[:, 0] ** 2).mean()) < 2e-5  # of a swing of 7e-5 rms; 0.012 px
    np.testing.assert_allclose(t, INTERVAL * np.arange(EXPOSURES))


def test_every_lag_is_used_and_pairs_agree(case):
    _, result = case
    seen = {(strip.hub, strip.partner, strip.lag) for strip in result.found.strips}
    # strips 80 lines apart, 45 px per exposure, 72 lines: itself after one (27 lines), the next after one
    # (35 lines earlier: 37 shared) and two (62 shared) and three (17), the one after that from two on
    assert {(2, 1, 1), (2, 1, 2), (2, 0, 3), (2, 0, 4), (1, 1, 1)} <= seen
    for strip in result.found.strips:
        if strip.kept > 40:
            assert abs(strip.mean_px[0]) < max(4.0 * strip.mean_sigma_px[0], 0.01)
    for closure in result.found.closures:
        assert np.all(np.abs(closure.value_px) < np.maximum(4.0 * np.array(closure.sigma_px), 0.02))


def test_rank_and_weakest_direction_are_said(case):
    _, result = case
    rank = result.found.rank
    # rate, two of the axis, focal length, axis line, three strips; the attitude is given exactly
    assert len(rank.names) == 8 and "attitude roll" not in rank.names
    assert 5 <= rank.rank < 8 and rank.weakest
    # a common shift of the strips is the axis line itself: the images alone say nothing of that direction
    assert rank.blind >= 1


def test_sigma_separates_rate_and_focal_length(case):
    _, result = case
    found = result.found
    whole = next(static.sigma for static in result.statics if static.name == "spin rate")
    parts = found.rate_sigma_images**2 + found.rate_sigma_camera**2 + found.rate_sigma_parallax**2
    assert whole**2 == pytest.approx(parts, rel=1e-6)
    # 0.6 px of 600: a thousandth of the rate, less what perspective tells
    assert 0.3e-3 < found.rate_sigma_camera / abs(found.rate) < 1.05e-3


def test_bad_frames_are_refused_before_any_work(frames):
    spin = nominal_spin()
    with pytest.raises(InputError, match="`parallax_sigma` must be 0 or more"):
        recover_spin_attitude(frames[:3], Infinity(), spin, parallax_sigma=np.nan)
    with pytest.raises(InputError, match="one exposure cannot show motion"):
        recover_spin_attitude(frames[:3], Infinity(), spin)
    with pytest.raises(InputError, match="numbered 0, 1, 2"):
        recover_spin_attitude(frames[3:], Infinity(), spin)
    late = [replace(f, camera=replace(f.camera, t=3.0 - f.camera.t)) for f in frames]
    with pytest.raises(InputError, match="sort them"):
        recover_spin_attitude(late, Infinity(), spin)
    small = [replace(frames[0], image=ArrayImage(np.zeros((10, 12)))), *frames[1:]]
    with pytest.raises(InputError, match="give the camera the size of its image"):
        recover_spin_attitude(small, Infinity(), spin)
    fast = replace(spin, rate=10.0 * spin.rate)
    trajectory = fast.trajectory((-1.0, 5.0), np.zeros((2, 3)), (-1.0, 5.0))
    swept = [replace(f, camera=f.camera.with_trajectory(trajectory)) for f in frames]
    with pytest.raises(EstimationError, match="no strip sees again"):
        recover_spin_attitude(swept, Infinity(), fast)
    blank = [replace(f, image=ArrayImage(np.zeros((LINES, COLUMNS), np.float32))) for f in frames]
    with pytest.raises(EstimationError, match="the strips do not match"):
        recover_spin_attitude(blank, Infinity(), spin, options=OPTIONS)
