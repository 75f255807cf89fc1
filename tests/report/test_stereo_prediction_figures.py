"""Figures of a stereo plan: every table and change is drawn, in the units that the axes name."""

from __future__ import annotations

import numpy as np

from sightline.applications.stereo_prediction import Improvement, SigmaTable
from sightline.report.stereo_prediction_figures import (
    ARCSEC,
    improvements_figure,
    prediction_figure,
    prediction_rows,
)


def table(quantity="baseline", unit="m", planned=500e3):
    values = planned * np.array([0.5, 1.0, 2.0])
    sigmas = np.arange(1.0, 1.0 + 2 * 3 * 6).reshape(2, 3, 6) * ARCSEC
    sigmas[1, 0, 2] = np.inf
    return SigmaTable(
        quantity, unit, values, planned, ("ml-track", "ml-pair"), sigmas, 2.0 * sigmas.max(axis=2), "moved"
    )


def test_every_table_has_a_panel_in_its_own_units():
    figure = prediction_figure([table(), table("shots", "", 64), table("attitude noise", "rad", 10 * ARCSEC)])
    assert [panel.title for panel in figure.panels] == [
        "baseline, planned 500 km", "shots, planned 64", "attitude noise, planned 10 arcsec", "",
    ]  # fmt: skip
    # three axes and the weakest direction, by two estimators, and where the plan is
    assert [len(panel.marks) for panel in figure.panels] == [9, 9, 9, 0]
    roll = figure[0, 0].marks[0]
    assert "roll" in roll.name and len(figure.keys()) == 9
    np.testing.assert_allclose(roll.x, [250.0, 500.0, 1000.0])
    np.testing.assert_allclose(roll.y, [4.0, 10.0, 16.0])  # the worse of both cameras, arcsec
    panel = figure[0, 0]
    assert panel.x.log and panel.y.log and panel.x.title == "baseline (km)"
    assert figure.html("figure-a").count('class="panel"') == 3


def test_what_is_not_observable_is_a_gap_and_a_word():
    figure = prediction_figure([table()])
    yaw = next(mark for mark in figure.marks if mark.name.startswith("yaw, points new"))
    assert np.isnan(yaw.y[0]) and np.isfinite(yaw.y[1:]).all()
    head, rows = prediction_rows(table())
    assert head[0] == "baseline (km)" and len(head) == 1 + 2 * 4
    assert rows[0][7] == "not observable" and rows[1][0] == "500"
    assert rows[1][1:4] == ["10", "11", "12"]


def test_changes_are_bars_relative_to_now():
    change = Improvement(
        "half the noise", np.arange(1.0, 7.0) * ARCSEC, np.array([0.5, 0.6, np.nan, 0.7, 0.4, np.nan])
    )
    figure = improvements_figure([change])
    roll, pitch, yaw, now = figure.marks
    assert [mark.name for mark in (roll, pitch, yaw, now)] == ["roll", "pitch", "yaw", "now"]
    assert roll.length[0] == 0.7 and pitch.length[0] == 0.6 and np.isnan(yaw.length[0])
    assert roll.texts == ["4″"]
