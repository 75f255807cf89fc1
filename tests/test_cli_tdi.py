"""``sightline tdi``: the files, the words, and what a user may get wrong."""

from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest

import sightline
from sightline.applications import tdi_lines
from sightline.cli.main import run
from sightline.stages import Stages
from sightline.tdi import choose

TEXT = """
name = "<b>five</b> columns"
[grid]
stages = { from = 3, to = 64 }
integration_ratio = [0.4, 0.8, 1.0]
[head]
stages = 2
integration_ratio = 0.5
[noise]
gain = 9e-6
read = 12.0
[columns]
table = "columns.csv"
[signals]
from = 10
to = 1000
count = 5
[mtf]
frequencies = [0.5, 0.5]
aperture_x = 0.9
aperture_y = 0.9
diffusion_sigma_px = 0.2
optics_mtf = 0.35
"""
COLUMNS = """column,scan_velocity,slip
0,1.0,-0.03
1,1.0,-0.015
2,1.0,0.0
3,1.001,0.015
7,0.999,0.03
"""
FILES = [
    "choice.csv", "report.html", "summary.json",
    "table.bin", "table.c", "table.h", "table.hex", "table_segments.bin",
]  # fmt: skip


@pytest.fixture
def toml(tmp_path):
    (tmp_path / "columns.csv").write_text(COLUMNS)
    path = tmp_path / "tdi.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tdi")
    (folder / "columns.csv").write_text(COLUMNS)
    (folder / "tdi.toml").write_text(TEXT)
    out = folder / "result"
    assert run(["tdi", str(folder / "tdi.toml"), "--out", str(out)]) == 0
    return out


def rows_of(folder):
    with (folder / "choice.csv").open() as stream:
        return list(csv.DictReader(stream))


def test_the_rows_are_the_contract(done):
    assert sorted(entry.name for entry in done.iterdir()) == FILES
    rows = rows_of(done)
    assert list(rows[0]) == "column signal stages integration_ratio mtf_x mtf_y snr merit limit".split()
    assert [row["column"] for row in rows] == [str(c) for c in (0, 1, 2, 3, 7) for _ in range(5)]
    assert [float(row["signal"]) for row in rows[:5]] == pytest.approx(np.geomspace(10, 1000, 5), rel=1e-9)
    for row in rows:
        assert 3 <= int(row["stages"]) <= 64 and row["integration_ratio"] in ("0.4", "0.8", "1")
        product = float(row["mtf_x"]) * float(row["mtf_y"]) * float(row["snr"])
        assert float(row["merit"]) == pytest.approx(product, rel=1e-7)
        assert row["limit"] == "none"
    # the more a column slips, the fewer stages serve it
    by_column = [int(row["stages"]) for row in rows[4::5]]
    assert by_column[2] == 64 and by_column[0] < by_column[1] < 64 and by_column[4] < by_column[3] < 64


def test_the_summary_says_what_other_ways_would_lose(done):
    summary = json.loads((done / "summary.json").read_text())
    assert summary["columns"] == 5 and summary["signals"] == 5 and summary["settings"] == 62 * 3
    assert summary["limits"] == {"none": 25} and summary["infeasible"] == 0
    ways = {way["name"]: way for way in summary["other_ways"]}
    assert ways["one setting from the centre column"]["worst_loss"] > 0.5
    assert 0.0 <= ways["one signal for all scenes"]["mean_loss"] < 0.05
    assert set(summary["inputs"]) == {"tdi.toml", "columns.csv"}


def test_the_table_says_what_the_choice_says(done):
    summary = json.loads((done / "summary.json").read_text())["table"]
    assert summary["holds"] and summary["certified_loss"] <= summary["max_loss"] == 0.005
    assert summary["bytes"] == (done / "table.bin").stat().st_size
    table = sightline.TdiTable.read(done)
    assert table.certified_loss == summary["certified_loss"]
    rows = rows_of(done)
    # the detector's own columns: 4 to 6 are not named, the nearest stands for each
    words = table.lookup(np.repeat(np.geomspace(10, 1000, 5)[:, None], 8, axis=1))
    stages, ratio = table.unpack(words)
    for k, column in enumerate((0, 1, 2, 3, 7)):
        for s in range(5):
            row = rows[5 * k + s]
            # within the table's loss of the best: near its optimum merit falls as the square of the change
            assert abs(stages[s, column] - int(row["stages"])) <= 0.15 * int(row["stages"])
            assert abs(ratio[s, column] - float(row["integration_ratio"])) <= 0.2 + 1e-9


