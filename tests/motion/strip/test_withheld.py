"""Pairs left out of the estimate: which may be, and whether what is predicted of them is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.ndimage import map_coordinates
from scipy.special import chdtrc
from scipy.stats import chi2

from motion.strips import strip_cameras
from sightline.applications.line_of_sight import joint_line_of_sight, ready_strip
from sightline.errors import InputError
from sightline.execution import silent
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Band
from sightline.motion.strip import slow_errors
from sightline.motion.strip.normal_equations import GroundOrder, modelled, window_rows
from sightline.motion.strip.strip import RecoverOptions
from sightline.motion.strip.withheld import (
    LEAST_WINDOWS,
    WithheldAxis,
    _worth,
    compared,
    contradictions,
    judged,
    unjudged,
)
from sightline.simulate.scenarios import line_of_sight_case

NAMES = ("B", "G", "R")


def plain_bands(names=NAMES) -> list[Band]:
    """Bands of one geometry whose images nobody matches."""
    cameras = strip_cameras(tuple(30.0 * k for k in range(len(names))), 120, 64)
    return [Band(n, ArrayImage(np.zeros((120, 64))), c) for n, c in zip(names, cameras, strict=True)]


@pytest.mark.parametrize(
    ("names", "pairs", "withhold", "said"),
    [
        (NAMES, (), ("B", "X"), "no band 'X'; bands are: B, G, R"),
        (NAMES, (), ("G", "G"), "a pair is of two bands"),
        (NAMES[:2], (), ("B", "G"), "three bands or more are needed"),
        (NAMES, (("B", "G"), ("G", "R")), ("R", "G"), "the only link between R and B, G"),
        (NAMES, (("B", "G"), ("G", "R")), ("B", "G"), "the only link between B and G, R"),
    ],
)
def test_a_pair_that_nothing_would_predict_cannot_be_left_out(names, pairs, withhold, said):
    options = RecoverOptions(pairs=pairs, withhold=(withhold,))
    with pytest.raises(InputError, match=f"^--withhold {withhold[0]} {withhold[1]}: .*{said}"):
        ready_strip(plain_bands(names), Plane(), (), None, None, options)


def test_of_several_pairs_all_must_be_predicted_together():
    two = RecoverOptions(withhold=(("B", "G"), ("R", "G")))
    with pytest.raises(InputError, match="only link"):
        ready_strip(plain_bands(), Plane(), (), None, None, two)


@pytest.fixture(scope="module")
def solved():
    """A rendered strip of three bands, recovered without B and R compared."""
    case = line_of_sight_case("nominal", 3, lines=500, columns=320)
    bands = [replace(band, name=name) for band, name in zip(case.as_given(), NAMES, strict=False)]
    options = RecoverOptions(passes=2, withhold=(("B", "R"),))
    strip, options = ready_strip(bands, Plane(0.0), (), None, None, options)
    strip, state, result = joint_line_of_sight(strip, options, 0.0, silent)
    return strip, options, state, result


def test_the_pair_takes_no_part(solved):
    _, _, state, _ = solved
    pairs = {frozenset((r.star.hub, k)) for r in state.records for k in r.star.images}
    assert pairs == {frozenset((0, 1)), frozenset((1, 2))}


def test_what_is_predicted_of_the_pair_is_what_it_shows(solved):
    found = solved[3].withheld
    assert [(one.pair, one.axis, one.asked) for one in found] == [
        (("B", "R"), "along", True),
        (("B", "R"), "across", True),
    ]
    for one in found:
        assert LEAST_WINDOWS < one.samples <= one.count
        # the strip's own windows tell their sigma to 10 %; of chance's share, once in a thousand
        low, high = chi2.ppf([5e-4, 1.0 - 5e-4], one.samples) / one.samples
        assert low / 1.2 < one.nees < high * 1.2
        # of a sigma a tenth too small .926 lie within 1.96 of them; of so few once in a thousand fewer
        inside = 1.0 - chdtrc(1.0, (1.96 / 1.1) ** 2)
        assert one.coverage > inside - 3.1 * np.sqrt(inside * (1.0 - inside) / one.samples)
        assert one.rms_px == pytest.approx(one.sigma_px * one.nees**0.5, rel=0.2)


def test_an_estimate_that_is_wrong_is_found_out(solved):
    strip, options, state, result = solved
    places = {p.name: k for k, p in enumerate(strip.parameters)}
    off = state.estimate.statics.copy()
    off[places["R offset across"]] += 3.0 * result.withheld[1].sigma_px
    wrong = replace(state, estimate=replace(state.estimate, statics=off))
    along, across = judged(strip, wrong, options)
    # a shift by three sigmas adds nine to the mean square
    assert across.nees > 6.0 and across.coverage < 0.5
    assert along.nees == pytest.approx(result.withheld[0].nees, rel=0.3)


def test_without_being_asked_pairs_that_were_matched_through_a_third_band_are_looked_at(recovery):
    result = recovery.result
    names = result.image_names
    assert {one.pair for one in result.withheld} <= {
        (a, b) for k, a in enumerate(names) for b in names[k + 1 :] if k
    }
    assert result.withheld and not any(one.asked for one in result.withheld)
    squares = sum(one.nees * one.samples for one in result.withheld)
    samples = sum(one.samples for one in result.withheld)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], samples) / samples
    assert low / 1.2 < squares / samples < high * 1.2
    assert recovery.summary["withheld"][0]["pair"] == list(result.withheld[0].pair)


@pytest.fixture(scope="module")
def unlike():
    """A panchromatic band and two colours of pixels four times as large, recovered in two passes."""
    case = line_of_sight_case(
        "nominal", 3, lines=1200, columns=480, lags=(0.0, 0.15, 0.1574), pixel_ratios=(1.0, 4.0, 4.0),
        names=("PAN", "B", "R"), gains=(1.0, 0.9, 0.8), gammas=(1.0, 1.0, 1.0), snr=100.0,
    )  # fmt: skip
    strip, options = ready_strip(case.as_given(), Plane(0.0), (), None, None, RecoverOptions(passes=2))
    strip, state, result = joint_line_of_sight(strip, options, 0.0, silent)
    return strip, options, state, result


def test_pairs_of_unlike_pixels_are_looked_at_on_the_grid_of_the_coarser(unlike):
    strip, options, state, result = unlike
    assert {one.pair for one in result.withheld} == {("PAN", "R")}
    for one in result.withheld:
        low, high = chi2.ppf([5e-4, 1.0 - 5e-4], one.samples) / one.samples
        assert one.samples > LEAST_WINDOWS and low / 1.2 < one.nees < high * 1.2
    # whichever is named first
    there, back = (
        compared(strip, state, options, p, 60, found_cameras(strip, state)) for p in ((0, 2), (2, 0))
    )
    assert (there.star.hub, there.star.images) == (back.star.hub, back.star.images) == (2, (0,))
    assert np.array_equal(there.error_px, back.error_px, equal_nan=True)


def test_a_pair_that_was_asked_for_and_judges_nothing_is_named():
    axis = WithheldAxis(("B", "R"), "along", 50, 50.0, 1.0, 0.95, 0.02, 0.02, 0.01, True)
    assert unjudged((("R", "B"),), (axis,)) == unjudged((), ()) == ()
    (said,) = unjudged((("R", "B"), ("G", "B")), (axis,))
    assert said.startswith("--withhold G B: fewer than 10 windows")


def dense_variance(state, rows, beside) -> np.ndarray:
    """Of what rows read, by the dense inverse of data and prior."""
    data, grid = state.estimate._data, state.estimate.grid
    band = state.prior.precision_columns(0, 3 * grid.count, 3)
    n, q = data.border.shape
    whole = np.zeros((n + q, n + q))
    for part in (data.ab.whole(), band):
        for below, diagonal in enumerate(part):
            place = np.arange(n - below)
            whole[place + below, place] += diagonal[: n - below]
    whole = np.tril(whole) + np.tril(whole, -1).T
    whole[:n, n:], whole[n:, :n] = data.border, data.border.T
    wander = [] if state.slow is None else [state.slow.precision]
    whole[n:, n:] = data.corner + block_diag(np.diag(1.0 / state.prior.statics_sigma**2), *wander)
    unit = 1.0 / np.sqrt(np.diag(whole))
    both = np.concatenate([rows.toarray(), beside], axis=1) * unit
    return np.einsum("ri,ij,rj->r", both, np.linalg.inv(whole * np.outer(unit, unit)), both)


def found_cameras(strip, state):
    return strip.cameras(state.estimate.nodes, state.estimate.statics)


def test_rows_read_what_the_estimate_models_and_their_variance_is_that_of_the_dense_inverse(solved):
    strip, options, state, _ = solved
    star = compared(strip, state, options, (0, 2), 40, found_cameras(strip, state)).star
    which = np.flatnonzero(star.present[:, 0])
    rng = np.random.default_rng(0)
    # as of TDI: instants beside those of the windows count more or less
    uneven = 0.1 * rng.standard_normal((*star.t.shape, 2, 2, 3, 3)).astype(np.float32)
    uneven *= np.nanmax(np.abs(star.by_hub))
    star = replace(star, uneven=uneven, uneven_at=1e-3 * np.arange(-1.0, 2.0))
    rows, statics = window_rows(star, strip.grid, 3, GroundOrder(), which)
    nodes = 1e-5 * rng.standard_normal((strip.grid.count, 3))
    values = rng.standard_normal(len(strip.parameters))
    expected = modelled(star, strip.grid, nodes, values)[which, 0].ravel()
    # sensitivities are float32
    np.testing.assert_allclose(rows @ nodes.ravel() + statics @ values, expected, atol=1e-5)
    dense = dense_variance(state, rows, statics)
    np.testing.assert_allclose(state.estimate.row_variance(rows, statics), dense, rtol=1e-4)


@pytest.fixture(scope="module")
def wandering():
    """The same strip, of which R shows its ground up to .1 px off along lines, alike over whole rows."""
    case = line_of_sight_case("nominal", 3, lines=500, columns=320)
    bands = [replace(band, name=name) for band, name in zip(case.as_given(), NAMES, strict=False)]
    lines, columns = np.indices(bands[2].image.shape, dtype=float)
    # of a period that no lag (15, 300 and 315 lines) is a multiple of
    lines += 0.1 * np.sin(2.0 * np.pi * lines / 500.0)
    moved = map_coordinates(bands[2].image.array.astype(float), [lines, columns], order=5, mode="nearest")
    bands[2] = replace(bands[2], image=ArrayImage(moved))
    options = RecoverOptions(passes=2, withhold=(("B", "R"),))
    strip, options = ready_strip(bands, Plane(0.0), (), None, None, options)
    with pytest.MonkeyPatch.context() as patch:
        # rows of three windows do not tell by themselves that they err alike
        patch.setattr(slow_errors, "lasts", lambda star, post: True)
        strip, state, result = joint_line_of_sight(strip, options, 0.0, silent)
    return strip, options, state, result


def test_errors_that_wander_are_part_of_what_is_predicted(wandering):
    strip, options, state, result = wandering
    along, across = result.withheld
    for one in (along, across):
        low, high = chi2.ppf([5e-4, 1.0 - 5e-4], one.samples) / one.samples
        assert low / 1.2 < one.nees < high * 1.2
    # a prediction without them leaves up to .07 px rms beside the .02 px of a window; nothing moved across
    without, unmoved = judged(strip, replace(state, slow=None), options)
    assert without.nees > 3.0 and without.coverage < 0.8
    assert unmoved.rms_px == pytest.approx(across.rms_px, rel=0.05)


def test_what_wanders_has_its_part_in_the_variance_of_a_prediction(wandering):
    strip, options, state, _ = wandering
    star = compared(strip, state, options, (0, 2), 40, found_cameras(strip, state)).star
    which = np.flatnonzero(star.present[:, 0])
    rows, beside = window_rows(star, strip.grid, 3, state.ground, which, state.slow)
    errors = 0.1 * np.random.default_rng(1).standard_normal(state.slow.count * state.slow.each)
    read = beside[:, -len(errors) :] @ errors
    moved = state.slow.moved(star, state.ground.of(star.t_hub), errors)
    np.testing.assert_allclose(read, moved[which, 0].ravel(), atol=1e-6)
    dense = dense_variance(state, rows, beside)
    np.testing.assert_allclose(state.estimate.row_variance(rows, beside), dense, rtol=1e-4)


def test_a_pair_that_contradicts_its_prediction_beyond_chance_is_warned_of():
    axis = WithheldAxis(("A", "B"), "along", 240, 200.0, 1.2, 0.93, 0.05, 0.045, 0.01, False)
    # chi-square of 200 is above 2.6 x 200 once in 4e29, of 10 above 26 once in 270
    few = replace(axis, nees=2.6, samples=10.0)
    assert contradictions([axis, few, replace(axis, nees=0.3)]) == ()
    (said,) = contradictions([axis, replace(axis, nees=2.6), few])
    assert (
        said.startswith("A–B, which the estimate did not use") and "NEES 2.6" in said and "1.6 times" in said
    )
    assert "TDI" not in said
    assert all("TDI stages" in one for one in contradictions([replace(axis, nees=2.6)], tdi=True))
    assert "do not feel" not in said
    (said,) = contradictions([replace(axis, nees=2.6)], sensors=True)
    assert "sensors on the body do not feel" in said


def test_windows_that_err_alike_are_worth_fewer():
    rng = np.random.default_rng(1)
    alone = rng.standard_normal((800, 3))
    rho = 0.8
    alike = np.empty_like(alone)
    alike[0] = alone[0]
    for k in range(1, len(alone)):
        alike[k] = rho * alike[k - 1] + np.sqrt(1.0 - rho**2) * alone[k]
    assert _worth(alone) > 0.85 * alone.size
    # sum of rho^2k over all k, of which twelve rows hold 99 %; the correlations are known to some 5 %
    expected = alike.size * (1.0 - rho**2) / (1.0 + rho**2)
    assert _worth(alike) == pytest.approx(expected, rel=0.2)
