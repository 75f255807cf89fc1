"""The adjustment on S2's imaging in closed form: exact, honest; gauge, gross errors, priors, drift, focal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.photogrammetry.stereo_scene import (
    ARCSEC,
    QUIET,
    TRUTH,
    Noise,
    Plan,
    axes,
    ground,
    orbit,
    our_angles,
    shoot,
)

from consistency import assert_consistent
from sightline.compiled import only_read
from sightline.errors import InputError
from sightline.geometry.surface import Plane
from sightline.photogrammetry.block.bundle import adjust, bound
from sightline.photogrammetry.block.bundle_kernels import statistics
from sightline.photogrammetry.block.descent import rotations_of
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.block.pose_unknowns import pose_unknowns
from sightline.photogrammetry.block.reduced import Curvature, PointsFirst, PosesFirst
from sightline.photogrammetry.sightings import Sightings, as_index

SMALL = Plan(shots=12, window=64.0)
NOISE = PoseNoise(7.5, 1.8 * ARCSEC)
TRUE = our_angles(TRUTH)
NOISY = Noise()


def measure(seed, plan=SMALL, noise=NOISY, count=60, relief=300.0, truth=TRUTH):
    rng = np.random.default_rng(seed)
    points = ground(rng, count, 11e3, relief, "white")
    return shoot(plan, noise, points, rng, truth), points


def miss(found, truth=TRUE):
    return (found.angles - truth).ravel()


@pytest.mark.parametrize("pairs", [False, True])
@pytest.mark.parametrize("size", [1.0, 300.0])
def test_without_noise_the_angles_come_out_exactly(pairs, size):
    # 36" and 3 degrees: the model is the exact projection, so only rounding is left
    truth = size * TRUTH
    shooting, _ = measure(0, noise=QUIET, truth=truth)
    found = adjust(shooting.sightings(), NOISE, new_points_per_shot=pairs)
    assert np.abs(miss(found, our_angles(truth))).max() < 1e-4 * ARCSEC
    assert not found.rejected.any()


def test_swapped_cameras_give_swapped_angles():
    shooting, _ = measure(1)
    plain = adjust(shooting.sightings(), NOISE)
    swapped = adjust(shooting.swapped().sightings(), NOISE)
    assert np.allclose(plain.angles, swapped.angles[::-1], atol=1e-3 * ARCSEC)
    order = [3, 4, 5, 0, 1, 2]
    assert np.allclose(plain.covariance, swapped.covariance[np.ix_(order, order)], rtol=1e-3, atol=1e-16)


@pytest.mark.parametrize("aimed", [False, True])
@pytest.mark.parametrize("pairs", [False, True])
def test_errors_are_as_large_as_the_covariance_says(pairs, aimed):
    nees = []
    noise = PoseNoise(7.5, 1.8 * ARCSEC, np.zeros(3) if aimed else None)
    for seed in range(50):
        shooting, _ = measure(seed, noise=Noise(aimed=aimed))
        found = adjust(shooting.sightings(), noise, new_points_per_shot=pairs)
        error = miss(found)
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert_consistent(nees, 6)


def test_the_points_are_as_good_as_their_covariance_says():
    # one pass: its points share poses, so that their chi-squares are not independent; those of passes are
    nees = []
    for seed in range(100):
        shooting, points = measure(seed)
        found = adjust(shooting.sightings(), NOISE)
        error = found.points - points
        nees.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.point_covariance), error).mean())
    # correlated entirely within a pass at worst
    assert_consistent(nees, 3)


def random_equations(rng, sightings, unknowns):
    """Rows of any size for the pattern of `sightings`, and the sums over them."""
    count, width = len(sightings), unknowns.width
    rows = rng.standard_normal((count, 2, width + 3))
    of_images = np.zeros((len(sightings.camera), width, width))
    known = np.tile(1e-3 * np.eye(3), (sightings.points, 1, 1))
    of_points = known.copy()
    weight = rng.random(count)
    for i in range(count):
        x, p = rows[i, :, :width], rows[i, :, width:]
        of_images[sightings.image[i]] += weight[i] * x.T @ x
        of_points[sightings.point[i]] += weight[i] * p.T @ p
    return Curvature(rows, weight, sightings.image, sightings.point, of_images, of_points, known)


def test_tied_shots_and_the_covariance_of_every_image_equal_the_dense_inverse():
    rng = np.random.default_rng(4)
    shooting, _ = measure(4, plan=replace(SMALL, shots=5), count=8)
    sightings = shooting.sightings(keep=rng.random(80) < 0.7)
    unknowns = pose_unknowns(sightings, NOISE, drift=True)
    size = 12
    tied = np.zeros((5, 3, size, size))
    root = rng.standard_normal((5 * size, 5 * size)) * np.tri(5 * size) * (np.tri(5 * size, k=-25) == 0)
    whole = root @ root.T + np.eye(5 * size)  # shots two apart are tied, three apart are not
    for k in range(5):
        for d in range(min(k, 2) + 1):
            tied[k, d] = whole[k * size : (k + 1) * size, (k - d) * size : (k - d + 1) * size]
    for k in range(3, 5):
        whole[k * size :, : (k - 2) * size] = whole[: (k - 2) * size, k * size :] = 0.0
    unknowns = replace(unknowns, precision=tied, by_shot=1e3 * unknowns.by_shot)
    curvature = random_equations(rng, sightings, unknowns)
    reduced = PointsFirst(curvature, unknowns)
    # dense: own unknowns, globals, points
    own, points, free = 5 * size, sightings.points, unknowns.globals
    rows = np.zeros((2 * len(sightings), own + free + 3 * points))
    for i, (m, n) in enumerate(zip(sightings.image, sightings.point, strict=True)):
        k, slot = unknowns.shot[m], slice(6 * unknowns.slot[m], 6 * unknowns.slot[m] + 6)
        x, p = curvature.rows[i, :, :6], curvature.rows[i, :, 6:]
        here = slice(2 * i, 2 * i + 2)
        rows[here, k * size : (k + 1) * size] = x @ unknowns.by_shot[k, slot]
        rows[here, own : own + free] = x @ unknowns.by_global[k, slot]
        rows[here, own + free + 3 * n : own + free + 3 * n + 3] = p
        rows[here] *= np.sqrt(curvature.weight[i])
    dense = rows.T @ rows
    dense[:own, :own] += whole
    dense[own + free :, own + free :] += 1e-3 * np.eye(3 * points)
    inverse = np.linalg.inv(dense)
    common = inverse[own : own + free, own : own + free]
    assert np.allclose(np.linalg.inv(reduced.information), common, rtol=1e-7)
    found = reduced.departure_covariance(common)
    for m in range(len(sightings.camera)):
        k, slot = unknowns.shot[m], slice(6 * unknowns.slot[m], 6 * unknowns.slot[m] + 6)
        to = np.zeros((6, own + free))
        to[:, k * size : (k + 1) * size] = unknowns.by_shot[k, slot]
        to[:, own:] = unknowns.by_global[k, slot]
        assert np.allclose(found[m], to @ inverse[: own + free, : own + free] @ to.T, rtol=1e-6, atol=1e-9)
    # the first camera's images, each with the one before it
    after = reduced.following_covariance(common, 5)
    assert after is not None and unknowns.shot[:5].tolist() == [0, 1, 2, 3, 4]
    for m in range(1, 5):
        slot = slice(6 * unknowns.slot[m], 6 * unknowns.slot[m] + 6)
        to, before = np.zeros((2, 6, own + free))
        for rows, k in ((to, m), (before, m - 1)):
            rows[:, k * size : (k + 1) * size] = unknowns.by_shot[k, slot]
            rows[:, own:] = unknowns.by_global[k, slot]
        expected = to @ inverse[: own + free, : own + free] @ before.T
        assert np.allclose(after[m - 1], expected, rtol=1e-6, atol=1e-9)
    assert reduced.following_covariance(common, 10) is None  # then come those of the other camera
    z = rng.standard_normal((5, size))
    assert np.allclose(unknowns.prior_times(z).ravel(), whole @ z.ravel())


def test_both_orders_of_elimination_give_the_same_equations():
    rng = np.random.default_rng(3)
    shooting, _ = measure(3)
    keep = rng.random(2 * 12 * 60) < 0.6  # unequal tracks, missing points
    sightings = shooting.sightings(keep=keep)
    unknowns = pose_unknowns(sightings, NOISE, drift=True, focal_sigma=(0.01, np.inf))
    curvature = random_equations(rng, sightings, unknowns)
    first, second = PosesFirst(curvature, unknowns), PointsFirst(curvature, unknowns)
    assert np.allclose(first.information, second.information, rtol=1e-9, atol=1e-9)
    right = (
        rng.standard_normal((unknowns.shots, 6 * unknowns.slots)),
        rng.standard_normal((sightings.points, 3)),
        rng.standard_normal(unknowns.globals),
    )
    assert np.allclose(first.condense(*right), second.condense(*right), rtol=1e-8)
    step = rng.standard_normal(unknowns.globals)
    for one, two in zip(first.solve(*right, step), second.solve(*right, step), strict=True):
        assert np.allclose(one, two, rtol=1e-7, atol=1e-9)


def test_one_pair_of_images_leaves_the_turn_about_the_baseline_and_says_so():
    plan = replace(SMALL, shots=1)
    shooting, points = measure(4, plan=plan, count=300)
    found = adjust(shooting.sightings(), NOISE)
    assert found.observability.hidden.sum() == 1
    d = orbit(plan)[:, 0]
    r = axes(orbit(plan))[:, 0]
    expected = np.concatenate([r[0] @ (d[0] - d[1]), r[1] @ (d[0] - d[1])])
    expected /= np.linalg.norm(expected)
    known, _ = bound(shooting.sightings(), NOISE, points)
    assert known.hidden.sum() == 1
    # R is the planned one, the null that of the true poses: 36" apart
    assert abs(known.directions[0] @ expected) > 1.0 - 1e-6
    assert np.isnan(found.angles).any()
    assert np.isinf(np.diag(found.covariance))[np.isnan(found.angles).ravel()].all()


def test_gross_mismatches_of_tracked_points_are_found_and_do_no_harm():
    shooting, _ = measure(5, count=100)
    clean = shooting.sightings()
    rng = np.random.default_rng(50)
    bad = rng.random(len(clean)) < 0.05
    turn, far = rng.uniform(0.0, 2.0 * np.pi, bad.sum()), rng.uniform(2.0, 50.0, bad.sum())
    tangents = np.array(clean.tangents)
    tangents[bad] += shooting.plan.pixel * far[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    found = adjust(replace(clean, tangents=tangents), NOISE)
    best = adjust(replace_rows(clean, ~bad), NOISE)
    assert found.rejected[bad].all()  # 2 px is 20 sigma
    assert found.rejected[~bad].sum() <= 2
    assert np.allclose(found.angles, best.angles, atol=0.05 * np.sqrt(np.diag(best.covariance)).max())


def replace_rows(sightings: Sightings, keep) -> Sightings:
    names = ("image", "point", "pose", "tangents", "px_per_tangent", "sigma_px")
    return replace(sightings, **{name: getattr(sightings, name)[keep] for name in names})


def test_pairs_cannot_tell_a_mismatch_along_the_epipolar_line():
    shooting, _ = measure(6, noise=QUIET)
    sightings = shooting.sightings()
    # S2's y is square to the epipolar plane: x of the tangents in S2's axes, y in ours, runs along the line
    tangents = np.array(sightings.tangents)
    tangents[-1, 1] += 20.0 * shooting.plan.pixel
    tangents[-2, 0] += 20.0 * shooting.plan.pixel
    found = adjust(replace(sightings, tangents=tangents), NOISE, new_points_per_shot=True)
    half = len(sightings) // 2
    wrong = found.rejected[:half] | found.rejected[half:]
    assert wrong[-2] and not wrong[-1]
    assert not found.checked.any()
    tracked = adjust(replace(sightings, tangents=tangents), NOISE)
    assert tracked.rejected[[-1, -2]].all() and tracked.rejected.sum() == 2


def test_known_heights_and_control_points_help_and_are_believed():
    shooting, points = measure(7, relief=0.0)
    sightings = shooting.sightings()
    plain = adjust(sightings, NOISE)
    heights = PointPriors(HeightPrior(Plane(0.0), 5.0, None))
    control = PointPriors(None, ControlPoints(np.arange(5), points[:5], 1.0))
    with_heights, with_control = (
        adjust(sightings, NOISE, priors=heights),
        adjust(sightings, NOISE, priors=control),
    )
    sigma = [np.sqrt(np.diag(a.covariance)) for a in (plain, with_heights, with_control)]
    assert sigma[1][1] < 0.95 * sigma[0][1]  # heights fix pitch
    assert (sigma[2][:2] < 0.5 * sigma[0][:2]).all()  # points fix roll and pitch
    for found in (with_heights, with_control):
        error = miss(found)
        assert error @ np.linalg.solve(found.covariance, error) < 25.0  # chi-square of 6 at 3e-4


def test_a_height_prior_that_is_wrong_by_its_sigma_moves_angles_within_theirs():
    shooting, _ = measure(8, noise=QUIET, relief=0.0)
    found = adjust(shooting.sightings(), NOISE, priors=PointPriors(HeightPrior(Plane(5.0), 5.0, None)))
    # all points wrong together by one sigma each is far less likely than the prior says of 60 points
    assert np.all(np.abs(miss(found)) < np.sqrt(60.0) * np.sqrt(np.diag(found.covariance)))
    assert np.abs(miss(found)).max() > 1e-3 * ARCSEC


def test_a_drift_is_found_with_an_honest_sigma():
    # attitudes in hand turned by rate * t: the same as a drift of the true ones the other way
    rate = 0.1 * ARCSEC * np.array([[1.0, -2.0, 0.5], [0.5, 1.0, -1.0]])
    shooting, _ = measure(9)
    sightings = shooting.sightings()
    middle = 0.5 * (sightings.t.max() + sightings.t.min())
    turned = Rotation.from_rotvec(-rate[sightings.camera] * (sightings.t - middle)[:, None]).as_matrix()
    moved = replace(sightings, world_from_body=sightings.world_from_body @ turned)
    found = adjust(moved, NOISE, drift=True)
    assert found.unknowns.names[6] == "roll_drift_1"
    half = found.time[1]
    error = np.concatenate([miss(found), found.common[6:] - (rate * half).ravel()])
    assert error @ np.linalg.solve(found.global_covariance, error) < 33.0  # chi-square of 12 at 1e-3
    assert np.sqrt(np.diag(found.global_covariance))[6:].max() < 30.0 * ARCSEC


def test_a_focal_length_that_is_wrong_is_found_where_the_geometry_tells_it():
    shooting, _ = measure(10, plan=replace(SMALL, field=8.0), count=200)
    sightings = shooting.sightings()
    stretched = replace(sightings, tangents=sightings.tangents * (1.0 + np.array([2e-3, -1e-3]))[
        sightings.camera[sightings.image], None
    ])  # fmt: skip
    found = adjust(stretched, NOISE, focal_sigma=(np.inf, 0.01))
    assert found.unknowns.names[6:] == ("stretch_1", "stretch_2")
    # one common stretch is nearly a higher orbit over larger ground; their difference is seen in every pair
    error, covariance = found.common[6:] - [2e-3, -1e-3], found.global_covariance[6:, 6:]
    assert error @ np.linalg.solve(covariance, error) < 13.8  # chi-square of 2 at 1e-3
    assert np.array([1.0, -1.0]) @ covariance @ np.array([1.0, -1.0]) < 3e-4**2
    error = miss(found)
    assert error @ np.linalg.solve(found.covariance, error) < 25.0


def test_one_camera_in_time_is_adjusted_too():
    # the second camera's images become images of the first at shots of their own: one boresight error
    shooting, _ = measure(11, truth=np.array([TRUTH[0], TRUTH[0]]))
    sightings = shooting.sightings()
    one = replace(
        sightings,
        camera=as_index(np.zeros(24), "camera"),
        shot=as_index(np.arange(24), "shot"),
        body_from_camera=sightings.body_from_camera[:1],
    )
    found = adjust(one, NOISE)
    error = found.angles.ravel() - TRUE[0]
    assert found.covariance.shape == (3, 3)
    assert error @ np.linalg.solve(found.covariance, error) < 16.3  # chi-square of 3 at 1e-3


def test_misstated_sigmas_show_in_chi_square_and_scale():
    shooting, _ = measure(12, noise=Noise(image=0.2))
    found = adjust(shooting.sightings(sigma_px=0.1), NOISE)
    assert 1.7 < found.scale < 2.2
    assert found.cost / found.degrees_of_freedom > 3.0
    assert found.rejected.mean() < 1e-3  # large all over is not gross


def test_too_few_points_are_refused():
    shooting, _ = measure(13)
    keep = np.zeros(2 * 12 * 60, dtype=bool)
    keep[[0, 720]] = True
    with pytest.raises(InputError, match="too few conjugate points"):
        adjust(shooting.sightings(keep=keep), NOISE)


def test_the_jacobian_of_rotation_vectors_is_their_derivative():
    rng = np.random.default_rng(0)
    angles = rng.standard_normal((5, 3)) * np.array([1.0, 1e-1, 1e-3, 1e-6, 0.0])[:, None]
    inverse, jacobian = rotations_of(angles)
    step = 1e-6
    for axis in range(3):
        more = (
            Rotation.from_matrix(inverse) * Rotation.from_rotvec(angles + step * np.eye(3)[axis])
        ).as_rotvec()
        less = (
            Rotation.from_matrix(inverse) * Rotation.from_rotvec(angles - step * np.eye(3)[axis])
        ).as_rotvec()
        assert np.allclose(jacobian[:, :, axis], (more - less) / (2.0 * step), atol=1e-8)


def test_chi_square_counts_what_is_known_of_points():
    # heights drawn with the sigma of the prior: chi-square per degree of freedom is 1 +- sqrt(2 / 1500)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = ground(rng, 60, 11e3, 0.0, "white")
        points[:, 2] = 20.0 * rng.standard_normal(60)
        shooting = shoot(SMALL, NOISY, points, rng)
        found = adjust(shooting.sightings(), NOISE, priors=PointPriors(HeightPrior(Plane(0.0), 20.0, None)))
        assert abs(found.cost / found.degrees_of_freedom - 1.0) < 5.0 * np.sqrt(
            2.0 / found.degrees_of_freedom
        )
        assert found.degrees_of_freedom == 4 * 60 * 12 + 60 - 3 * 60 - 6


def test_residuals_are_judged_along_and_across_what_their_own_point_leaves_of_them():
    """Their covariance written out: less by how its point follows a sighting, more where that is left out."""
    rng, n = np.random.default_rng(15), 40
    rows, r = rng.normal(size=(n, 2, 9)), rng.normal(size=(n, 2))
    root = 0.35 * rng.normal(size=(6, 3, 3))
    inverse, point = root @ root.transpose(0, 2, 1), rng.integers(0, 6, n)
    weight = np.where(np.arange(n) % 3 == 0, 0.0, 1.0)
    out, checked, freedom = np.empty((3, n))
    statistics(rows, weight, *only_read(point), inverse, r, 0.2, out, checked, freedom)
    own = rows[:, :, 6:]
    covariance = np.eye(2) + (1.0 - 2.0 * weight)[:, None, None] * (
        own @ inverse[point] @ own.transpose(0, 2, 1)
    )
    value, direction = np.linalg.eigh(covariance)
    along = np.einsum("nik,ni->nk", direction, r)
    seen = value > 0.2
    assert 0.2 < seen.mean() < 0.95
    np.testing.assert_allclose(out, np.where(seen, along**2 / value, 0.0).sum(axis=1), rtol=1e-9)
    np.testing.assert_array_equal(checked, seen.all(axis=1))
    np.testing.assert_allclose(freedom, np.trace(covariance, axis1=1, axis2=2), rtol=1e-12)
