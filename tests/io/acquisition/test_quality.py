"""Predicted quality of columns as weights of their matches."""

from __future__ import annotations

import pytest
from numpy.testing import assert_allclose

from sightline.errors import FormatError
from sightline.io.acquisition.quality import LEAST, read_match_sigma


def table(tmp_path, text):
    path = tmp_path / "quality.csv"
    path.write_text(text)
    return path


def test_sigma_falls_with_mtf_and_snr_on_its_own_axis(tmp_path):
    path = table(tmp_path, "column,mtf_x,mtf_y,snr\n0,0.2,0.1,50\n2,0.1,0.1,50\n4,0.2,0.1,100\n")
    found = read_match_sigma(path, 5)
    # along lines (first) by mtf_y, along columns by mtf_x; the best is 1; between columns worth is linear
    assert_allclose(1.0 / found, [[0.5, 0.5], [0.5, 0.375], [0.5, 0.25], [0.75, 0.625], [1.0, 1.0]])


def test_signals_of_a_choice_weigh_alike(tmp_path):
    rows = [(c, s, m, m, k * s) for c, m in ((0, 0.2), (1, 0.1)) for s, k in ((1.0, 1.0), (1000.0, 1.0))]
    text = "column,signal,mtf_x,mtf_y,snr\n" + "\n".join(",".join(map(str, row)) for row in rows)
    assert_allclose(read_match_sigma(table(tmp_path, text), 2), [[1.0, 1.0], [2.0, 2.0]])


def test_hopeless_columns_keep_a_little(tmp_path):
    path = table(tmp_path, "column,mtf_x,mtf_y,snr\n0,0.2,0.2,100\n1,1e-6,0.2,100\n")
    assert read_match_sigma(path, 2)[1].tolist() == [1.0, 1.0 / LEAST]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("column,mtf_x,mtf_y,snr\n0,0.2,0.2,0\n", "snr is 0 at column 0 .*above 0 is allowed"),
        ("column,mtf_x,mtf_y,snr\n0,-0.2,0.2,9\n", "mtf_x is -0.2 at column 0"),
        # both negative: their product would be positive
        ("column,mtf_x,mtf_y,snr\n0,0.2,0.2,9\n3,0.2,-0.2,-9\n", "mtf_y is -0.2 at column 3"),
        ("column,mtf_x,mtf_y,snr\n2,1000,0.2,9\n", r"mtf_x is 1000 at column 2 \(1 such.*above 0 to 1, at"),
        ("column,mtf_x,mtf_y,snr\n2,1_000,0.2,9\n", "line 2, column 'mtf_x': '1_000' is not a number"),
        ("column,mtf_x,mtf_y,snr\n9,0.2,0.2,9\n", "do not lie in an image of 5 columns"),
        ("column,mtf_x,snr\n0,0.2,9\n", "column 'mtf_y' is missing"),
        ("column,mtf_x,mtf_y,snr\n0,nan,0.2,9\n", "'mtf_x' is nan"),
    ],
)
def test_wrong_tables_are_named(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read_match_sigma(table(tmp_path, text), 5)
