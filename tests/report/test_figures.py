"""What the figures draw is what the result holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sightline.evaluation.observed import observed
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import STATUS_NAMES
from sightline.report import match_figures, microvibration_figures, motion_figures, spectrum_figures
from sightline.report.marks import Line, Map, Points, Spans


@pytest.fixture
def result(recovery):
    return recovery.result


def test_the_right_scale_is_the_left_one_in_angles(result):
    figure = motion_figures.attitude_figure(result)
    for axis, panel in enumerate(figure.panels):
        factor, unit = panel.right
        assert factor == pytest.approx(result.scale[axis] * {"µrad": 1e6, "mrad": 1e3}[unit], rel=1e-12)


def test_the_motion_drawn_has_no_hidden_part(result):
    drawn = motion_figures.visible_motion_px(result)
    hidden = (result.hidden / result.scale[:, None]).reshape(drawn.size, -1)
    assert np.abs(hidden.T @ drawn.ravel()).max() < 1e-6 * np.abs(hidden).sum()


def test_a_few_frames_are_drawn_one_by_one_with_error_bars(result):
    rows = np.arange(0, 640, 64)
    few = replace(
        result,
        motion=Motion(result.motion.t[rows], result.motion.angles[rows], result.motion.covariance[rows]),
        absolute_sigma=result.absolute_sigma[rows],
        hidden=result.hidden[rows],
        observed=result.observed[rows],
    )
    drawn = motion_figures.attitude_figure(few)[0].named("roll ± 1 sigma")
    assert isinstance(drawn, Points) and len(drawn.sigma) == 10
    assert motion_figures.close_figure(few) is None


def test_lines_that_no_match_sees_are_shaded(result):
    observed = result.observed.copy()
    observed[100:120] = False
    figure = motion_figures.sigma_figure(replace(result, observed=observed))
    (shades,) = (mark for mark in figure.marks if isinstance(mark, Spans))
    assert (result.motion.t[100], result.motion.t[119]) in shades.spans


def test_matches_that_the_estimate_threw_out_are_shown_as_outliers(result):
    record = result.records[0]
    weight = record.star.weight.copy()
    weight[:5, 0] = 0.0
    thrown = replace(record, star=record.star.with_weight(weight))
    changed = replace(result, records=(thrown, *result.records[1:]))
    views = match_figures.pair_views(changed)
    figure = match_figures.status_figure(changed, views)
    assert {"outlier", "kept"} <= set(figure.keys())
    shown = figure[0].marks[0]
    assert dict(shown.names)["outlier"] == match_figures.STATUS_COLOURS[STATUS_NAMES.index("outlier")]
    names = np.array([name for name, _ in shown.names])[shown.z.ravel()]
    assert (names == "outlier").sum() >= 1


def test_the_map_of_residuals_has_the_residuals_of_its_pair(result):
    view = match_figures.pair_views(result)[0]
    record = result.records[view.index]
    figure = match_figures.residual_map_figure(result, view)
    maps = [mark for mark in figure.marks if isinstance(mark, Map)]
    assert len(maps) == 4
    kept = record.star.present[:, view.partner]
    across = np.where(kept, result.after_px[view.index][:, view.partner, 1], np.nan)
    np.testing.assert_allclose(maps[3].z.T, across.reshape(record.star.shape))


def test_pairs_matched_both_ways_are_drawn_once(result):
    seen = observed(result, np.linspace(1.0, 400.0, 50))
    assert any((b, a) in seen.blind for a, b in seen.blind)  # ends of later images, found in the first
    figure = spectrum_figures.visibility_figure(result, seen, result.image_names)
    rows = [mark.name for mark in figure[1].marks]
    assert len(rows) == len({frozenset(pair) for pair in seen.blind})


def test_a_tone_has_its_band_and_its_dots():
    tone = {
        "axis": "roll", "frequency": 40.0, "t": [0.1, 0.2], "amplitude_px": [0.2, 0.3],
        "sigma_px": 0.01, "steady_chance": 0.5,
    }  # fmt: skip
    band, line = microvibration_figures.tone_figure({"tones": [tone]})[0].marks
    np.testing.assert_allclose(band.high - band.low, 0.02)
    assert isinstance(line, Line) and line.dotted and line.name == "roll 40.0 Hz, steady"


@pytest.mark.parametrize(("largest", "log"), [(1.5, False), (5.0, True), (50.0, True)])
def test_the_scale_of_sigma_is_logarithmic_where_it_spans_much(result, largest, log):
    # of the first axis alone, so that the others do not rule
    sigma = np.outer(np.linspace(1.0, largest, len(result.sigma)), result.scale)
    changed = replace(result, absolute_sigma=np.full_like(sigma, np.inf))
    object.__setattr__(changed, "motion", replace(result.motion))
    covariance = np.einsum("ki,ij->kij", sigma**2, np.eye(3))
    motion = Motion(result.motion.t, result.motion.angles, covariance)
    figure = motion_figures.sigma_figure(replace(changed, motion=motion))
    assert figure[0].y.log == log
