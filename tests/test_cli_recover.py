"""`sightline recover` and `sightline demo`: all files or none, and the words around them."""

from __future__ import annotations

import importlib
import json
import math
import os
import pkgutil
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.terminal_lines import PROGRESS, WARNING

from sightline.cli import demo as demo_command
from sightline.cli.main import run
from sightline.errors import EstimationError
from sightline.io.results.line_of_sight import RESULT_FILES

#: No relief is sought: the heights of the scene are given.
FILES = sorted({*RESULT_FILES} - {"relief.csv"})


@pytest.fixture
def quick(recovery, monkeypatch):
    """Words of the command for the rendered strip; the estimate itself is that of `recovery`."""
    from sightline.applications import line_of_sight

    monkeypatch.setattr(line_of_sight, "recover_line_of_sight", lambda *_, **__: recovery.result)
    return ["recover", str(recovery.scene / "acquisition.toml"), "--out"]


def test_recover_writes_every_file_and_nothing_else(recovery):
    assert sorted(entry.name for entry in recovery.folder.iterdir()) == FILES


def test_the_json_is_the_summary(recovery):
    assert json.loads(recovery.printed)["matches"]["kept"] > 100


def test_without_json_three_axes_and_the_places_to_look_are_said(quick, tmp_path, capsys):
    out = tmp_path / "deep" / "result"
    assert run([*quick, str(out)]) == 0
    said = capsys.readouterr()
    lines = said.out.splitlines()
    assert [line.split()[0] for line in lines] == ["roll", "pitch", "yaw", "(after", "bands", "Pairs", "from"]
    assert str(out / "report.html") in lines[6]
    assert all(line.startswith((WARNING, PROGRESS)) for line in said.err.splitlines())


def test_a_recovery_scores_well_against_its_truth(recovery, capsys):
    assert run(["score", str(recovery.folder), str(recovery.scene / "truth.csv")]) == 0
    score = json.loads(capsys.readouterr().out)
    for axis in ("roll", "pitch", "yaw"):
        # 640 lines hold some 150 independent errors (effective_samples): the NEES of a true sigma scatters by
        # sqrt(2 / 150) = 0.12; five of these allow for sigma that is known to 10 % only on so short a strip.
        spread = 5.0 * math.sqrt(2.0 / score[axis]["effective_samples"]) + 0.2
        assert abs(score[axis]["nees"] - 1.0) < spread, score[axis]


def test_a_truth_in_degrees_or_with_gaps_or_that_is_the_result_itself_is_doubted(recovery, tmp_path, capsys):
    head, *rows = (recovery.scene / "truth.csv").read_text().splitlines()
    wrong = tmp_path / "truth.csv"
    for unit, per_rad in (("degrees", 180.0 / math.pi), ("urad", 1e6)):
        values = [[float(x) for x in row.split(",")] for row in rows]
        wrong.write_text(
            "\n".join([head, *(f"{t},{r * per_rad},{p * per_rad},{y * per_rad}" for t, r, p, y in values)])
        )
        assert run(["score", str(recovery.folder), str(wrong)]) == 0
        said = capsys.readouterr()
        assert json.loads(said.out)["roll"]["nees"] > 100.0  # the score is given all the same
        assert said.err.startswith(WARNING) and f"as if in {unit}; give roll, pitch, yaw in rad" in said.err
    assert run(["score", str(recovery.folder), str(recovery.folder / "motion.csv")]) == 0
    assert "the same angles as the result's" in capsys.readouterr().err
    wrong.write_text("\n".join([head, *rows[:40], *rows[60:]]))
    assert run(["score", str(recovery.folder), str(wrong)]) == 0
    assert re.search(r"\d+ of the 640 lines .* rows are up to 21 lines apart", capsys.readouterr().err)
    assert run(["score", str(recovery.folder), str(recovery.scene / "truth.csv")]) == 0
    assert capsys.readouterr().err == ""


