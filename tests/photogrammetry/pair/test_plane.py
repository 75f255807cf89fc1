"""S2's plane estimate, corrected: exact on flat ground, true to its covariance over relief, refusals.

Monte-Carlo bounds as in `test_epipolar.py`.
"""

from dataclasses import replace

import numpy as np
import pytest

from consistency import assert_consistent
from photogrammetry.stereo_scene import (
    ARCSEC,
    QUIET,
    TRUTH,
    Noise,
    Plan,
    ground,
    our_angles,
    shoot,
)
from sightline.errors import InputError
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.pairs import PairOrientation, SightingPairs, pair_sightings
from sightline.photogrammetry.pair.plane import _rows, _seen_apart, common_aim, orient_by_plane
from sightline.photogrammetry.pair.relief import _in_cells, correlation_length, relief_spread

SHORT = Plan(shots=16)
AIM, UP = np.zeros(3), np.array([0.0, 0.0, 1.0])
NONE = PoseNoise(0.0, 0.0)


def orient(pairs: SightingPairs, noise: PoseNoise = NONE) -> PairOrientation:
    return orient_by_plane(pairs, noise, aim_point=AIM, vertical=UP)


def pairs_of(
    noise: Noise,
    seed: int,
    relief: float,
    kind: str = "smooth",
    plan: Plan = SHORT,
    count: int = 150,
    truth=TRUTH,
) -> SightingPairs:
    rng = np.random.default_rng(seed)
    points = ground(rng, count, 11e3, relief, kind)
    return pair_sightings(shoot(plan, noise, points, rng, truth).sightings(max(noise.image, 1e-3)))


@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_on_flat_ground_without_noise_the_angles_come_back(scale):
    # steps below 1e-5 rad are the last: what they leave is of second order
    found = orient(pairs_of(QUIET, 1, 0.0, truth=scale * TRUTH))
    assert np.abs(found.angles - our_angles(scale * TRUTH)).max() < 1e-2 * ARCSEC
    assert found.residual_px.max() < 1e-3


def test_a_sloping_ground_is_a_plane_too():
    rng = np.random.default_rng(2)
    points = ground(rng, 150, 11e3, 0.0, "smooth")
    points[:, 2] = 0.01 * points[:, 0] - 0.02 * points[:, 1]
    found = orient(pair_sightings(shoot(SHORT, QUIET, points, rng).sightings(1e-3)))
    # taken up by the depths' slopes, but for what is of second order: 0.02 x 5.5 km = 110 m, which as a
    # height would be 20 arcsec
    assert np.abs(found.angles - our_angles(TRUTH))[:, :2].max() < 2.0 * ARCSEC


def test_white_relief_leaves_less_than_three_arcseconds_of_pitch():
    # prototype, table 1: N 200, K 64, 200 m
    for seed in range(5):
        found = orient(pairs_of(QUIET, seed, 200.0, "white", Plan(), 200))
        error = np.abs(found.angles - our_angles(TRUTH)) / ARCSEC
        assert error[:, 0].max() < 0.1
        assert error[:, 1].max() < 3.0


@pytest.mark.parametrize(
    ("noise", "relief", "kind"),
    [(Noise(), 400.0, "smooth"), (Noise(), 200.0, "white"), (Noise(0.3, aimed=True), 200.0, "smooth")],
    ids=["smooth", "white", "aimed"],
)
def test_the_covariance_is_true(noise, relief, kind):
    n = 100
    knowledge = PoseNoise(noise.position, noise.attitude, AIM if noise.aimed else None)
    found = [orient(pairs_of(noise, seed, relief, kind), knowledge) for seed in range(n)]
    errors = np.array([(one.angles - our_angles(TRUTH)).ravel() for one in found])
    nees = [e @ one.information @ e for e, one in zip(errors, found, strict=True)]
    sigma = np.sqrt(np.mean([np.diag(one.covariance) for one in found], axis=0))
    ratio = np.sqrt((errors**2).mean(axis=0)) / sigma
    # a tenth more: the correlation of heights is measured on one scene each time
    assert (np.abs(ratio - 1.0) < 3.0 / np.sqrt(2 * n) + 0.1).all()
    assert_consistent(nees, 6, wider=0.1)