def test_what_the_patents_form_would_lose_is_reported_last(done):
    warnings = json.loads((done / "summary.json").read_text())["warnings"]
    said = "the form of EP2733929 would lose up to"
    assert warnings[-1].startswith(said) and not any(said in warning for warning in warnings[:-1])
    page = (done / "report.html").read_text(encoding="utf-8")
    minded = page[page.index("Mind before using the numbers") : page.index('id="settings"')]
    assert "EP2733929" not in minded
    assert said[1:] in page[page.index('id="comparison"') :]


def test_what_decided_is_drawn_where_a_limit_did(toml, tmp_path, done):
    drawn = 'aria-labelledby="figure-limits-title"'
    page = (done / "report.html").read_text(encoding="utf-8")
    assert drawn not in page and "Kt is the time that a stage integrates" in page[: page.index("<nav")]
    toml.write_text(TEXT + "[choice]\nsnr_min = 30\nfull_well_sum = 20000\n")
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert drawn in page
    # where no setting meets a limit the maps are struck through
    settings = page[page.index('id="settings"') : page.index('id="quality"')]
    assert "no setting meets all limits; the safest one is used" in settings
    assert set(json.loads((tmp_path / "out" / "summary.json").read_text())["limits"]) > {"none"}


def test_a_jump_between_neighbouring_columns_is_reported(tmp_path, capsys):
    # in step at one column, slipping by a cycle over some 20 stages at the next
    (tmp_path / "columns.csv").write_text("column,scan_velocity,slip\n0,1.0,0.0\n1,1.0,0.05\n")
    path = tmp_path / "tdi.toml"
    path.write_text(TEXT)
    assert run(["tdi", str(path), "--no-pictures", "--out", str(tmp_path / "near")]) == 0
    said = capsys.readouterr().err
    assert "stages jump by more than a factor of 2" in said and "columns 0 and 1" in said
    assert "hysteresis" in said and "max_step" in said


def test_hysteresis_is_reported(toml, tmp_path):
    toml.write_text(TEXT + "[choice]\nhysteresis = 0.05\nmax_step = 8\n")
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out")]) == 0
    steady = json.loads((tmp_path / "out" / "summary.json").read_text())["steady"]
    assert 0.0 < steady["worst_loss"] <= 0.05
    assert steady["changes"][1] <= steady["changes"][0]


def test_what_is_uncertain_is_drawn(toml, tmp_path):
    (tmp_path / "columns.csv").write_text(
        "column,scan_velocity,slip,sigma_velocity,sigma_slip\n0,1.0,0.01,0.001,0.01\n1,1.0,0.02,0.0,0.0\n"
    )
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out")]) == 0
    loss = json.loads((tmp_path / "out" / "summary.json").read_text())["predicted_loss"]
    assert 0.0 < loss["mean"] < loss["upper_95"] < 1.0


def test_the_page_opens_without_an_error_and_asks_nobody_for_anything(done, open_page):
    opened, problems = open_page(done / "report.html")
    opened.wait_for_timeout(300)
    assert problems == [] and opened.locator("svg.drawn").count() >= 4
    for width in (1200, 700):
        opened.set_viewport_size({"width": width, "height": 900})
        opened.wait_for_timeout(400)
        assert opened.evaluate("document.documentElement.scrollWidth") <= width


def test_names_are_text_on_the_page(done):
    assert "&lt;b&gt;five&lt;/b&gt; columns" in (done / "report.html").read_text(encoding="utf-8")


def test_one_column_one_signal_one_setting_will_do(tmp_path):
    path = tmp_path / "tdi.toml"
    path.write_text(
        "[grid]\nstages = [7]\nintegration_ratio = [1.0]\n[columns]\ncount = 1\n[signals]\nlist = [50.0]\n"
    )
    assert run(["tdi", str(path), "--out", str(tmp_path / "out")]) == 0
    (row,) = rows_of(tmp_path / "out")
    assert (row["stages"], row["integration_ratio"]) == ("7", "1")
    # photons alone: the root of 7 x 50 electrons
    assert float(row["snr"]) == pytest.approx(350**0.5, rel=1e-8)


def test_json_on_stdout(toml, tmp_path, capsys):
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == "<b>five</b> columns"


def test_check_says_what_was_understood(toml, capsys):
    assert run(["check", str(toml)]) == 0
    said = capsys.readouterr().out
    assert "5 columns, 5 signals, 186 settings each" in said and "blurred out by" in said


