"""Noise from one scene, on strips whose law is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline

from imaging.raw_strip import RawStripOptions, simulate_raw_strip, two_step_table
from sightline.applications.detector_noise import detector_noise, strip_image_noise
from sightline.errors import EstimationError, InputError
from sightline.imaging.noise_estimation import (
    Blocks,
    CodeTable,
    column_pattern,
    even_noise,
    fit_law,
    measure_blocks,
    ramp_noise,
    resting_noise,
    white_noise,
)
from sightline.imaging.strip_noise import (
    EDGES,
    StripPixels,
    conversion_bound,
    estimate_strip_noise,
    gain_bound,
    noise_figures,
)

OPTIONS = RawStripOptions(lines=2000, gain=4e-6)
SEEDS = range(4)


def pixels_of(s):
    """What an estimate reads of a simulated strip."""
    return StripPixels(
        s.table, s.image, s.buffer, s.dark, s.reverse, s.reverse_buffer, s.reverse_dark, s.ramp
    )


@pytest.fixture(scope="module")
def strips():
    """(strip, noise) by seed."""
    found = []
    for seed in SEEDS:
        s = simulate_raw_strip(seed, OPTIONS)
        found.append((s, estimate_strip_noise(pixels_of(s))))
    return found


def test_every_estimate_is_as_good_as_its_sigma_says(strips):
    errors = {}
    for strip, noise in strips:
        s = noise.white.signal
        truth = column_pattern(np.tile(strip.response, (100, 1)), edges=EDGES).variance.value
        for name, estimate, true in (
            ("C", noise.buffer.pooled, OPTIONS.read),
            ("white", noise.white.variance, OPTIONS.gain * s * s + OPTIONS.shot * s + OPTIONS.read**2),
            ("slope", noise.white.slope, 2.0 * OPTIONS.gain * s + OPTIONS.shot),
            ("ramp", noise.ramp.shot, OPTIONS.shot),
            ("masked", noise.dark_shot, OPTIONS.shot),
            ("A", noise.law.estimate(0), OPTIONS.gain),
            ("B", noise.law.estimate(1), OPTIONS.shot),
            ("A_col", noise.columns.variance, truth),
        ):
            errors.setdefault(name, []).append((estimate.value - true) / estimate.sigma)
    # mean square of 4 standard normal numbers: above 3.7 once in 200 tries, below 0.016 as rarely, and there
    # are 8 names; validation/real_noise.py pools 30 strips
    nees = {name: float(np.mean(np.square(z))) for name, z in errors.items()}
    assert 0.016 < min(nees.values()) and max(nees.values()) < 3.7, nees
    # and of all 32 (correlated in groups) neither far above 1 nor far below
    assert 0.3 < np.mean(list(nees.values())) < 2.0, nees


def test_estimates_are_worth_having(strips):
    for _, noise in strips:
        assert noise.buffer.pooled.sigma < 0.05 * noise.buffer.pooled.value
        assert noise.white.variance.sigma < 0.1 * noise.white.variance.value
        assert noise.columns.variance.sigma < 0.3 * noise.columns.variance.value


def test_bounds_hold(strips):
    for _, noise in strips:
        s = noise.white.signal
        true = OPTIONS.gain * s * s + OPTIONS.shot * s + OPTIONS.read**2
        assert noise.white.bound.upper() > true
        assert gain_bound(noise, 1.0 / OPTIONS.shot) > OPTIONS.gain
        assert conversion_bound(noise) < 1.0 / OPTIONS.shot
        # what is left of the scene is within the bound, so the bound is above the estimate
        assert noise.white.bound.value > noise.white.variance.value


def test_the_first_and_the_last_line_without_charge_tell_nothing(strips):
    strip, noise = strips[0]
    reverse = {name: getattr(strip, name).copy() for name in ("reverse", "reverse_buffer", "reverse_dark")}
    for codes in reverse.values():
        codes[[0, -1]] = 200  # some 6,000 DN
    spoilt = estimate_strip_noise(pixels_of(replace(strip, **reverse)))
    # what is left is the mean of what was written there: to a step of 18 DN over 18 lines, of 5 sigmas
    np.testing.assert_allclose(spoilt.level, OPTIONS.level + 0.5 * OPTIONS.drift, atol=8.0)
    for name in ("level", "percentiles", "ceiling"):
        np.testing.assert_array_equal(getattr(spoilt, name), getattr(noise, name))
    for name in ("dark_signal", "dark_shot", "offsets"):
        assert getattr(spoilt, name) == getattr(noise, name)


def test_a_law_in_electrons_is_that_of_the_sum(strips):
    strip, noise = strips[0]
    image = strip_image_noise("strip", pixels_of(strip), 64)
    found = detector_noise([image], stages=64, electrons_per_dn=20.0)
    assert found.law.shot == 1.0 and found.law.read == 0.0
    # C by all that is known is within its sigma of that of the empty pixels
    assert found.law.output == pytest.approx(20.0 * noise.buffer.pooled.value, rel=0.03)
    # 64 lines of s / 64 with a gain noise A each have 64 A (s / 64)^2: as A / 64 of the sum
    assert found.law.gain / 64 == pytest.approx(noise.law.estimate(0).value)
    printed = [str(f) for f in noise_figures(noise, 64, 20.0)]
    assert all("+-" in line or "<=" in line or ">=" in line for line in printed)
    assert [str(f) for f in noise_figures(noise, 64)] == printed[:-4]
    for stages, conversion in ((0, 20.0), (64, 0.0), (64, np.nan)):
        with pytest.raises(InputError, match="above 0"):
            detector_noise([image], stages=stages, electrons_per_dn=conversion)


def test_noise_below_the_step_is_found_and_below_what_codes_show_refused():
    rng = np.random.default_rng(2)
    table = two_step_table()
    level = 1050.0 + 40.0 * np.linspace(0.0, 1.0, 3000)[:, None] + rng.uniform(-9.0, 9.0, 8)

    def coded(sigma):
        values = level + sigma * rng.standard_normal(level.shape)
        return np.searchsorted(table.lower[1:], values, side="right").astype(np.uint8)

    # a third of the step of 18
    found = resting_noise(coded(6.0), table).pooled
    assert abs(found.value - 6.0) < 3.0 * found.sigma < 0.6
    # a twentieth: plateaus of the level explain the codes as well
    for codes in (coded(0.9), np.full((3000, 2), 14, dtype=np.uint8)):
        with pytest.raises(EstimationError, match="below about a fifth of the step"):
            resting_noise(codes, table)
    with pytest.raises(EstimationError, match="lines with values"):
        resting_noise(np.full((100, 2), 14, dtype=np.uint8), table)


def test_a_pattern_of_the_scene_is_not_the_columns():
    rng = np.random.default_rng(3)
    # each part of the strip has streaks of its own, as large as the columns' pattern
    streaks = np.repeat(1e-3 * rng.standard_normal((20, 200)), 50, axis=0)
    response = 1.0 + 1e-3 * rng.standard_normal(200)
    found = column_pattern(4000.0 * (1.0 + streaks) * response)
    true = column_pattern(np.tile(response, (100, 1))).variance.value
    assert abs(found.variance.value - true) < 3.0 * found.variance.sigma < 0.5 * true
    assert found.single == pytest.approx(2.0 * true, rel=0.3)


def test_a_fit_gives_the_law_back_with_its_covariance():
    signals = np.array([500.0, 2000.0, 4000.0, 8000.0])
    rows = np.stack([signals**2, signals, np.ones(4)], axis=1)
    true = np.array([4e-6, 0.05, 13.0])
    sigma = 0.01 * rows @ true
    rng = np.random.default_rng(4)
    found = [
        fit_law(rows, rows @ true + sigma * rng.standard_normal(4), np.diag(sigma**2)) for _ in range(400)
    ]
    scatter = np.cov(np.array([f.coefficients for f in found]).T)
    # a variance of 400 draws is known to sqrt(2 / 400) = 7 %
    assert np.diag(scatter) == pytest.approx(np.diag(found[0].covariance), rel=0.25)
    with pytest.raises(EstimationError, match="do not separate"):
        fit_law(rows[:1], [1.0], [[1.0]])
    with pytest.raises(EstimationError, match="have no inverse"):
        fit_law(rows, rows @ true, np.zeros((4, 4)))


def test_what_cannot_be_estimated_is_refused():
    flat = np.full((400, 200), 4000.0)
    with pytest.raises(InputError, match="lines and columns are needed"):
        measure_blocks(flat[:50], flat[:50])
    with pytest.raises(EstimationError, match="blocks with values"):
        white_noise(measure_blocks(flat, np.zeros_like(flat)))
    with pytest.raises(EstimationError, match="rising signal"):
        ramp_noise(np.full((6, 50), np.nan), np.zeros((6, 50)), 1.0)
    with pytest.raises(InputError, match="columns are needed"):
        column_pattern(flat[:, :40])
    with pytest.raises(InputError, match="do not rise"):
        CodeTable(np.array([0.0, 5.0]), np.array([10.0, 15.0]))
    with pytest.raises(InputError, match="stands for no value"):
        CodeTable(np.array([0.0, 5.0]), np.array([0.0, 15.0]))


def test_evenly_rough_ground_is_refused_or_owned():
    # white ground: no place is rougher than another, and nothing tells it from noise
    rng = np.random.default_rng(5)
    white = 4000.0 + 15.0 * rng.standard_normal((1500, 256))
    try:
        found = white_noise(measure_blocks(white, np.zeros_like(white)))
    except EstimationError as error:
        assert "roughness" in str(error)
    else:
        assert abs(found.variance.value - 225.0) < 4.0 * found.variance.sigma


def test_an_evenly_lit_image_gives_its_law_and_slope():
    rng = np.random.default_rng(8)
    signal = rng.uniform(1000.0, 3000.0, (40, 50))
    # squares of some 500 degrees of freedom each, about 200 + 0.05 signal
    white = (200.0 + 0.05 * signal) * rng.chisquare(500, signal.shape) / 500
    found = even_noise(Blocks(signal, white, np.zeros(signal.shape)))
    assert found.slope.value == pytest.approx(0.05, abs=4.0 * found.slope.sigma)
    assert found.variance.value == pytest.approx(200.0 + 0.05 * found.signal, abs=4.0 * found.variance.sigma)
    # 300 +- 19 each, 2000 of them; the slope over signals of 577 rms
    assert found.variance.sigma == pytest.approx(19.0 / np.sqrt(2000), rel=0.1)
    assert found.slope.sigma == pytest.approx(19.0 / np.sqrt(2000) / 577.0, rel=0.1)


def test_roughness_that_does_not_last_from_block_to_block_is_refused():
    rng = np.random.default_rng(9)
    white, texture = rng.chisquare(20, (2, 60, 60))
    with pytest.raises(EstimationError, match="does not last"):
        white_noise(Blocks(np.full((60, 60), 1000.0), white, texture))


def test_lines_without_values_before_the_first_change_no_noise():
    rng = np.random.default_rng(10)
    edges = 18.0 * np.arange(60)
    table = CodeTable(np.append(np.nan, edges[:-1]), np.append(np.nan, edges[1:]))  # code 0 is no value
    level = 500.0 + 40.0 * np.linspace(0.0, 1.0, 4000)[:, None] + 9.0 * rng.standard_normal((4000, 6))
    codes = (1 + np.floor(level / 18.0)).astype(np.uint8)
    found = resting_noise(codes, table)
    late = resting_noise(np.concatenate([np.zeros((3000, 6), np.uint8), codes]), table)
    assert found.pooled.value == pytest.approx(9.0, abs=4.0 * found.pooled.sigma)
    assert late.pooled.value == pytest.approx(found.pooled.value, rel=1e-6)
    assert late.level[3000:] == pytest.approx(found.level, rel=1e-6)


def test_noise_at_rest_is_what_a_spline_leaves_by_its_degrees_of_freedom():
    """Codes of 0.6 of a step: their middles less a spline of least squares, which takes 15 of 400."""
    rng, n, pieces = np.random.default_rng(12), 400, 12
    edges = 2.0 * np.arange(200)
    table = CodeTable(edges[:-1], edges[1:])
    x = np.linspace(0.0, 1.0, n)
    values = 200.0 + 30.0 * np.sin(4.0 * x)[:, None] + 1.2 * rng.standard_normal((n, 10))
    codes = np.floor(values / 2.0).astype(np.uint8)
    knots = np.concatenate([np.zeros(4), np.arange(1, pieces) / pieces, np.ones(4)])
    left = 2.0 * codes + 1.0 - make_lsq_spline(x, 2.0 * codes + 1.0, knots)(x)
    # rounding adds a twelfth of a step squared
    expected = np.sqrt((left**2).sum(axis=0) / (n - pieces - 3) - 2.0**2 / 12.0)
    found = resting_noise(codes, table, pieces)
    # Either tells each sigma to 5 % (it is said), from the same codes. Without what the spline takes they are
    # 1.9 % less; a third of that is left for half its square and for what likelihood makes better of codes.
    assert np.mean([one.value for one in found.each] / expected) == pytest.approx(1.0, abs=0.006)
    # of one column alone it is its own, but for the allowance's bias of 1.5 %
    alone = resting_noise(codes[:, :1], table, pieces).pooled
    assert alone.value == pytest.approx(found.each[0].value, rel=1e-9)
    assert alone.sigma == pytest.approx(np.hypot(found.each[0].sigma, 0.015 * alone.value), rel=1e-6)


@pytest.mark.parametrize("steps", [0.7, 1.0, 3.0])
def test_noise_at_rest_of_a_step_and_more_is_found(steps):
    rng, edges = np.random.default_rng(13), 2.0 * np.arange(200)
    values = (
        200.0 + 30.0 * np.linspace(0.0, 1.0, 1000)[:, None] + 2.0 * steps * rng.standard_normal((1000, 8))
    )
    found = resting_noise(np.floor(values / 2.0).astype(np.uint8), CodeTable(edges[:-1], edges[1:]))
    # a column tells it to 1 / sqrt(2000); the allowance's bias is 1.5 %
    assert [one.value for one in found.each] == pytest.approx(
        np.full(8, 2.0 * steps), rel=4.0 / 2000**0.5 + 0.03
    )
    assert abs(found.pooled.value - 2.0 * steps) < 3.0 * found.pooled.sigma
    # steps of the code are noise beside it, a twelfth of their square (Sheppard), which leaves less to tell
    own = np.full(8, 2.0 * steps * (1.0 + 1.0 / 12.0 / steps**2) / 2000**0.5)
    assert [one.sigma for one in found.each] == pytest.approx(own, rel=0.1 + 3.0 / 2000**0.5)
