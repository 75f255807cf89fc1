"""``sightline score``: files to numbers."""

import json

import numpy as np
import pytest

from sightline.cli.main import run
from sightline.io.formats.tables import TRUTH, MotionTable, write_columns, write_motion
from sightline.io.results.hidden import write_hidden


@pytest.fixture
def result(tmp_path):
    """A result whose error is noise of the stated sigma and a motion that its summary declares hidden."""
    rng = np.random.default_rng(0)
    t = 5e-4 * np.arange(4000)
    truth = 1e-5 * np.stack([np.sin(2 * t), np.cos(2 * t), t], axis=1)
    sigma = np.tile([5e-8, 1e-7, 4e-5], (4000, 1))
    hidden = np.zeros((4000, 3, 4))
    hidden[:, :, :3] = np.eye(3)
    hidden[:, 2, 3], hidden[:, 0, 3] = t, -0.005 * t**2
    error = sigma * rng.standard_normal((4000, 3)) + hidden @ np.array([1e-6, 2e-6, 3e-6, 1e-4])
    folder = tmp_path / "result"
    folder.mkdir()
    write_motion(folder / "motion.csv", MotionTable(t, truth + error, sigma))
    names = ["constant roll", "constant pitch", "constant yaw", "drift yaw"]
    entry = write_hidden(folder, t, hidden, names)
    summary = {"ifov": 5e-6, "half_field_px": 499.5, "hidden_directions": entry}
    (folder / "summary.json").write_text(json.dumps(summary))
    columns = dict(zip(TRUTH, [t, *truth.T], strict=True))
    write_columns(tmp_path / "truth.csv", columns, dict.fromkeys(TRUTH, "%.17g"))
    return folder


def test_score_prints_errors_in_px_and_an_honest_nees_as_json(result, capsys):
    assert run(["score", str(result), str(result.parent / "truth.csv")]) == 0
    score = json.loads(capsys.readouterr().out)
    assert score["lines"] == 4000
    assert score["hidden_directions_removed"][3] == "drift yaw"
    assert score["left_out"] == [
        "constant roll", "constant pitch", "constant yaw", "drift yaw (with a parabola of roll)",
    ]  # fmt: skip
    # 4000 white samples: rms and sigma to 1.1 % (4 sd: 5 %), NEES to 2.2 % (4 sd: 9 %).
    assert score["roll"]["rms"] == pytest.approx(0.01, rel=0.05)
    assert score["pitch"]["rms"] == pytest.approx(0.02, rel=0.05)
    assert score["yaw"]["rms"] == pytest.approx(4e-5 * 499.5, rel=0.05)
    for axis in ("roll", "pitch", "yaw"):
        assert score[axis]["nees"] == pytest.approx(1.0, abs=0.09)
        assert score[axis]["coverage_95"] == pytest.approx(0.95, abs=0.015)


def test_a_result_without_a_summary_is_scored_in_microradians(result, capsys):
    (result / "summary.json").unlink()
    assert run(["score", str(result), str(result.parent / "truth.csv")]) == 0
    score = json.loads(capsys.readouterr().out)
    assert score["yaw"]["unit"] == "urad"
    # The drift of yaw is not forgiven: 100 urad/s over 2 s, beside 40 urad of noise (known to 1.1 %).
    assert score["yaw"]["rms"] == pytest.approx(np.hypot(200.0 / np.sqrt(12.0), 40.0), rel=0.03)


def test_a_table_without_sigmas_is_refused(result, capsys):
    truth = result.parent / "truth.csv"
    (result / "motion.csv").write_text(truth.read_text())
    assert run(["score", str(result), str(truth)]) == 2
    assert "no sigma columns" in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["nodir", "."], ids=["no such folder", "no result in it"])
def test_a_folder_that_recover_did_not_write_is_named(result, capsys, folder):
    place = result.parent / folder
    assert run(["score", str(place), str(result.parent / "truth.csv")]) == 2
    said = capsys.readouterr().err
    assert f"{place}: DIR must be a folder that `recover`, `orient` or `georeference` wrote" in said
    assert "(motion.csv, orientation.csv or poses.csv is missing)" in said


def test_a_missing_truth_is_named_and_not_looked_for_in_a_toml_file(result, capsys):
    assert run(["score", str(result), "nope.csv"]) == 2
    said = capsys.readouterr().err
    assert "nope.csv: no such truth file" in said and "TOML" not in said


def test_a_table_is_printed_on_a_terminal_and_json_elsewhere(result, capsys, monkeypatch):
    words = ["score", str(result), str(result.parent / "truth.csv")]
    assert run(words) == 0
    score = json.loads(capsys.readouterr().out)
    assert run([*words, "--table"]) == 0
    table = capsys.readouterr().out
    assert run([*words, "--table", "--json"]) == 2
    assert "give one of them" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert run(words) == 0
    assert capsys.readouterr().out == table
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == score
    lines = table.splitlines()
    assert lines[0].split() == ["lines", "rms", "max", "sigma", "NEES", "in", "95", "%"]
    for line, axis in zip(lines[1:4], ("roll", "pitch", "yaw"), strict=True):
        name, *numbers = line.removeprefix("hidden left out (4000)").split()
        assert name == axis and line.endswith(score[axis]["unit"])
        printed = [float(number.rstrip("%")) for number in numbers[:5]]
        assert printed[:3] == pytest.approx([score[axis][key] for key in ("rms", "max", "sigma")], rel=5e-3)
        assert printed[3] == pytest.approx(score[axis]["nees"], abs=5e-3)
        assert printed[4] == pytest.approx(100.0 * score[axis]["coverage_95"], abs=0.5)
    assert "drift yaw (with a parabola of roll)" in lines[4]
