"""Long curves and large maps: what is cut away must not be what one would look for."""

from __future__ import annotations

import numpy as np

from sightline.report.reduce import cell_edges, cell_means, cell_modes, outline_rows, runs


def test_the_outline_of_a_long_curve_keeps_every_spike():
    y = np.sin(np.linspace(0.0, 3000.0, 100_000))
    y[[777, 50_001]] = 9.0, -9.0
    rows = outline_rows(np.linspace(0.0, 900.0, 100_000), y)
    assert len(rows) <= 2 * 901 + 2 and (np.diff(rows) > 0).all()
    assert {0, 777, 50_001, 99_999} <= set(rows.tolist())


def test_the_outline_keeps_gaps_and_what_is_between_them():
    y = np.zeros(5000)
    y[2000:2003] = np.nan
    y[2001] = 7.0
    rows = outline_rows(np.linspace(0.0, 100.0, 5000), y)
    assert {2000, 2001, 2002} <= set(rows.tolist())


def test_a_short_curve_and_one_that_turns_back_are_left_whole():
    assert outline_rows(np.arange(50.0), np.zeros(50)).tolist() == list(range(50))
    turn = np.linspace(0.0, 6.0, 5000)
    assert len(outline_rows(np.cos(turn), np.sin(turn))) == 5000


def test_cells_share_all_rows_between_them():
    edges = cell_edges(1003, 100)
    assert edges[0] == 0 and edges[-1] == 1003 and len(edges) == 101
    assert set(np.diff(edges).tolist()) == {10, 11}
    assert cell_edges(7, 100).tolist() == list(range(8))


def test_means_leave_out_what_is_missing():
    values = np.array([[1.0, np.nan], [3.0, np.nan], [np.nan, 5.0]])
    means = cell_means(values, np.array([0, 2, 3]))
    np.testing.assert_array_equal(means, [[2.0, np.nan], [np.nan, 5.0]])


def test_the_most_frequent_answer_of_a_cell_is_shown():
    codes = np.array([[0, 3], [0, 3], [6, 0], [7, 7]], dtype=np.uint8)
    assert cell_modes(codes, np.array([0, 3, 4]), 8).tolist() == [[0, 3], [7, 7]]


def test_runs_are_found_at_both_ends():
    assert runs(np.array([True, False, True, True])) == [(0, 0), (2, 3)]
    assert runs(np.zeros(3, dtype=bool)) == []