def test_cameras_named_the_other_way_swap_their_angles():
    rng = np.random.default_rng(4)
    sightings = shoot(SHORT, Noise(), ground(rng, 60, 11e3, 200.0, "smooth"), rng).sightings()
    knowledge = PoseNoise(7.5, 1.8 * ARCSEC)
    one, two = (orient(pair_sightings(sightings, cameras), knowledge) for cameras in ((0, 1), (1, 0)))
    np.testing.assert_allclose(two.angles, one.angles[::-1], atol=1e-3 * ARCSEC)
    swapped = np.r_[3:6, 0:3]
    # the length over which heights go together is one of 40 values, from places that differ by metres
    sigma = np.sqrt(np.diag(one.covariance))
    change = two.covariance[np.ix_(swapped, swapped)] - one.covariance
    assert np.abs(change / np.outer(sigma, sigma)).max() < 0.05


def test_a_wrong_height_of_the_plane_is_a_difference_of_pitch():
    pairs = pairs_of(QUIET, 5, 0.0)
    high = orient_by_plane(pairs, NONE, aim_point=np.array([0.0, 0.0, 100.0]), vertical=UP)
    shift = (high.angles - our_angles(TRUTH)) / ARCSEC
    # 100 m over some 550 km seen at 30 degrees from the vertical: 100 sin(30) / 550e3 = 19 arcsec
    assert 10.0 < abs(shift[0, 1]) < 30.0
    assert shift[0, 1] * shift[1, 1] < 0.0


def test_a_misfit_on_the_ground_is_as_long_as_the_second_camera_sees_it():
    # a wide field and pixels three times as fine across, so that every term counts
    rng = np.random.default_rng(8)
    plan = Plan(shots=3, field=50.0)
    points = ground(rng, 40, 200e3, 0.0, "smooth")
    shot = shoot(plan, QUIET, points, rng, np.zeros((2, 3)))
    sightings = shot.sightings(1e-3)
    sightings = replace(sightings, px_per_tangent=sightings.px_per_tangent * np.array([[1.0], [3.0]]))
    pairs = pair_sightings(sightings)
    misfit = rng.normal(size=(3, 40, 3))  # m, of each shot and point
    left = misfit.reshape(-1, 3).T.copy()
    found = _seen_apart(pairs, _rows(pairs, np.zeros((2, 3)), AIM, UP), left)
    # the points are on the plane: where the second camera sees them, and what lies beside them (S2's axes)
    two = np.broadcast_to(points, (3, 40, 3)) - shot.d[1][:, None]
    seen, moved = (np.einsum("kab,knb->kna", shot.r[1], two + sign * misfit) for sign in (0.0, 1.0))
    tangents = moved[..., :2] / moved[..., 2:] - seen[..., :2] / seen[..., 2:]
    wanted = np.hypot(tangents[..., 0], 3.0 * tangents[..., 1]) / plan.pixel
    # of second order in metres over 500 km
    np.testing.assert_allclose(found.reshape(3, 40), wanted, rtol=1e-4)


def test_residuals_are_those_of_points_above_the_plane():
    # five of 150 points stand 100 m above the plane: too few to move the plane by much
    rng = np.random.default_rng(8)
    points = ground(rng, 150, 11e3, 0.0, "smooth")
    high = np.arange(150) % 37 == 0
    points[high, 2] = 100.0
    shot = shoot(SHORT, QUIET, points, rng, np.zeros((2, 3)))
    residual = orient(pair_sightings(shot.sightings(1e-3))).residual_px.reshape(SHORT.shots, 150)
    # where each line of sight of the first camera meets the plane, seen by the second
    one, two = shot.d
    along = points - one[:, None]
    place = one[:, None] - along * one[:, None, 2:] / along[..., 2:]
    seen = np.einsum("kab,knb->kna", shot.r[1], place - two[:, None])
    apart = np.linalg.norm(seen[..., :2] / seen[..., 2:] - shot.m[1], axis=-1) / SHORT.pixel
    # what the high points move angles and plane by is less than a tenth of what they stand out
    np.testing.assert_allclose(residual[:, high], apart[:, high], rtol=0.1)
    assert residual[:, ~high].max() < 0.1 * apart[:, high].max()


def test_the_aim_point_is_where_the_axes_meet():
    pairs = pairs_of(QUIET, 6, 0.0)
    np.testing.assert_allclose(common_aim(pairs.sightings), 0.0, atol=1e-3)


def test_bad_input_is_refused():
    rng = np.random.default_rng(7)
    shooting = shoot(Plan(shots=2), QUIET, ground(rng, 5, 11e3, 0.0, "smooth"), rng)
    few = np.zeros((2, 2, 5), dtype=bool)
    few[:, 0, :4] = True
    with pytest.raises(InputError, match="five pairs or more, got 4"):
        orient(pair_sightings(shooting.sightings(keep=few.ravel())))
    up = replace(shooting, d=-shooting.d)
    with pytest.raises(InputError, match="does not come down"):
        orient(pair_sightings(up.sightings()))
    parallel = replace(shooting, r=np.broadcast_to(shooting.r[0, 0], shooting.r.shape))
    with pytest.raises(InputError, match="parallel"):
        common_aim(parallel.sightings())


