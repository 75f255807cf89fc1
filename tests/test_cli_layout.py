"""``sightline layout``: the files, the words, and what a user may get wrong."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from tests.terminal_lines import PROGRESS, WARNING

from sightline.cli.main import run

TEXT = """
name = "<b>three</b> lines"
focal_length_px = 2e5
line_period = 1e-3
match_sigma_px = 0.03
detectors = 3
span_px = 60
duration = 1.0

[[layout]]
name = "ours"
positions_px = [0, 20, 50]
"""
BAND = ["--passband", "40", "150"]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("layout")
    (folder / "instrument.toml").write_text(TEXT)
    out = folder / "result"
    assert run(["layout", str(folder / "instrument.toml"), *BAND, "--out", str(out), "--count", "3"]) == 0
    return out


@pytest.fixture
def instrument(tmp_path):
    path = tmp_path / "instrument.toml"
    path.write_text(TEXT)
    return path


def test_the_table_holds_what_the_summary_says(done):
    assert sorted(entry.name for entry in done.iterdir()) == ["layouts.csv", "report.html", "summary.json"]
    with (done / "layouts.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    summary = json.loads((done / "summary.json").read_text())
    assert [int(row["rank"]) for row in rows] == list(range(1, len(rows) + 1))
    assert len(rows) == len(summary["ranked"])
    for row, entry in zip(rows, summary["ranked"], strict=True):
        seconds = np.array(row["positions_s"].split(), dtype=float)
        assert np.array(row["positions_px"].split(), dtype=float) == pytest.approx(1000.0 * seconds, abs=1e-5)
        assert float(row["worst_information"]) == pytest.approx(entry["worst_information"])
        assert float(row["sigma_px"]) == pytest.approx(entry["sigma_px"])
    worst = [float(row["worst_information"]) for row in rows]
    assert worst == sorted(worst, reverse=True)
    assert [entry["name"] for entry in summary["compared"]] == ["ours", "S1, fig. 13", "ZY-3", "ASTER SWIR"]
    assert len(summary["inputs"]["instrument.toml"]) == 64


def test_the_page_opens_without_an_error_and_asks_nobody_for_anything(done, open_page):
    opened, problems = open_page(done / "report.html")
    opened.wait_for_timeout(300)
    assert problems == [] and opened.locator("svg.drawn").count() == 4
    for width in (1200, 700):
        opened.set_viewport_size({"width": width, "height": 900})
        opened.wait_for_timeout(400)
        assert opened.evaluate("document.documentElement.scrollWidth") <= width


def test_the_page_says_what_was_found_and_shows_names_as_text(done):
    text = (done / "report.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;three&lt;/b&gt; lines" in text
    for words in (
        "In plain words",
        "best in the band",
        "ours",
        "Lags that go blind together",
        "no prior of the",
    ):
        assert words in text


def test_without_a_folder_the_ranked_layouts_are_printed(instrument, capsys):
    assert run(["layout", str(instrument), *BAND, "--count", "1"]) == 0
    said = capsys.readouterr()
    assert "(best in the band)" in said.out and "ASTER SWIR is blind at" in said.out
    assert all(line.startswith((WARNING, PROGRESS)) for line in said.err.splitlines())
    assert list(instrument.parent.iterdir()) == [instrument]


def test_the_summary_can_be_printed_and_the_file_checked(instrument, capsys):
    assert run(["layout", str(instrument), *BAND, "--count", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["passband"] == [40.0, 150.0]
    assert run(["check", str(instrument)]) == 0
    assert "3 detectors" in capsys.readouterr().out
    assert run(["check", str(instrument), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["highest_frequency"] == 500.0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--passband", "150", "40"], "must rise from a positive frequency, got 150 to 40 Hz"),
        (["--passband", "0", "40"], "must rise"),
        (["--passband", "40", "600"], "sample motion up to 500 Hz"),
        (["--passband", "40"], "--passband"),
        ([], "Missing option '--passband'"),
        ([*BAND, "--count", "0"], "--count"),
    ],
)
def test_wrong_words_are_one_clear_error(instrument, tmp_path, capsys, words, message):
    out = tmp_path / "result"
    assert run(["layout", str(instrument), *words, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    errors = [line for line in said.splitlines() if not line.startswith("sightline: warning: ")]
    assert len(errors) == 1 and message in errors[0] and not out.exists()


def test_a_missing_file_and_a_full_folder_are_refused(instrument, tmp_path, capsys):
    assert run(["layout", str(tmp_path / "none.toml"), *BAND, "--out", str(tmp_path / "x")]) == 2
    assert "none.toml: no such file" in capsys.readouterr().err
    assert run(["layout", str(instrument), *BAND, "--out", str(tmp_path)]) == 2
    assert "not empty" in capsys.readouterr().err and list(tmp_path.iterdir()) == [instrument]


def test_an_acquisition_is_not_taken_for_an_instrument(tmp_path, capsys):
    path = tmp_path / "acquisition.toml"
    path.write_text('[platform]\nkind = "level-flight"\n')
    assert run(["layout", str(path), *BAND]) == 2
    assert "this looks like a file for `sightline recover`" in capsys.readouterr().err
