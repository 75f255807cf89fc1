"""The dense solution for frames against pinholes worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2
from tests.motion import pinholes

from motion.frame_closure import closure
from sightline.errors import EstimationError, InputError
from sightline.geometry.surface import Plane
from sightline.motion.frames import errors
from sightline.motion.frames.errors import common_share, neighbour_covariance, outcome_covariance
from sightline.motion.frames.hidden import hidden_directions, relative_covariance, without
from sightline.motion.frames.lens_field import LensField
from sightline.motion.frames.linear import linearise_frames
from sightline.motion.frames.noise import FrameNoise, GroundField, learn_noise
from sightline.motion.frames.passes import FrameOptions, PassState, _drifting, _weighed, lags_owned
from sightline.motion.frames.solve import FrameUnknowns, solve_frames, time_statics
from sightline.motion.statics import frame_statics

LAGS = (1, 2, 3)
PIXEL = 1.0 / pinholes.FOCAL
SCALE = np.array([PIXEL, PIXEL, 2.0 / (pinholes.SHAPE[1] - 1)])


def walk(count: int, seed: int = 1, step: float = 2e-3):
    return np.cumsum(np.random.default_rng(seed).normal(0.0, step, (count, 3)), axis=0)


def test_a_match_moves_with_attitude_and_height_as_in_a_pinhole():
    angles = np.zeros((3, 3))
    line = linearise_frames(pinholes.stars(angles), pinholes.cameras(3), Plane(), [])[0]
    partner = pinholes.stars(angles)[0].measured[:, 0]
    seen = line.present[:, 0]
    x = (partner[seen, 1] - (pinholes.SHAPE[1] - 1) / 2) * PIXEL
    y = (partner[seen, 0] - (pinholes.SHAPE[0] - 1) / 2) * PIXEL
    # (y, -x, 1) - w x (y, -x, 1), divided by its third component: px per rad of roll, pitch, yaw
    by_line = -np.stack([x * y, 1 + y * y, x], axis=1) * pinholes.FOCAL
    by_column = -np.stack([1 + x * x, x * y, -y], axis=1) * pinholes.FOCAL
    # kept as float32
    np.testing.assert_allclose(line.by_partner[seen, 0, 0], by_line, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(line.by_partner[seen, 0, 1], by_column, rtol=1e-5, atol=1e-3)
    # a point h higher is seen f B / H^2 h px further back from a base B further on
    base = pinholes.SPEED * pinholes.INTERVAL
    np.testing.assert_allclose(
        line.by_height[seen, 0, 0], -pinholes.FOCAL * base / pinholes.ALTITUDE**2, rtol=1e-4
    )
    np.testing.assert_allclose(line.by_height[seen, 0, 1], 0.0, atol=1e-9)


def test_attitudes_of_exact_matches_are_found_exactly():
    truth = walk(4)
    unknowns = FrameUnknowns(pinholes.cameras(4), ())
    found = solve_frames(pinholes.stars(truth), unknowns, Plane(), FrameNoise.start(LAGS))
    # the prior of 0.1 rad holds the badly seen constants back by (sigma / 0.1)^2 of themselves, some 1e-7 rad
    np.testing.assert_allclose(found.angles, truth, atol=1e-6)


def test_a_wrong_focal_length_and_wrong_times_are_found_with_the_attitudes():
    truth = walk(5, seed=3)
    nominal = pinholes.cameras(5, focal=1.02 * pinholes.FOCAL)
    names = [f"f{k}" for k in range(5)]
    statics = time_statics(names, [1e-4] * 5) + frame_statics(names, focal_length_sigma_px=100.0)
    found = solve_frames(
        pinholes.stars(truth),
        FrameUnknowns(nominal, tuple(statics)),
        Plane(),
        FrameNoise.start(LAGS),
        steps=8,
    )
    error = nominal[0].detector.focal_length_px + found.x[-1] - pinholes.FOCAL
    sigma = float(np.sqrt(found.covariance[-1, -1]))
    assert sigma < 0.2 * 0.02 * pinholes.FOCAL  # it was 2 % off
    assert abs(error) < 0.3 * sigma  # matches without noise: only the prior pulls


def test_the_covariance_is_that_of_everything_that_errs_carried_through_the_estimate():
    names = [f"f{k}" for k in range(4)]
    statics = frame_statics(names, focal_length_sigma_px=50.0, distortion_sigma=(0.1,))
    field = LensField(pinholes.SHAPE, 0.05, 120.0)
    unknowns = FrameUnknowns(pinholes.cameras(4), tuple(statics), field)
    relief = (GroundField(100.0, 300.0, 30e3, 50.0, 6e3), GroundField(0.0, 30.0, 30e3, 10.0, 6e3))
    noise = FrameNoise.start(LAGS, relief)
    found = solve_frames(pinholes.stars(walk(4)), unknowns, Plane(), noise, steps=2)
    carried = outcome_covariance(
        found.influence, noise, found.ground, np.linalg.inv(unknowns.prior_precision())
    )
    sigma = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(
        carried / np.outer(sigma, sigma), found.covariance / np.outer(sigma, sigma), atol=1e-6
    )


def test_windows_that_saw_something_else_lose_their_weight_and_only_they():
    truth = walk(4)
    stars = pinholes.stars(truth, rng=np.random.default_rng(2))
    moved = stars[1].measured.copy()
    both = [np.flatnonzero(np.isfinite(star.measured).all(axis=(1, 2))) for star in stars]
    cloud, drifting = both[1][[2, 7]], both[2][4]
    moved[cloud] += 4.0  # of noise of a tenth
    stars[1] = replace(stars[1], measured=moved)
    found = solve_frames(
        stars, FrameUnknowns(pinholes.cameras(4), ()), Plane(), FrameNoise.start(LAGS), steps=4
    )
    drift = [np.zeros(len(star.pixels), dtype=bool) for star in stars]
    drift[2][drifting] = True
    for given in (None, drift):
        weights = [star.weight for star in _weighed(stars, found, given)]
        assert weights[1][cloud].max() < 1e-3
        assert (weights[2][drifting] == 0.0).all() == (given is not None)
        weights[1][cloud] = weights[2][drifting] = np.nan
        seen = [np.isfinite(star.measured).all(axis=2) for star in stars]
        left = np.concatenate([line[rows] for line, rows in zip(weights, seen, strict=True)])
        # a match in a hundred is beyond three sigmas by chance
        left = left[np.isfinite(left)]
        assert len(left) > 50 and np.mean(left > 0.5) > 0.95


def test_what_windows_share_is_the_same_in_blocks_of_any_size(monkeypatch):
    unknowns = FrameUnknowns(pinholes.cameras(4), ())
    found = solve_frames(pinholes.stars(walk(4)), unknowns, Plane(), FrameNoise.start(LAGS), steps=2)
    whole = neighbour_covariance(found.influence, 0.5)
    pairs = []

    def counted(first, second, window):
        pairs.append(len(first) * len(second))
        return common_share(first, second, window)

    monkeypatch.setattr(errors, "common_share", counted)
    sigma = np.sqrt(np.diag(found.covariance))
    for held in (10_000, 1):
        pairs.clear()
        monkeypatch.setattr(errors, "HELD", held)
        apart = neighbour_covariance(found.influence, 0.5) - whole
        # sums in another order: some thousand terms of float64
        np.testing.assert_allclose(apart / np.outer(sigma, sigma), 0.0, atol=1e-12)
        most = max(len(star.pixels) * 4 for star in found.influence.stars)  # windows of one image
        assert len(pairs) > 4 and max(pairs) <= max(held, most)


def normalised_square(error, covariance) -> tuple[float, int]:
    """Error (n, 3) against its covariance (3n, 3n), in the directions that have one."""
    values, vectors = np.linalg.eigh(covariance)
    seen = values > 1e-9 * values.max()
    return float(((vectors.T @ error.ravel())[seen] ** 2 / values[seen]).sum()), int(seen.sum())


def test_errors_are_as_large_as_the_covariance_says():
    rng, truth = np.random.default_rng(5), walk(4, seed=2)
    unknowns = FrameUnknowns(pinholes.cameras(4), ())
    total, degrees = 0.0, 0
    for _ in range(40):
        found = solve_frames(
            pinholes.stars(truth, rng=rng), unknowns, Plane(), FrameNoise.start(LAGS), truth.ravel(), steps=2
        )
        directions, _ = hidden_directions(found.angle_covariance, np.arange(4.0), SCALE)
        left = relative_covariance(found.angle_covariance, directions, SCALE)
        error = without(found.angles - truth, directions, SCALE)
        square, number = normalised_square(
            error / SCALE, left / np.outer(np.tile(SCALE, 4), np.tile(SCALE, 4))
        )
        total, degrees = total + square, degrees + number
    # the covariance also owns the bias floor of a real matcher, which exact matches do not have
    low, high = chi2.ppf([1e-4, 1 - 1e-4], degrees)
    assert 0.5 * low < total < high


def test_unknown_terrain_is_owned_by_the_sigma_and_found_by_the_heights():
    truth = walk(4, seed=4)
    phase = np.random.default_rng(8).uniform(0, 2 * np.pi, (6, 2))
    waves = 2 * np.pi / np.geomspace(30e3, 120e3, 6)

    def terrain(points):
        return 200.0 * sum(np.sin(w * points + p).prod(axis=1) for w, p in zip(waves, phase, strict=True))

    unknowns = FrameUnknowns(pinholes.cameras(4), ())
    matches = pinholes.stars(truth, height=terrain)
    relief = (GroundField(300.0, 300.0, 30e3, 20.0, 6e3), GroundField(0.0, 1.0, 30e3, 1.0, 6e3))
    flat = solve_frames(matches, unknowns, Plane(), FrameNoise.start(LAGS))
    owned = solve_frames(matches, unknowns, Plane(), FrameNoise.start(LAGS, relief))
    pitch = slice(1, None, 3)
    assert np.diag(owned.angle_covariance)[pitch].sum() > np.diag(flat.angle_covariance)[pitch].sum()
    true = terrain(owned.ground[:, [1, 0]])
    seen = owned.fields[0].precision > 0
    # up to what attitude and terrain share: offset and slopes
    basis = np.column_stack([np.ones(seen.sum()), owned.ground[seen][:, :2]])
    left = [
        v - basis @ np.linalg.lstsq(basis, v, rcond=None)[0]
        for v in (true[seen], owned.fields[0].value[seen])
    ]
    assert np.corrcoef(*left)[0, 1] > 0.95


def test_pairs_of_one_lag_agree_with_chains_of_another_within_their_sigmas():
    rng, truth = np.random.default_rng(11), walk(6, seed=6)
    names = [f"f{k}" for k in range(6)]
    unknowns = FrameUnknowns(pinholes.cameras(6), tuple(frame_statics(names, focal_length_sigma_px=20.0)))
    total, degrees = 0.0, 0
    for _ in range(8):
        matches = pinholes.stars(truth, lags=(1, 3), rng=rng)
        found = solve_frames(matches, unknowns, Plane(), FrameNoise.start((1, 3)), steps=4)
        compared = closure(matches, found, Plane(), 3)
        square, number = normalised_square(compared.difference, compared.covariance)
        total, degrees = total + square, degrees + number
    low, high = chi2.ppf([1e-4, 1 - 1e-4], degrees)
    assert 0.5 * low < total < high  # the bias floor again
    with pytest.raises(InputError, match="no pairs of frames at lag 2"):
        closure(matches, found, Plane(), 2)


def turned_by_lag(angles, turns, rng):
    """Matches whose partners at each lag are seen by a body turned by (3,) rad more: its pixels move so."""
    out = []
    for star in pinholes.stars(angles, rng=rng):
        measured = star.measured.copy()
        for k, image in enumerate(star.images):
            points = pinholes.ground(measured[:, k], image, angles[image])
            measured[:, k] = pinholes.pixels(points, image, angles[image] + turns[image - star.hub])
        out.append(replace(star, measured=measured))
    return out


def owned(stars, count: int):
    """Attitudes of a pinhole, what lags disagree by owned or not; yaw, which tells as roll does, is known."""
    unknowns = FrameUnknowns(pinholes.cameras(count), (), attitude_sigma=1e-4, constant_sigma=1e-5)
    noise = FrameNoise(LAGS, 0.5 + 0.5 * np.eye(3), 0.0)  # drawn windows share no pixels
    found = solve_frames(stars, unknowns, Plane(), noise)
    return found, lags_owned(Plane(), PassState(found, tuple(stars)), np.full(3, PIXEL)).estimate


def test_what_all_pairs_of_one_lag_err_alike_is_owned_and_lags_that_agree_are_left_alone():
    truth, size = walk(9, step=1e-5), 0.03 * PIXEL
    taken, squares, before = 0, [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        turns = {lag: np.array([size * rng.standard_normal(), 0.0, 0.0]) for lag in LAGS}
        plain, found = owned(turned_by_lag(truth, turns, rng), 9)
        taken += found.unknowns.turns is not None
        last_less_first = np.zeros(27)
        last_less_first[24], last_less_first[0] = 1.0, -1.0  # of roll
        for one, out in ((found, squares), (plain, before)):
            sigma = np.sqrt(last_less_first @ one.angle_covariance @ last_less_first)
            out.append(float(last_less_first @ (one.angles - truth).ravel() / sigma) ** 2)
    assert taken >= 5
    # three lags tell little of their sigma: tails are Student's
    assert np.mean(before) > 10.0
    assert np.median(squares) < 2.0 and np.mean(squares) < 0.25 * np.mean(before)
    alone = [owned(pinholes.stars(truth, rng=np.random.default_rng(seed)), 9)[1] for seed in range(8)]
    # three axes at one in 100: more than 2 of 8 once in 700 such tests
    assert sum(one.unknowns.turns is not None for one in alone) <= 2


def test_the_error_model_is_learned_from_the_residuals():
    truth = walk(6, seed=7)
    matches = pinholes.stars(truth, sigma=0.03, rng=np.random.default_rng(0))
    claimed = [
        star.__class__(**{**vars(star), "covariance_px": star.covariance_px / 4.0}) for star in matches
    ]
    found = solve_frames(claimed, FrameUnknowns(pinholes.cameras(6), ()), Plane(), FrameNoise.start(LAGS))
    learned = learn_noise(found.stars, found.clean_px, found.explained(), LAGS, found.noise)
    # sigmas were claimed half as large as they are; the hub's noise is half of every error. About 150 windows
    # x 2 components x 5 hubs at lag 1: 3 % of a variance; at lag 3 fewer than half
    np.testing.assert_allclose(np.diag(learned.gamma), 4.0, rtol=0.2)
    assert learned.shared == pytest.approx(2.0, rel=0.2)


def test_a_free_lens_does_not_make_matches_look_better_than_they_are():
    # true sigmas, but a field of 130 numbers follows the errors of about 1000
    field = LensField(pinholes.SHAPE, 0.5, 60.0)
    matches = pinholes.stars(walk(6, seed=7), rng=np.random.default_rng(0))
    found = solve_frames(
        matches, FrameUnknowns(pinholes.cameras(6), (), field), Plane(), FrameNoise.start(LAGS), steps=2
    )
    taken = found.explained()
    learned = learn_noise(found.stars, found.clean_px, taken, LAGS, found.noise)
    looks = learn_noise(found.stars, found.clean_px, [0.0 * part for part in taken], LAGS, found.noise)
    # 400 errors at lag 1, 300 at lag 2: 7 and 8 % of a variance, times two
    np.testing.assert_allclose(np.diag(learned.gamma)[:2], 1.0, rtol=0.16)
    assert (np.diag(looks.gamma)[:2] < 0.84).all()


def test_lags_that_are_hardly_seen_take_the_level_of_the_others():
    matches = [part for star in pinholes.stars(walk(6), rng=np.random.default_rng(2)) if (part := star)]
    few = [star.with_weight(np.where(np.array(star.lags) == 3, 0.0, 1.0) * star.weight) for star in matches]
    found = solve_frames(
        few, FrameUnknowns(pinholes.cameras(6), ()), Plane(), FrameNoise.start(LAGS, scale=10.0)
    )
    learned = learn_noise(found.stars, found.clean_px, found.explained(), LAGS, found.noise)
    assert learned.gamma[2, 2] == pytest.approx(np.diag(learned.gamma)[:2].max(), rel=0.05)
    assert np.linalg.eigvalsh(learned.gamma).min() > 0


def test_constants_are_hidden_and_a_drift_only_where_its_sigma_stands_out():
    n = 6
    u = np.linspace(-1.0, 1.0, n)
    covariance = (0.01 * PIXEL) ** 2 * np.eye(3 * n)
    directions, names = hidden_directions(covariance, u, SCALE)
    assert names == ("constant of roll", "constant of pitch", "constant of yaw")
    loose = np.zeros((n, 3))
    loose[:, 1] = PIXEL * u
    directions, names = hidden_directions(covariance + np.outer(loose.ravel(), loose.ravel()), u, SCALE)
    assert names[-1] == "drift of pitch"
    left = relative_covariance(covariance + np.outer(loose.ravel(), loose.ravel()), directions, SCALE)
    assert np.sqrt(np.diag(left)).max() < 0.011 * PIXEL
    np.testing.assert_allclose(without(loose, directions, SCALE), 0.0, atol=1e-12)


def test_a_drift_is_hidden_by_what_is_left_of_its_own_axis():
    """Noise of 1, 5 and 0.2 hundredths of a px: a drift of 2 hundredths stands out of that of yaw alone."""
    n, u, scale = 6, np.linspace(-1.0, 1.0, 6), PIXEL * np.array([1.0, 1.3, 0.8])
    noise = np.array([0.01, 0.05, 0.002]) * scale
    covariance = np.diag(np.tile(noise**2, n))
    for axis in range(3):
        loose = np.zeros((n, 3))
        loose[:, axis] = 0.02 * scale[axis] * u
        covariance += np.outer(loose.ravel(), loose.ravel())
    _, names = hidden_directions(covariance, 3.0 + 0.4 * u, scale)
    assert names[3:] == ("drift of yaw",)


def test_a_lens_field_passes_through_its_nodes_and_learns_its_size():
    field = LensField((200, 300), 0.1, 60.0)
    np.testing.assert_allclose(field.weights(field.nodes), np.eye(len(field.nodes)), atol=1e-5)
    half = len(field.nodes)
    law = np.linalg.inv(field.prior_precision()[:half, :half])
    draw = np.linalg.cholesky(law + 1e-12 * np.eye(half)) @ np.random.default_rng(3).normal(size=(half, 2))
    learned = field.learned(3.0 * draw.T.ravel(), np.zeros((field.size, field.size)))
    # the mean square of 2 x half numbers scatters by 1 / sqrt(half)
    assert learned.sigma_px == pytest.approx(0.3, rel=2.0 / np.sqrt(half))


def test_no_match_at_all_is_an_error_that_says_what_to_check():
    empty = [star.with_weight(np.zeros_like(star.weight)) for star in pinholes.stars(walk(3))]
    with pytest.raises(EstimationError, match="check overlap, mount and times"):
        solve_frames(empty, FrameUnknowns(pinholes.cameras(3), ()), Plane(), FrameNoise.start(LAGS))


def test_windows_that_drift_beyond_the_limit_given_lie_on_clouds():
    drift = np.append(np.random.default_rng(3).standard_normal(400), [3.0, 6.0])
    field = SimpleNamespace(value=drift, precision=np.ones(402))
    estimate = SimpleNamespace(fields=(None, field), per_star=lambda far: [far])
    none = [np.zeros(402, dtype=bool)]
    (usual,) = _drifting(estimate, none, FrameOptions().drifting)
    assert np.flatnonzero(usual).tolist() == [401]
    (strict,) = _drifting(estimate, none, FrameOptions(drifting=2.5).drifting)
    assert strict[[400, 401]].all() and 2 <= strict.sum() < 20