def test_the_schema_knows_the_aliases(capsys):
    assert run(["schema", "tdi"]) == 0
    ranges = json.loads(capsys.readouterr().out)["$defs"]["SignalsSection"]["properties"]
    assert {"from", "to", "count", "list"} <= set(ranges)


WRONG = {
    "unknown key": ("[noise]", "[noise]\nshott = 2", "unknown key 'noise.shott'; did you mean shot?"),
    "no noise": ("gain = 9e-6\nread = 12.0", "shot = 0", "every setting would have an infinite SNR"),
    "negative noise": ("read = 12.0", "read = -1.0", "noise.read = -1.0"),
    "no stages": ("stages = { from = 3, to = 64 }", "stages = []", "one value at least"),
    "falling stages": ("stages = { from = 3, to = 64 }", "stages = [5, 4]", "must rise"),
    "range the wrong way": ("from = 3, to = 64", "from = 65, to = 64", "exchange them"),
    "ratio above 1": ("[0.4, 0.8, 1.0]", "[0.4, 1.2]", "1e-4 to 1 of the line period are"),
    "fewer stages than the head": ("from = 3,", "from = 1,", "2 head lines are always read"),
    "head without ratio": ("integration_ratio = 0.5\n", "", "integration_ratio of the head is missing"),
    "well below the head's signal": (
        "[mtf]", "[choice]\nfull_well_line = 900\n[mtf]", "lies below the highest signal of a head line",
    ),
    "unknown merit": ("[mtf]", '[choice]\nmerit = "sum"\n[mtf]', "allowed: 'product'"),
    "no signals": ("from = 10\nto = 1000\ncount = 5", "count = 5", "give list, or from and to"),
    "signals the wrong way": ("from = 10", "from = 2000", "must lie below"),
    "two sources of columns": ("table = ", "count = 3\ntable = ", "give one of count, table and acquisition"),
    "missing table": ("columns.csv", "elsewhere.csv", "no such file"),
    "a range from nothing": ("from = 3, to = 64", "from = 0, to = 64", "grid.stages.from = 0"),
    "a range of half stages": ("from = 3, to = 64", "from = 3.5, to = 64", "grid.stages.from = 3.5"),
    "a range of ratios without steps": (
        "[0.4, 0.8, 1.0]", "{ from = 0.1, to = 1 }", "grid.integration_ratio.step' is",
    ),
    "no noise at all": ("gain = 9e-6\nread = 12.0", "shot = 0", "every setting would have an infinite SNR"),
    "beyond the optics": ("optics_mtf = 0.35", "optics_cutoff = 0.3", "leave no contrast"),
    "a limit in degrees": ("[mtf]", "[choice]\nslip_limit = 5\n[mtf]", "1e-6 to below 1.5 rad are; or"),
    "a limit in words": ("[mtf]", '[choice]\nslip_limit = "any"\n[mtf]', 'or "allow"'),
    "columns without end": ('table = "columns.csv"', "count = 2000000000", "1 to 1e6 columns are"),
    "too many ratios": (
        "[0.4, 0.8, 1.0]", "{ from = 0.2, to = 1.0, step = 0.02 }", "integration ratios",
    ),
    "too many stages": ("to = 64", "to = 600", "stages"),
    "loss of nothing": ("[mtf]", "[table]\nmax_loss = 0\n[mtf]", "1e-6 to below 1 are"),
    "a band without an acquisition": ("table = ", 'band = "PAN"\ntable = ', "band belongs to acquisition"),
    "missing acquisition": ('table = "columns.csv"', 'acquisition = "a.toml"', "no such file"),
    "mtf bounds crossed": ("[mtf]", "[choice]\nmtf_min = 0.5\nmtf_max = 0.2\n[mtf]", "lies above mtf_max"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_one_clear_error_and_nothing_written(what, toml, tmp_path, capsys):
    old, new, message = WRONG[what]
    assert old in TEXT
    toml.write_text(TEXT.replace(old, new))
    assert run(["tdi", str(toml), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said and "Traceback" not in said
    assert not (tmp_path / "out").exists()


TABLES = {
    "a column twice": ("3,1.001,0.015", "2,1.001,0.015", "whole numbers from 0 up, rising, none twice"),
    "another unit": ("1,1.0,-0.015", "1,7000,-0.015", "or the unit another?"),
    "a word misspelt": ("scan_velocity,slip", "scan_velocity,slip,sigma_slp", "did you mean sigma_slip?"),
    "a column beyond all": ("7,0.999,0.03", "4294967296,0.999,0.03", "the last that is allowed"),
    "NaN": ("1,1.0,-0.015", "1,nan,-0.015", "scan_velocity' is nan"),
    "scan reversed": ("1,1.0,-0.015", "1,-1.0,-0.015", "is the sign of the scan reversed"),
    "slip in degrees": ("7,0.999,0.03", "7,0.999,1.2", "slips by 68.75 degrees, more than the limit of 5"),
    "a row too short": ("7,0.999,0.03", "7,0.999", "has 2 values, the header has 3"),
    "no slip": ("scan_velocity,slip", "scan_velocity,slop", "did you mean slip?"),
    "half of the optics": (COLUMNS, "column,scan_velocity,slip,optics_mtf_x\n0,1,0,0.3\n", "give both"),
}


@pytest.mark.parametrize("what", TABLES)
def test_wrong_columns_are_named(what, toml, tmp_path, capsys):
    old, new, message = TABLES[what]
    text = COLUMNS.replace(old, new)
    if "sigma_slp" in new:
        text = "\n".join([text.splitlines()[0], *(row + ",0" for row in text.splitlines()[1:])])
    (tmp_path / "columns.csv").write_text(text)
    assert run(["tdi", str(toml), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert message in said and "Traceback" not in said


def test_what_changes_nothing_is_said_and_columns_left_out_too(toml, tmp_path):
    toml.write_text(TEXT + "[choice]\nquantile = 0.1\n[motion]\nstages = 8\n")
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out")]) == 0
    said = " ".join(json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"])
    assert "quantile changes nothing" in said and "[motion] changes nothing" in said
    assert "3 columns between those" in said


NOTHING_TO_SEE = {
    "signals below an electron": ("from = 10\nto = 1000\ncount = 5", "list = [0.2, 0.5, 0.9]"),
    "every setting saturates": ("[mtf]", "[choice]\nfull_well_sum = 10\n[mtf]"),
    "drift of many pixels": ("[mtf]", '[choice]\nslip_limit = "allow"\n[mtf]'),
    "blur wider than the target": ("[0.5, 0.5]", "[0.01, 0.01]"),
}


def stopped_at(stage: str, count: int, words: list[str], monkeypatch) -> list[str]:
    """A run that is interrupted when it would keep this stage for the `count`-th time; what it had kept."""
    put, kept = Stages.put, []

    def some(stages, name, value):
        if name == stage and kept.count(stage) == count - 1:
            raise KeyboardInterrupt
        put(stages, name, value)
        if stages.has(name):  # not of the other ways to choose, which are kept nowhere
            kept.append(name)

    with monkeypatch.context() as patch:
        patch.setattr(Stages, "put", some)
        assert run(words) == 130
    return kept


def test_a_run_that_was_stopped_time_and_again_goes_on_to_the_same_bits(toml, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(choose, "CHUNK", 2)
    monkeypatch.setattr(choose, "KEPT_SECONDS", 0.0)
    monkeypatch.setattr(tdi_lines, "AT_ONCE", 16)  # two lines of eight columns
    toml.write_text(TEXT + "[choice]\nhysteresis = 0.02\n")
    image, whole, out = tmp_path / "image.npy", tmp_path / "whole", tmp_path / "out"
    np.save(image, np.random.default_rng(3).uniform(5.0, 1200.0, (9, 8)).astype(np.float32))
    words = ["tdi", str(toml), "--no-pictures", "--signals", str(image)]
    assert run([*words, "--out", str(whole)]) == 0
    words += ["--out", str(out)]
    assert stopped_at("choice", 3, words, monkeypatch) == ["choice", "choice"]
    assert "finished stages wait in" in capsys.readouterr().err
    kept = stopped_at("table", 1, [*words, "--resume"], monkeypatch)
    assert kept == ["choice", "other-ways", "steady"]  # the last columns of the choice alone
    kept = stopped_at("lines-3", 1, words, monkeypatch)
    assert kept == ["table", "losses", "lines-0", "lines-1", "lines-2"]
    assert run([*words, "--resume"]) == 0
    assert not (out / ".partial").exists()
    assert {path.name for path in out.iterdir()} == {path.name for path in whole.iterdir()}
    for path in whole.iterdir():
        if path.name not in ("report.html", "summary.json"):
            assert (out / path.name).read_bytes() == path.read_bytes(), path.name
    mine, theirs = (json.loads((place / "summary.json").read_text()) for place in (out, whole))
    assert {key for key in theirs if mine[key] != theirs[key]} <= {"wall_seconds", "peak_memory_bytes"}


def test_a_run_of_another_input_is_refused_where_it_is_to_go_on(toml, tmp_path, capsys, monkeypatch):
    words = ["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out")]
    stopped_at("table", 1, words, monkeypatch)
    toml.write_text(TEXT.replace("read = 12.0", "read = 13.0"))
    capsys.readouterr()
    assert run([*words, "--resume"]) == 2
    said = capsys.readouterr().err
    assert said.count("error:") == 1 and "choice.stage.npz: it is of other images, options" in said
    assert "leave --resume out" in said
    # as it says: named and done again
    assert run(words) == 0 and "choice.stage.npz is passed over" in capsys.readouterr().err


@pytest.mark.parametrize("what", NOTHING_TO_SEE)
def test_the_choice_is_written_where_no_picture_can_be_made(what, toml, tmp_path):
    """A slanted edge that cannot be measured is no fault of the choice."""
    if what == "drift of many pixels":
        (tmp_path / "columns.csv").write_text(COLUMNS.replace("0.03\n", "1.48\n"))
    toml.write_text(TEXT.replace(*NOTHING_TO_SEE[what]))
    out = tmp_path / "out"
    assert run(["tdi", str(toml), "--out", str(out)]) == 0
    assert sorted(entry.name for entry in out.iterdir()) == FILES and len(rows_of(out)) in (15, 25)
    said = json.loads((out / "summary.json").read_text())["warnings"]
    assert any(warning.startswith("no pictures of a target: ") for warning in said)


def test_a_steep_slip_may_be_allowed(toml, tmp_path):
    (tmp_path / "columns.csv").write_text(COLUMNS.replace("0.03\n", "0.12\n"))
    assert run(["tdi", str(toml), "--out", str(tmp_path / "a")]) == 2
    toml.write_text(TEXT + '[choice]\nslip_limit = "allow"\n')
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "b")]) == 0


def test_optics_per_column_stand_in_for_those_of_the_file(toml, tmp_path):
    lines = COLUMNS.splitlines()
    (tmp_path / "columns.csv").write_text(
        "\n".join([lines[0] + ",optics_mtf_x,optics_mtf_y", *(line + ",0.2,0.1" for line in lines[1:])])
    )
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(tmp_path / "out")]) == 0
    centre = rows_of(tmp_path / "out")[10]
    # at rest across: optics, an aperture of 0.9 and a diffusion of 0.2 px at half a cycle
    static = np.sinc(0.45) * np.exp(-2 * (np.pi * 0.2 * 0.5) ** 2)
    assert float(centre["mtf_x"]) == pytest.approx(0.2 * static, rel=1e-6)


@pytest.fixture(scope="module")
def strip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strip")
    size = ["--lines", "340", "--columns", "200"]
    assert run(["simulate", "line-of-sight", "--seed", "3", *size, "--out", str(folder / "strip")]) == 0
    # one pass: these tests are of what is made of a motion, not of how well it is known
    toml = folder / "strip" / "acquisition.toml"
    toml.write_text(toml.read_text() + "\n[matching]\npasses = 1\n")
    assert run(["recover", str(toml), "--out", str(folder / "seen")]) == 0
    text = TEXT.replace('table = "columns.csv"', 'acquisition = "strip/acquisition.toml"\nband = "PAN"')
    (folder / "tdi.toml").write_text(text)
    return folder


class TestMotion:
    """Columns of a strip's cameras, and settings for the motion that was recovered of it."""

    def test_the_cameras_give_the_columns(self, strip, tmp_path):
        assert run(["tdi", str(strip / "tdi.toml"), "--no-pictures", "--out", str(tmp_path / "out")]) == 0
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        # level flight over a plane: in step with the clock, but for the detector's rotation of some 3e-4 rad
        assert summary["columns"] == 200 and summary["motion"] is None
        assert summary["scan_velocity"]["mean"] == pytest.approx(1.0, abs=1e-6)
        assert abs(summary["slip"]["mean"]) < 2e-3

    def test_motion_costs_stages(self, strip, tmp_path):
        still, moved = tmp_path / "still", tmp_path / "moved"
        command = ["tdi", str(strip / "tdi.toml"), "--no-pictures"]
        assert run([*command, "--out", str(still)]) == 0
        assert run([*command, "--motion", str(strip / "seen"), "--out", str(moved)]) == 0
        summary = json.loads((moved / "summary.json").read_text())
        assert 0.0 < summary["motion"]["first_start"] < summary["motion"]["last_start"] < 0.2
        assert "Merit along the stages, under this motion" in (moved / "report.html").read_text()
        assert summary["motion"]["lines"] >= 64 and summary["predicted_loss"]["mean"] > 0.0
        assert {"motion.csv", "acquisition.toml"} <= set(summary["inputs"])
        before, after = (
            float(json.loads((d / "summary.json").read_text())["stages"]["mean"]) for d in (still, moved)
        )
        assert after < before

    def test_optics_of_each_column_count_beside_the_motion(self, strip, tmp_path):
        optics = np.linspace(0.2, 0.5, 200)
        rows = [f"{c},{value:.9g},{0.5 * value:.9g}" for c, value in enumerate(optics)]
        (strip / "optics.csv").write_text("\n".join(["column,optics_mtf_x,optics_mtf_y", *rows]))
        path, text = strip / "optics.toml", (strip / "tdi.toml").read_text()
        path.write_text(text.replace("[signals]", 'table = "optics.csv"\n[signals]'))
        found = []
        for toml in (strip / "tdi.toml", path):
            out = tmp_path / toml.stem
            command = ["tdi", str(toml), "--no-pictures", "--motion", str(strip / "seen")]
            assert run([*command, "--out", str(out)]) == 0
            found.append(rows_of(out))
        for axis, share in (("mtf_x", 1.0), ("mtf_y", 0.5)):
            ratio = [float(b[axis]) / float(a[axis]) for a, b in zip(*found, strict=True)]
            # a factor of a column's merit moves no setting: what differs is the optics (0.35 in the file)
            assert ratio == pytest.approx((share * np.repeat(optics, 5) / 0.35).tolist(), rel=1e-6)
        assert [a["stages"] for a in found[0]] == [b["stages"] for b in found[1]]

    @pytest.mark.parametrize(
        ("table", "message"),
        [
            (COLUMNS, "gives scan_velocity, and [columns] acquisition is given"),
            ("column,optics_mtf_x\n0,0.3\n", "column 'optics_mtf_y' is missing"),
            ("column,optics_mtf_x,optics_mtf_y\n0,0.3,0.3\n", "its 1 rows are of columns 0 to 0"),
            ("column,optics_mtf_x,optics_mtf_y\n0,0.3,1.3\n", "optics_mtf_y must lie above 0, up to 1"),
        ],
    )
    def test_a_table_beside_an_acquisition_is_of_its_optics(self, strip, tmp_path, capsys, table, message):
        (strip / "other.csv").write_text(table)
        path, text = strip / "other.toml", (strip / "tdi.toml").read_text()
        path.write_text(text.replace("[signals]", 'table = "other.csv"\n[signals]'))
        assert run(["tdi", str(path), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert message in said and "Traceback" not in said

    def test_a_motion_needs_its_cameras(self, strip, toml, tmp_path, capsys):
        assert run(["tdi", str(toml), "--motion", str(strip / "seen"), "--out", str(tmp_path / "out")]) == 2
        assert "--motion belongs to an acquisition" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("to = 64", "to = 450", "give a longer motion, or fewer stages"),
            ("[mtf]", '[choice]\nmodel = "patent"\n[mtf]', "knows no measured motion"),
            ('band = "PAN"', 'band = "SWIR"', "no band is called 'SWIR'"),
        ],
    )
    def test_what_does_not_fit_is_said(self, strip, tmp_path, capsys, old, new, message):
        path = strip / "other.toml"
        path.write_text((strip / "tdi.toml").read_text().replace(old, new))
        assert run(["tdi", str(path), "--motion", str(strip / "seen"), "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert message in said and "Traceback" not in said
        assert not (tmp_path / "out").exists()

    def test_a_result_without_its_spectrum_is_named(self, strip, tmp_path, capsys):
        part = tmp_path / "part"
        shutil.copytree(strip / "seen", part)
        (part / "spectrum.csv").unlink()
        command = ["tdi", str(strip / "tdi.toml"), "--motion", str(part)]
        assert run([*command, "--out", str(tmp_path / "out")]) == 2
        assert "spectrum.csv: is missing" in capsys.readouterr().err

    def test_a_folder_that_is_no_result_is_named(self, strip, tmp_path, capsys):
        command = ["tdi", str(strip / "tdi.toml"), "--motion", str(strip / "strip")]
        assert run([*command, "--out", str(tmp_path / "out")]) == 2
        assert "must be a folder that `recover` wrote" in capsys.readouterr().err
