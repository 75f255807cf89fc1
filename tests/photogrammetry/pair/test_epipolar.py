"""S2's epipolar estimate against scenes of known angles: signs, bias, covariance, what it cannot tell.

Monte-Carlo bounds: over n trials a mean has a standard error of sigma / sqrt(n), an rms of sigma / sqrt(2 n),
and the mean NEES of six angles one of sqrt(12 / n); three of them are allowed.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from consistency import assert_consistent
from photogrammetry.stereo_scene import (
    ARCSEC,
    QUIET,
    TRUTH,
    Noise,
    Plan,
    axes,
    ground,
    our_angles,
    shoot,
)
from sightline.errors import InputError
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.epipolar import (
    epipolar_outliers,
    epipolar_residuals,
    noise_ratios,
    orient_by_epipolar,
)
from sightline.photogrammetry.pair.pairs import SightingPairs, pair_sightings

SHORT = Plan(shots=16, window=64.0)
NONE = PoseNoise(0.0, 0.0)
PAPER = PoseNoise(7.5, 1.8 * ARCSEC)


def knowledge(noise: Noise) -> PoseNoise:
    return PoseNoise(noise.position, noise.attitude, np.zeros(3) if noise.aimed else None)


def pairs_of(plan: Plan, noise: Noise, seed: int, count: int = 100, truth=TRUTH) -> SightingPairs:
    rng = np.random.default_rng(seed)
    points = ground(rng, count, 11e3, 400.0, "smooth")
    return pair_sightings(shoot(plan, noise, points, rng, truth).sightings(max(noise.image, 1e-3)))


def trials(plan: Plan, noise: Noise, n: int, raw: bool, truth=TRUTH) -> tuple[np.ndarray, np.ndarray, list]:
    """Errors (n, 6) in arcsec, NEES (n,), and all estimates."""
    found = [
        orient_by_epipolar(pairs_of(plan, noise, seed, truth=truth), knowledge(noise), raw=raw)
        for seed in range(n)
    ]
    errors = np.array([(one.angles - our_angles(truth)).ravel() for one in found])
    nees = np.array([e @ one.information @ e for e, one in zip(errors, found, strict=True)])
    return errors / ARCSEC, nees, found


def test_without_noise_the_angles_come_back():
    pairs = pairs_of(SHORT, QUIET, 1)
    raw = orient_by_epipolar(pairs, NONE, raw=True)
    # one linearisation leaves the square of 36 arcsec, 0.006, some five times in yaw
    assert np.abs(raw.angles - our_angles(TRUTH)).max() < 0.1 * ARCSEC
    exact = orient_by_epipolar(pairs, NONE)
    assert np.abs(exact.angles - our_angles(TRUTH)).max() < 1e-3 * ARCSEC
    assert np.abs(exact.residual_px).max() < 1e-6


@pytest.mark.parametrize("which", range(6))
def test_each_angle_has_its_sign_and_place(which):
    truth = np.zeros(6)
    truth[which] = 100.0 * ARCSEC
    found = orient_by_epipolar(pairs_of(SHORT, QUIET, 2, truth=truth.reshape(2, 3)), NONE)
    # S2 turns the scene in camera axes, the package the body: the opposite sign
    assert np.abs(found.angles.ravel() + truth).max() < 1e-3 * ARCSEC


def test_large_angles_are_found_by_linearising_anew():
    truth = 100.0 * TRUTH  # one degree
    pairs = pairs_of(SHORT, QUIET, 3, truth=truth)
    assert np.abs(orient_by_epipolar(pairs, NONE).angles - our_angles(truth)).max() < 1e-2 * ARCSEC
    assert np.abs(orient_by_epipolar(pairs, NONE, raw=True).angles - our_angles(truth)).max() > 10.0 * ARCSEC


def test_cameras_named_the_other_way_swap_their_angles():
    rng = np.random.default_rng(4)
    sightings = shoot(SHORT, Noise(), ground(rng, 60, 11e3, 400.0, "smooth"), rng).sightings()
    one = orient_by_epipolar(pair_sightings(sightings), PAPER)
    two = orient_by_epipolar(pair_sightings(sightings, (1, 0)), PAPER)
    np.testing.assert_allclose(two.angles, one.angles[::-1], atol=1e-6 * ARCSEC)
    swapped = np.r_[3:6, 0:3]
    np.testing.assert_allclose(
        two.covariance[np.ix_(swapped, swapped)], one.covariance, rtol=1e-6, atol=1e-18
    )


def test_pairs_do_not_depend_on_the_order_of_sightings():
    rng = np.random.default_rng(5)
    shooting = shoot(SHORT, Noise(), ground(rng, 40, 11e3, 400.0, "smooth"), rng)
    count = 2 * 16 * 40
    straight = orient_by_epipolar(pair_sightings(shooting.sightings()), PAPER)
    mixed = orient_by_epipolar(pair_sightings(shooting.sightings(keep=rng.permutation(count))), PAPER)
    np.testing.assert_allclose(mixed.angles, straight.angles, atol=1e-6 * ARCSEC)


def test_points_seen_once_are_left_out_and_shots_may_have_unequal_numbers():
    rng = np.random.default_rng(6)
    shooting = shoot(SHORT, QUIET, ground(rng, 60, 11e3, 400.0, "smooth"), rng)
    keep = rng.random((2, 16, 60)) < 0.7
    keep[0, 3] = False  # the second camera alone
    keep[:, 7, 1:] = False  # one point
    pairs = pair_sightings(shooting.sightings(1e-3, keep.ravel()))
    assert len(pairs) == (keep[0] & keep[1]).sum()
    assert 3 not in pairs.sightings.shot[pairs.images[0]]
    assert np.abs(orient_by_epipolar(pairs, NONE).angles - our_angles(TRUTH)).max() < 1e-3 * ARCSEC


@pytest.mark.parametrize(("position", "bias"), [(3.75, -3.2), (7.5, -12.6), (15.0, -50.2)])
def test_position_noise_biases_the_pitch_of_least_squares(position, bias):
    # prototype: bias of S2's pitch of camera 1, mirrored in camera 2, by its own 30 trials
    plan, noise, n = Plan(), Noise(0.0, position, 0.0), 12
    errors, _, found = trials(plan, noise, n, raw=True, truth=np.zeros((2, 3)))
    sigma = np.sqrt(found[0].covariance[1, 1]) / ARCSEC
    # ours is S2's negative; both means are of few trials
    tolerance = 3.0 * sigma * np.sqrt(1.0 / n + 1.0 / 30.0)
    assert abs(errors[:, 1].mean() + bias) < tolerance
    assert abs(errors[:, 4].mean() - bias) < tolerance
    assert np.mean([one.bias[0, 1] for one in found]) / ARCSEC == pytest.approx(-bias, rel=0.15)
    better, _, _ = trials(plan, noise, n, raw=False, truth=np.zeros((2, 3)))
    assert (np.abs(better.mean(axis=0)) < 3.0 * better.std(axis=0) / np.sqrt(n - 1) + 1e-9).all()
    assert np.sqrt((better[:, [1, 4]] ** 2).mean()) < 0.4 * np.sqrt((errors[:, [1, 4]] ** 2).mean())


@pytest.mark.parametrize(
    "noise", [Noise(), Noise(aimed=True), Noise(0.3)], ids=["tracker", "aimed", "0.3 px"]
)
def test_the_covariance_is_true(noise):
    n = 120
    errors, nees, found = trials(SHORT, noise, n, raw=False)
    sigma = np.sqrt(np.mean([np.diag(one.covariance) for one in found], axis=0)) / ARCSEC
    ratio = np.sqrt((errors**2).mean(axis=0)) / sigma
    assert (np.abs(ratio - 1.0) < 3.0 / np.sqrt(2 * n)).all()
    assert_consistent(nees, 6)
    assert (np.abs(errors.mean(axis=0)) < 3.0 * sigma / np.sqrt(n)).all()


def test_attitudes_rebuilt_from_positions_have_errors_that_cancel():
    # prototype: position noise alone then leaves a pitch of about 1 arcsec and no bias
    errors, _, found = trials(Plan(), Noise(0.0, 7.5, 0.0, aimed=True), 10, raw=True)
    assert np.sqrt((errors**2).mean(axis=0)).max() < 2.0
    assert np.sqrt(np.diag(found[0].covariance)).max() < 2.0 * ARCSEC
    wrong = orient_by_epipolar(pairs_of(Plan(), Noise(0.0, 7.5, 0.0, aimed=True), 1), PoseNoise(7.5, 0.0))
    assert np.sqrt(wrong.covariance[0, 0]) > 2.0 * ARCSEC


def test_one_pair_of_images_leaves_the_turn_about_the_baseline():
    plan = Plan(shots=1)
    for noise in (NONE, PAPER):
        found = orient_by_epipolar(pairs_of(plan, Noise(), 7, 300), noise)
        assert found.unobservable.shape == (1, 6)
        d = np.array([found_position for found_position in pairs_of(plan, QUIET, 7).sightings.position])
        r = axes(d.reshape(2, 1, 3))[:, 0]
        null = (r @ (d[0] - d[1])).ravel()
        null /= np.linalg.norm(null)
        # positions of 7.5 m over the baseline of 533 km turn it by 2e-5
        assert abs(abs(found.unobservable[0] @ null) - 1.0) < 1e-8
        assert np.isnan(found.angles[:, [0, 2]]).all()
        assert np.isinf(np.diag(found.covariance)[[0, 2, 3, 5]]).all()
        assert (
            np.abs(found.information @ found.unobservable[0]).max() < 1e-12 * np.abs(found.information).max()
        )


def test_residuals_are_in_pixels_of_noise():
    pairs = pairs_of(SHORT, Noise(0.2, 0.0, 0.0), 8, 200)
    residual, sigma = epipolar_residuals(pairs, our_angles(TRUTH))
    np.testing.assert_allclose(sigma, 0.2, rtol=1e-9)
    # 3200 residuals: their rms is known to 1.25 %
    assert np.sqrt((residual**2).mean()) == pytest.approx(0.2, rel=0.04)


def mismatched(seed: int, truth=TRUTH):
    """Pairs of which 5 % are displaced by 2 to 50 px, which those are, how far across the epipolar lines."""
    rng = np.random.default_rng(seed)
    shooting = shoot(SHORT, Noise(), ground(rng, 300, 11e3, 400.0, "smooth"), rng, truth)
    bad = rng.random((16, 300)) < 0.05
    away, way = np.sqrt(rng.uniform(4.0, 2500.0, bad.sum())), rng.uniform(0.0, 2.0 * np.pi, bad.sum())
    shooting.m[1][bad] += shooting.plan.pixel * np.stack([away * np.cos(way), away * np.sin(way)], axis=-1)
    across = np.zeros(bad.shape)
    across[bad] = np.abs(away * np.sin(way))
    return pair_sightings(shooting.sightings()), bad.ravel(), across.ravel()


@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_mismatches_across_the_epipolar_lines_are_found(scale):
    pairs, bad, across = mismatched(9, scale * TRUTH)
    rejected = epipolar_outliers(pairs, PAPER)
    # 4 sigmas of 0.1 px and the shot's own error; a displacement in one image counts 1/sqrt(2), and over 50
    # px the epipolar line departs from the image axis by 0.7 px
    assert rejected[across > 2.0].all()
    assert rejected[bad].mean() > 0.95
    # 4 sigmas: 6e-5 of 4560
    assert rejected[~bad].sum() <= 3
    kept = orient_by_epipolar(pairs.kept(~rejected), PAPER)
    e = (kept.angles - our_angles(scale * TRUTH)).ravel()
    assert e @ kept.information @ e < 30.0
    spoilt = orient_by_epipolar(pairs, PAPER)
    e = (spoilt.angles - our_angles(scale * TRUTH)).ravel()
    assert e @ spoilt.information @ e > 30.0


def test_mismatches_along_the_epipolar_line_cannot_be_found():
    rng = np.random.default_rng(10)
    shooting = shoot(SHORT, Noise(), ground(rng, 300, 11e3, 400.0, "smooth"), rng)
    bad = rng.random((16, 300)) < 0.05
    shooting.m[1][bad] += shooting.plan.pixel * np.array([20.0, 0.0])
    rejected = epipolar_outliers(pair_sightings(shooting.sightings()), PAPER)
    assert rejected[bad.ravel()].mean() < 0.05


@pytest.mark.parametrize("count", [2, 3, 30])
def test_angles_not_known_yet_are_not_taken_for_mismatches(count):
    # 360 arcsec are 47 px; nothing but these angles is said to be wrong with the poses
    pairs = pairs_of(SHORT, Noise(0.1, 0.0, 0.0), 15, count, truth=10.0 * TRUTH)
    assert epipolar_outliers(pairs, NONE).sum() <= 1
    assert epipolar_outliers(pairs, NONE, angles=our_angles(10.0 * TRUTH)).sum() <= 1


def test_a_shot_of_few_pairs_is_where_its_median_is_to_that_ones_sigma():
    """Three pairs a shot, poses known to nothing: a median of n has the variance pi / (2 n) of one pair."""
    shots, threshold = 40, 4.0
    rng = np.random.default_rng(16)
    shooting = shoot(Plan(shots=shots), QUIET, ground(rng, 3, 11e3, 400.0, "smooth"), rng)
    # one pair in each shot is off across the epipolar line, by a little more from shot to shot
    shooting.m[1][:, 1, 1] += shooting.plan.pixel * np.linspace(0.5, 0.9, shots)
    pairs = pair_sightings(shooting.sightings(0.1))
    residual, sigma = epipolar_residuals(pairs, our_angles(TRUTH))
    off = np.abs(residual / sigma).reshape(shots, 3).max(axis=1)
    limit = threshold * np.sqrt(1.0 + np.pi / 6.0)
    assert off.min() < 0.95 * limit and 1.05 * limit < off.max()
    rejected = epipolar_outliers(
        pairs, PoseNoise(1e5, 0.0), threshold=threshold, angles=our_angles(TRUTH)
    ).reshape(shots, 3)
    # poses of 1e5 m are 1e4 px: what is known of them beforehand is 1e-10 of the rest
    assert np.array_equal(rejected.any(axis=1), off > limit)
    assert rejected.sum() == (off > limit).sum()
    # the same poses known exactly: the shot is where they say
    exactly = epipolar_outliers(pairs, NONE, threshold=threshold, angles=our_angles(TRUTH))
    assert np.array_equal(exactly.reshape(shots, 3).any(axis=1), off > threshold)


def test_bad_input_is_refused():
    rng = np.random.default_rng(11)
    shooting = shoot(SHORT, Noise(), ground(rng, 5, 11e3, 400.0, "smooth"), rng)
    alone = np.zeros((2, 16, 5), dtype=bool)
    alone[0, ::2] = alone[1, 1::2] = True
    with pytest.raises(InputError, match="no point in the same shot"):
        pair_sightings(shooting.sightings(keep=alone.ravel()))
    few = np.zeros((2, 16, 5), dtype=bool)
    few[:, 0] = True
    with pytest.raises(InputError, match=r"six pairs or more.*got 5"):
        orient_by_epipolar(pair_sightings(shooting.sightings(keep=few.ravel())), PAPER)
    with pytest.raises(InputError, match="two cameras"):
        pair_sightings(shooting.sightings(), (0, 0))
    with pytest.raises(InputError, match="two cameras"):
        pair_sightings(shooting.sightings(), (0, 2))
    rows = np.r_[0, np.arange(160)]
    with pytest.raises(InputError, match="given twice"):
        pair_sightings(shooting.sightings(keep=rows))
    shooting.d[1] = shooting.d[0]
    with pytest.raises(InputError, match="no baseline"):
        orient_by_epipolar(pair_sightings(shooting.sightings()), PAPER)


def test_one_point_per_shot_does_not_pretend_to_tell_everything():
    # the same direction in every frame: no field of view, so that few combinations are seen
    rng = np.random.default_rng(12)
    shooting = shoot(Plan(shots=64, window=2.0), QUIET, np.zeros((1, 3)), rng)
    found = orient_by_epipolar(pair_sightings(shooting.sightings()), PAPER)
    assert len(found.unobservable) >= 1
    assert np.isinf(np.diag(found.covariance)).any()
    assert not np.isfinite(found.angles).all()


def test_angles_are_about_the_body_however_the_camera_sits_in_it():
    rng = np.random.default_rng(13)
    sightings = shoot(SHORT, Noise(), ground(rng, 60, 11e3, 400.0, "smooth"), rng).sightings()
    turns = [Rotation.from_rotvec([0.3, -0.2, 1.0]), Rotation.from_rotvec([2.0, 0.5, -0.4])]
    turned = replace(
        sightings,
        world_from_body=np.concatenate(
            [sightings.world_from_body[16 * j : 16 * j + 16] @ turns[j].as_matrix() for j in range(2)]
        ),
        body_from_camera=np.stack(
            [turns[j].inv().as_matrix() @ sightings.body_from_camera[j] for j in range(2)]
        ),
    )
    for knowledge in (PAPER, PoseNoise(7.5, 1.8 * ARCSEC, np.zeros(3))):
        before = orient_by_epipolar(pair_sightings(sightings), knowledge)
        after = orient_by_epipolar(pair_sightings(turned), knowledge)
        expected = np.stack([turns[j].inv().apply(before.angles[j]) for j in range(2)])
        np.testing.assert_allclose(after.angles, expected, atol=1e-5 * ARCSEC)
        block = block_diag(*[turn.as_matrix() for turn in turns])
        change = block @ after.covariance @ block.T - before.covariance
        assert np.abs(change).max() < 1e-5 * before.covariance.max()


def test_points_in_one_line_of_one_pair_leave_more_than_the_baseline():
    rng = np.random.default_rng(14)
    line = np.outer(np.linspace(-5e3, 5e3, 50), [0.6, 0.8, 0.0])
    pairs = pair_sightings(shoot(Plan(shots=1), QUIET, line, rng).sightings())
    assert len(orient_by_epipolar(pairs, NONE).unobservable) >= 2


def test_noise_of_sightings_is_not_taken_for_noise_of_poses():
    # 0.75 m and 0.18 arcsec are declared; of a shot's 100 pairs of 0.5 px a mean of about that size is left,
    # which must be taken off
    declared = PoseNoise(0.75, 0.18 * ARCSEC)
    still, moved = (
        np.array([
            noise_ratios(pairs_of(SHORT, noise, seed), declared, our_angles(TRUTH)) for seed in range(8)
        ])
        for noise in (Noise(0.5, 0.0, 0.0), Noise(0.5, 0.75, 0.18 * ARCSEC))
    )  # fmt: skip
    # a median of 12,800 residuals
    assert still[:, 0].mean() == pytest.approx(1.0, abs=0.1)
    # 16 shots a pass: their mean square scatters by sqrt(2 / 16) of what was taken off, and is never negative
    assert still[:, 1].mean() < 0.35
    # 128 shots, whose means hold both parts
    assert moved[:, 1].mean() == pytest.approx(1.0, abs=3.0 * 2.0 * np.sqrt(2.0 / 128.0))
