"""What the figures draw is what the result holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sightline.evaluation.observed import observed
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import STATUS_NAMES
from sightline.report import match_figures, microvibration_figures, motion_figures, page, spectrum_figures


@pytest.fixture
def result(recovery):
    return recovery.result


def test_the_right_scale_is_the_left_one_in_angles(result):
    figure = motion_figures.attitude_figure(result)
    for axis, (left, right) in enumerate((("", 2), (3, 4), (5, 6))):
        px, angle = figure.layout[f"yaxis{left}"], figure.layout[f"yaxis{right}"]
        micro = {"µrad": 1e6, "mrad": 1e3}[angle.title.text]
        np.testing.assert_allclose(
            np.array(angle.range), np.array(px.range) * result.scale[axis] * micro, rtol=1e-12
        )
        # Zooming one of the two alone would make the other wrong.
        assert px.fixedrange and angle.fixedrange


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
    drawn = [curve for curve in motion_figures.attitude_figure(few).data if curve.name == "roll ± 1 sigma"]
    assert drawn[0].mode == "markers" and len(drawn[0].error_y.array) == 10
    assert motion_figures.close_figure(few) is None


def test_lines_that_no_match_sees_are_shaded(result):
    observed = result.observed.copy()
    observed[100:120] = False
    figure = motion_figures.sigma_figure(replace(result, observed=observed))
    shades = [(shape.x0, shape.x1) for shape in figure.layout.shapes]
    assert (result.motion.t[100], result.motion.t[119]) in shades


def test_matches_that_the_estimate_threw_out_are_shown_as_outliers(result):
    record = result.records[0]
    weight = record.star.weight.copy()
    weight[:5, 0] = 0.0
    thrown = replace(record, star=record.star.with_weight(weight))
    changed = replace(result, records=(thrown, *result.records[1:]))
    views = match_figures.pair_views(changed)
    figure = match_figures.status_figure(changed, views)
    keys = [curve.name for curve in figure.data if curve.type == "scatter"]
    assert "outlier" in keys and "kept" in keys
    shown = next(curve for curve in figure.data if curve.type == "heatmap")
    assert shown.zmax == len(STATUS_NAMES) - 0.5


def test_the_map_of_residuals_has_the_residuals_of_its_pair(result):
    view = match_figures.pair_views(result)[0]
    record = result.records[view.index]
    figure = match_figures.residual_map_figure(result, view)
    maps = [curve for curve in figure.data if curve.type == "heatmap"]
    assert len(maps) == 4
    kept = record.star.present[:, view.partner]
    across = np.where(kept, result.after_px[view.index][:, view.partner, 1], np.nan)
    np.testing.assert_allclose(np.asarray(maps[3].z).T, across.reshape(record.star.shape))


def test_pairs_matched_both_ways_are_drawn_once(result):
    seen = observed(result, np.linspace(1.0, 400.0, 50))
    assert any((b, a) in seen.blind for a, b in seen.blind)  # ends of later images, found in the first
    figure = spectrum_figures.visibility_figure(result, seen, result.image_names)
    rows = [trace.name for trace in figure.data if trace.mode == "markers"]
    assert len(rows) == len({frozenset(pair) for pair in seen.blind})


def test_a_band_of_few_points_is_drawn_without_dots():
    tone = {
        "axis": "roll", "frequency": 40.0, "t": [0.1, 0.2], "amplitude_px": [0.2, 0.3],
        "sigma_px": 0.01, "steady_chance": 0.5,
    }  # fmt: skip
    figure = microvibration_figures.tone_figure({"tones": [tone]})
    # left to itself, the library marks every point of a curve of fewer than twenty
    assert [trace.mode for trace in figure.data] == ["lines", "lines+markers"]


def test_no_curve_is_left_to_the_library_to_mark_or_not(recovery):
    for section in page.sections(recovery.result, recovery.summary):
        assert all(trace.mode for trace in section.figure.data if trace.type.startswith("scatter")), section


@pytest.mark.parametrize(("largest", "expected"), [(1.5, None), (5.0, "D1"), (50.0, "D2")])
def test_the_scale_of_sigma_has_more_than_one_tick(largest, expected):
    scale = motion_figures._sigma_scale(0.006 * np.array([1.0, largest]))
    assert scale.get("dtick") == expected and (scale["type"] == "linear") == (expected is None)