@pytest.fixture(scope="module")
def short(tmp_path_factory) -> Path:
    """Two bands a small lag apart, of which a recovery of three passes after the first takes little."""
    scene = tmp_path_factory.mktemp("short") / "scene"
    size = ["--lines", "340", "--columns", "144"]
    assert run(["simulate", "line-of-sight", "--seed", "3", *size, "--out", str(scene)]) == 0
    toml = scene / "acquisition.toml"
    head, _, *two, last = toml.read_text().split("[[band]]")
    surface = last[last.index("[surface]") :]
    toml.write_text("[[band]]".join([head, *two]) + surface + "\n[matching]\npasses = 3\n")
    return scene


def stopped_after(passes: int, words: list[str], monkeypatch) -> None:
    """A run of the command that is ended when so many passes after the first are done."""
    from sightline.applications import line_of_sight

    go_on = line_of_sight._compensated_pass

    def some(strip, state, number, *more):
        if number == passes:
            raise KeyboardInterrupt
        return go_on(strip, state, number, *more)

    with monkeypatch.context() as patch:
        patch.setattr(line_of_sight, "_compensated_pass", some)
        assert run(words) == 130


def content(folder: Path) -> dict[str, object]:
    """All files of a result but the page, without what tells of the run itself."""
    found: dict[str, object] = {
        path.name: re.sub(rb"CREATION_DATE = \S+", b"", path.read_bytes())
        for path in folder.iterdir()
        if path.name not in ("report.html", "summary.json")
    }
    summary = json.loads((folder / "summary.json").read_text())
    return found | {key: summary[key] for key in summary if key not in ("wall_seconds", "peak_memory_bytes")}


def test_a_run_that_was_stopped_time_and_again_goes_on_to_the_same_bits(short, tmp_path, capsys, monkeypatch):
    from sightline.applications import line_of_sight

    def again(*_, **__):
        raise AssertionError("the first pass has been done before")

    out, whole = tmp_path / "out", tmp_path / "whole"
    command = ["recover", str(short / "acquisition.toml"), "--out"]
    assert run([*command, str(whole)]) == 0
    command.append(str(out))
    capsys.readouterr()
    # the words of the run that is stopped after so many passes; the last one ends
    for passes, words in enumerate(([], ["--resume"], [], ["--overwrite", "--resume"])):
        if passes == 3:
            assert run([*command, *words]) == 0
        else:
            stopped_after(passes, [*command, *words], monkeypatch)
        said = capsys.readouterr().err
        assert ("goes on from the finished stages" in said) == (passes == 2)
        if passes < 3:
            assert str(out / ".partial" / "stages") in said and "--resume" in said
            stages = [path.name for path in (out / ".partial" / "stages").iterdir()]
            assert stages == [f"pass-{passes}.stage.npz"]
        monkeypatch.setattr(line_of_sight, "_begin", again)
    assert not (out / ".partial").exists()
    assert content(out) == content(whole)


def test_a_run_that_was_stopped_after_its_last_pass_knows_its_windows(short, tmp_path, monkeypatch):
    from sightline.applications import line_of_sight

    def finer(options, bands, stars):
        return replace(options, window=(2, options.window[1]), step=2)

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(line_of_sight, "finer_rows", finer)
    command, out = ["recover", str(short / "acquisition.toml"), "--out"], tmp_path / "out"
    assert run([*command, str(tmp_path / "whole")]) == 0
    with monkeypatch.context() as patch:
        patch.setattr(line_of_sight, "judged", stop)
        assert run([*command, str(out)]) == 130
    # nothing is left to decide by: what was matched is told by the stage
    monkeypatch.setattr(line_of_sight, "finer_rows", stop)
    assert run([*command, str(out), "--resume"]) == 0
    assert content(out) == content(tmp_path / "whole")


