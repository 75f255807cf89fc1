import json
from pathlib import Path

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.io.results.hidden import read_hidden, read_summary, write_hidden


def test_hidden_directions_come_back_from_their_table(tmp_path):
    rng = np.random.default_rng(0)
    hidden = rng.standard_normal((30, 3, 2))
    entry = write_hidden(tmp_path, np.arange(30.0), hidden, ["constant roll", "drift yaw"])
    (tmp_path / "summary.json").write_text(json.dumps({"hidden_directions": entry}))
    found, names = read_hidden(tmp_path, read_summary(tmp_path), 30)
    assert names == ("constant roll", "drift yaw")
    assert found == pytest.approx(hidden, rel=1e-8)


def test_directions_written_straight_into_the_summary_are_read():
    drift = [0.0, 1.0, 2.0]
    listed = [{"name": "constant", "roll": 1.0}, {"name": "drift", "yaw": drift, "roll": [0.0, 0.5, 2.0]}]
    found, names = read_hidden(Path("DIR"), {"hidden_directions": listed}, 3)
    assert names == ("constant", "drift")
    assert found[:, 0, 0].tolist() == [1.0, 1.0, 1.0]
    assert found[:, 2, 1].tolist() == drift
    assert found[:, 1].tolist() == [[0.0, 0.0]] * 3


def test_a_summary_that_lists_none_gives_none(tmp_path):
    assert read_summary(tmp_path) == {}
    assert read_hidden(tmp_path, {}, 5) is None
    none, names = read_hidden(tmp_path, {"hidden_directions": {"table": "hidden.csv", "names": []}}, 5)
    assert none.shape == (5, 3, 0) and names == ()


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("drift", "neither a list nor a table"),
        ({"table": "hidden.csv"}, "names of directions are expected"),
        (
            {"table": "hidden.csv", "names": ["drift"]},
            r"hidden\.csv: no such file; .* run the command that wrote it again",
        ),
        ([{"name": "drift", "yaw": [1.0, 2.0]}], "'yaw' must be 5 finite numbers"),
        ([{"name": "drift", "yaw": "x"}], "'yaw' must be 5 finite numbers"),
    ],
)
def test_another_form_is_refused_with_what_is_expected(tmp_path, entry, message):
    with pytest.raises(FormatError, match=message):
        read_hidden(tmp_path, {"hidden_directions": entry}, 5)


def test_a_table_of_another_length_is_refused(tmp_path):
    entry = write_hidden(tmp_path, np.arange(4.0), np.ones((4, 3, 1)), ["constant"])
    with pytest.raises(FormatError, match=r"4 rows for the 5 lines of motion\.csv"):
        read_hidden(tmp_path, {"hidden_directions": entry}, 5)


def test_a_summary_that_is_no_json_is_refused(tmp_path):
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(FormatError, match=r"summary\.json: not valid JSON"):
        read_summary(tmp_path)