def test_points_in_one_place_do_not_pretend_to_tell_everything():
    rng = np.random.default_rng(8)
    pairs = pair_sightings(shoot(Plan(shots=8), QUIET, np.zeros((1, 3)), rng).sightings())
    found = orient(pairs)
    assert len(found.unobservable) >= 1
    assert np.isinf(np.diag(found.covariance)).any()


@pytest.mark.parametrize("length", [0.0, 1500.0])
@pytest.mark.parametrize("count", [400, 1500])
def test_the_spread_of_a_sum_over_heights_is_that_of_drawn_heights(length, count):
    rng = np.random.default_rng(9)
    place = rng.uniform(0.0, 12e3, (count, 2))
    # influences that vary over the scene, and by point
    influence = np.stack(
        [np.cos(place[:, 0] / 1.5e3), np.sin(place[:, 1] / 1e3), rng.standard_normal(count)], axis=1
    )
    waves = rng.standard_normal((2, 1000)) / max(length, 1.0)
    phase = rng.uniform(0.0, 2.0 * np.pi, 1000)
    shapes = np.sqrt(2.0) * np.cos(place @ waves + phase) if length else None
    # as where a plane was fitted: it has taken its part of both
    level = np.linalg.qr(np.column_stack([np.ones(count), place - place.mean(axis=0)]))[0]
    influence -= level @ (level.T @ influence)
    sums, said = [], []
    for _ in range(50):
        if shapes is None:
            height = 50.0 * rng.standard_normal(count)
        else:
            height = 50.0 * shapes @ rng.standard_normal(1000) / np.sqrt(1000)
        height -= level @ (level.T @ height)
        sums.append(influence.T @ height)
        said.append(np.diag(relief_spread(place, height, influence)))
    ratio = np.sqrt(np.mean(said, axis=0) / np.mean(np.square(sums), axis=0))
    # the rms of 50 is known to 10 %; three of them and what the measured length is off by
    assert (np.abs(np.log(ratio)) < 0.45).all()


def test_the_length_of_white_heights_is_short():
    rng = np.random.default_rng(10)
    assert correlation_length(rng.uniform(0.0, 1e4, (500, 2)), rng.standard_normal(500)) < 300.0


def test_what_relief_moves_in_the_second_camera_is_reported_in_pixels():
    rng = np.random.default_rng(3)
    points = ground(rng, 150, 11e3, 200.0, "white")
    pairs = pair_sightings(shoot(Plan(), QUIET, points, rng, TRUTH).sightings(1e-3))
    found = orient(pairs)
    # heights above the plane through them, carried by both rays down to it; across the second ray, as pixels
    level = np.column_stack([points[:, :2], np.ones(len(points))])
    height = (points[:, 2] - level @ np.linalg.lstsq(level, points[:, 2], rcond=None)[0])[pairs.point]
    one, two = (points[pairs.point] - pairs.sightings.position[images][pairs.shot] for images in pairs.images)
    apart = height[:, None] * (one / one[:, 2:] - two / two[:, 2:])
    along = two / np.linalg.norm(two, axis=1)[:, None]
    across = apart - (apart * along).sum(axis=1)[:, None] * along
    scale = np.linalg.norm(pairs.sightings.px_per_tangent[pairs.rows[1]], 2, axis=(1, 2))
    expected = scale * np.linalg.norm(across, axis=1) / np.linalg.norm(two, axis=1)
    # the plane fitted differs from that of the points by some metres
    assert np.corrcoef(found.residual_px, expected)[0, 1] > 0.995
    assert found.residual_px.std() == pytest.approx(expected.std(), rel=0.03)


def test_influences_are_summed_in_the_cell_where_their_points_lie():
    place = np.array([[0.0, 0.0], [1.0, 2.0], [900.0, 300.0], [10.0, 500.0]])
    middles, sums, size = _in_cells(place, np.array([[1.0], [2.0], [4.0], [8.0]]))
    assert sorted(sums[:, 0]) == [3.0, 4.0, 8.0]
    for total, first in ((3.0, place[0]), (4.0, place[2]), (8.0, place[3])):
        (middle,) = middles[sums[:, 0] == total]
        assert np.abs(middle - first).max() <= 0.5 * size