def test_a_run_of_listed_features_that_was_stopped_goes_on_to_the_same_bits(short, tmp_path, monkeypatch):
    # stages keep arrays, numbers and texts: features, by image, are none of these
    scene = tmp_path / "scene"
    shutil.copytree(short, scene)
    toml = scene / "acquisition.toml"
    names = re.findall(r'\[\[band\]\]\nname = "(\w+)"', toml.read_text())
    rows = [
        f"{name},{line},{column}" for name in names for line in range(340) for column in range(12, 144, 24)
    ]
    (scene / "features.csv").write_text("\n".join(["image,line,column", *rows]) + "\n")
    toml.write_text(toml.read_text() + 'select = "listed"\nfeatures = "features.csv"\n')
    command, out = ["recover", str(toml), "--out"], tmp_path / "out"
    assert run([*command, str(tmp_path / "whole")]) == 0
    stopped_after(1, [*command, str(out)], monkeypatch)
    assert run([*command, str(out), "--resume"]) == 0
    assert content(out) == content(tmp_path / "whole")


def test_what_check_finds_suspicious_is_said_once_also_where_nothing_is_recovered(
    recovery, quick, tmp_path, capsys, monkeypatch
):
    from sightline.applications import line_of_sight

    scene, out = shutil.copytree(recovery.scene, tmp_path / "scene"), tmp_path / "out"
    (scene / "f.csv").write_text("image,line,column\nPAN,3,3\nPAN,9999,3\n")
    toml = scene / "acquisition.toml"
    toml.write_text(f'{toml.read_text()}\n[matching]\nselect = "listed"\nfeatures = "f.csv"\n')
    said = f"{scene / 'f.csv'}: 1 of 2 features lie outside their images"
    assert run([quick[0], str(toml), "--out", str(out)]) == 0
    assert capsys.readouterr().err.count(said) == 1
    assert sum(said in words for words in json.loads((out / "summary.json").read_text())["warnings"]) == 1

    def fails(*_: object, **__: object) -> None:
        raise EstimationError("nothing matches")

    monkeypatch.setattr(line_of_sight, "recover_line_of_sight", fails)
    assert run([quick[0], str(toml), "--out", str(tmp_path / "none")]) != 0
    lines = capsys.readouterr().err.splitlines()
    assert said in lines[-2] and "nothing matches" in lines[-1]


@pytest.mark.parametrize("other", ["options", "images"])
def test_passes_of_another_acquisition_or_other_options_are_refused_or_passed_over(
    short, tmp_path, capsys, monkeypatch, other
):
    scene = tmp_path / "scene"
    shutil.copytree(short, scene)
    toml, out = scene / "acquisition.toml", tmp_path / "out"
    command = ["recover", str(toml), "--out", str(out)]
    stopped_after(0, command, monkeypatch)
    if other == "options":
        command += ["--method", "wiener"]
    else:
        (scene / "B1.tif").touch()
        os.utime(scene / "B1.tif", (1.0, 1.0))
    capsys.readouterr()
    finished = (out / ".partial" / "stages" / "pass-0.stage.npz").read_bytes()
    assert run([*command, "--resume"]) == 2
    said = capsys.readouterr().err
    assert said.count("error:") == 1 and "--resume cannot go on from it" in said
    assert (out / ".partial" / "stages" / "pass-0.stage.npz").read_bytes() == finished
    # without the word it begins anew
    stopped_after(0, command, monkeypatch)
    said = capsys.readouterr().err
    assert "pass-0.stage.npz is passed over, it is of other images, options or another version" in said


def test_resume_where_nothing_waits_simply_runs(quick, tmp_path, capsys):
    assert run([*quick, str(tmp_path / "out"), "--resume"]) == 0
    assert sorted(entry.name for entry in (tmp_path / "out").iterdir()) == FILES


@pytest.mark.parametrize(
    ("error", "status"), [(KeyboardInterrupt(), 130), (MemoryError(), 1), (ValueError("x"), 70)]
)
def test_what_fails_in_the_last_step_leaves_nothing(quick, tmp_path, capsys, monkeypatch, error, status):
    from sightline.report.page import Page

    def fails(*_):
        raise error

    monkeypatch.setattr(Page, "write", fails)
    out = tmp_path / "result"
    assert run([*quick, str(out)]) == status
    said = capsys.readouterr()
    errors = [line for line in said.err.splitlines() if not line.startswith(PROGRESS)]
    assert said.out == "" and len(errors) == 1
    assert not out.exists()


def test_a_failed_run_over_an_older_result_keeps_the_older_result(quick, tmp_path, capsys, monkeypatch):
    import sightline.io.results as folder
    from sightline.io.results import line_of_sight as results

    for module in pkgutil.iter_modules(folder.__path__):  # else one could keep the function that fails
        importlib.import_module(f"{folder.__name__}.{module.name}")
    out = tmp_path / "result"
    assert run([*quick, str(out)]) == 0
    before = (out / "motion.csv").read_bytes()
    monkeypatch.setattr(results, "write_json", lambda *_: 1 / 0)
    assert run([*quick, str(out), "--overwrite"]) == 70
    assert sorted(entry.name for entry in out.iterdir()) == FILES
    assert (out / "motion.csv").read_bytes() == before


def test_overwriting_leaves_no_file_of_the_earlier_result_and_every_other_file(
    quick, recovery, tmp_path, capsys
):
    scene, out = shutil.copytree(recovery.scene, tmp_path / "scene"), tmp_path / "result"
    assert run([*quick, str(out)]) == 0
    (out / "notes.txt").write_text("keep")
    toml = scene / "acquisition.toml"
    text = toml.read_text(encoding="utf-8").replace('epoch = "2026-01-01T00:00:00Z"\n', "")
    toml.write_text(text, encoding="utf-8")
    assert run(["recover", str(toml), "--out", str(out), "--overwrite"]) == 0
    # without an epoch there is no CCSDS file, and that of the first acquisition must not stay
    expected = sorted({*FILES, "notes.txt"} - {"attitude.aem"})
    assert sorted(entry.name for entry in out.iterdir()) == expected


def test_a_folder_with_files_is_refused_and_left_as_it_is(quick, tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("keep")
    assert run([*quick, str(tmp_path)]) == 2
    assert "holds notes.txt" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_the_demo_ends_with_the_score_and_where_the_report_is(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(demo_command, "LINES", 360)
    monkeypatch.setattr(demo_command, "COLUMNS", 160)
    out = tmp_path / "demo"
    assert run(["demo", "--out", str(out)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in said[1:4]] == ["roll", "pitch", "yaw"]
    # what was left out of these is said, and the error with it
    unseen = "a constant of roll, pitch and yaw, a drift of roll, pitch and yaw (with a {})"
    # of so short a strip the roll of a drift of yaw is a parabola to some 90 to 95 %: there the words change;
    # beside it stands a fiftieth as much of pitch, hardly named or hardly not
    shapes = ("parabola of roll", "curve of roll", "curve of roll and a curve of pitch")
    assert any(f"{unseen.format(shape)}, unseen by images, left out" in said[0] for shape in shapes)
    assert [line.split()[0] for line in said[4:7]] == ["roll", "pitch", "yaw"]
    assert all("error of the whole angle" in line for line in said[4:7])
    reports = [line.split()[1] for line in said if line.startswith("report")]
    assert reports == [str(out / "result" / "report.html"), str(out / "tdi" / "report.html")]
    assert json.loads((out / "tdi" / "summary.json").read_text())["motion"]["lines"] >= 64
    for report in reports:
        page = Path(report).read_text(encoding="utf-8")
        assert 5e4 < len(page) < 1e6
        assert ("the truth, which the estimate never saw" in page) == ("result" in report)
    assert set(json.loads((out / "score.json").read_text())) >= {"roll", "pitch", "yaw"}
