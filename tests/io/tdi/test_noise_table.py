"""``[noise] table``: what it gives each column, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sightline.cli.main import run
from sightline.io.tdi.load import load_tdi

TEXT = """
[grid]
stages = { from = 3, to = 64 }
integration_ratio = [0.4, 0.8, 1.0]
[head]
stages = 2
integration_ratio = 0.5
[noise]
gain = 9e-6
table = "noise.csv"
[columns]
count = 4
[signals]
from = 10
to = 1000
count = 5
[mtf]
aperture_x = 0.9
optics_mtf = 0.35
"""
TABLE = """column,read,full_well_line,full_well_sum,diffusion_sigma_px
3,30,20000,5e4,0.3
0,12,20000,inf,0.1
1,12,20000,inf,0.2
2,6,20000,inf,0
"""


@pytest.fixture
def toml(tmp_path):
    (tmp_path / "noise.csv").write_text(TABLE)
    path = tmp_path / "tdi.toml"
    path.write_text(TEXT)
    return path


def test_every_column_has_its_own(toml):
    problem = load_tdi(toml)
    own = [problem.detector.of_column(problem.columns, c) for c in range(4)]
    assert [one.noise.read for one in own] == [12.0, 12.0, 6.0, 30.0]
    assert [one.full_well_sum for one in own] == [np.inf, np.inf, np.inf, 5e4]
    # what the table does not have is that of the file
    assert {(one.noise.gain, one.noise.shot, one.full_well_line) for one in own} == {(9e-6, 1.0, 2e4)}
    assert len(problem.detector.kinds) == 3
    diffusion = np.array([0.1, 0.2, 0.0, 0.3])
    at_half_a_cycle = 0.35 * np.exp(-0.5 * (np.pi * diffusion) ** 2)
    assert problem.columns.static_mtf[:, 0] == pytest.approx(at_half_a_cycle * np.sinc(0.45))
    assert problem.columns.static_mtf[:, 1] == pytest.approx(at_half_a_cycle * np.sinc(0.5))


def test_the_choice_keeps_the_well_of_a_column(toml, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["tdi", str(toml), "--no-pictures", "--out", str(out)]) == 0
    table = np.genfromtxt(out / "choice.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    total = table["signal"] * (2.0 + (table["stages"] - 2) * table["integration_ratio"] / 0.5)
    bright = table["signal"] > 900.0
    assert total[bright & (table["column"] == 3)] <= 5e4 < total[bright & (table["column"] == 0)]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["table"]["holds"] and "noise.csv" in summary["inputs"]
    capsys.readouterr()
    assert run(["check", str(toml)]) == 0
    said = capsys.readouterr().out
    assert "columns of 3 kinds: read 6 to 30, full_well_sum 5e+04 to inf" in said


def test_columns_that_are_alike_are_as_without_a_table(toml, tmp_path):
    (tmp_path / "noise.csv").write_text("column,read\n0,12\n1,12\n2,12\n3,12\n")
    problem = load_tdi(toml)
    assert problem.columns.kind is None and problem.detector.kinds == ()
    assert problem.detector.noise.read == 12.0


def test_by_response_of_columns_one_gets_a_table(toml, tmp_path):
    """From the conversion gains of `sightline noise` to a table, as the docs say: shot by column."""
    conversion, mean = np.array([3.4, 3.5, 3.6, 3.7]), 3.55
    rows = [f"{c},{mean / k:.9g}" for c, k in enumerate(conversion)]
    (tmp_path / "noise.csv").write_text("\n".join(["column,shot", *rows]))
    problem = load_tdi(toml)
    own = [problem.detector.of_column(problem.columns, c).noise for c in range(4)]
    # a column of k electrons per DN collects k DN electrons, of as much variance; told in mean electrons
    dn = 1000.0
    variance = conversion * dn * (mean / conversion) ** 2
    assert [law.shot * mean * dn for law in own] == pytest.approx(variance.tolist())


WRONG = {
    "a key of [noise] too": ("gain = 9e-6", "gain = 9e-6\nread = 12.0", "[noise] read = 12 is given, and a"),
    "a key of [choice] too": ("[mtf]", "[choice]\nfull_well_sum = 1e6\n[mtf]", "[choice] full_well_sum ="),
    "a key of [mtf] too": ("[mtf]", "[mtf]\ndiffusion_sigma_px = 0.2", "[mtf] diffusion_sigma_px = 0.2 is"),
    "more columns": ("count = 4", "count = 5", "column 4 has no row: [columns] has the columns 0 to 4"),
    "fewer columns": ("count = 4", "count = 3", "column 3 is none of them"),
    "no such file": ("noise.csv", "other.csv", "no such file"),
    "a column twice": ("3,30,", "2,30,", "column 2 stands twice"),
    "NaN": ("0,12,", "0,nan,", "read' is nan"),
    "a negative noise": ("0,12,", "0,-1,", "read = -1 at column 0: 0, or 1e-6 to 1e9 electrons"),
    "a well of nothing": ("inf,0.1", "0,0.1", "full_well_sum = 0 at column 0"),
    "a diffusion beyond all": ("inf,0.1", "inf,1000", "diffusion_sigma_px = 1000 at column 0"),
    "infinite noise": ("0,12,", "0,inf,", "read' is inf"),
    "a word misspelt": ("column,read", "column,raed", "column 'raed' is not known; did you mean read?"),
    "another word": ("column,read", "column,colour", "'colour' is not known; allowed are gain, shot"),
    "a head that overflows": ("0,12,20000", "0,12,900", "900 electrons of column 0 lies below"),
    "responses": (
        TABLE, "column,gain,offset,flags\n0,1,3,0\n", "is the columns.csv of `sightline noise`, whose `gain`",
    ),
    "nothing": (TABLE, "column\n0\n", "has nothing but the numbers of columns"),
    "no noise": (
        TABLE, "column,shot\n0,1\n1,0\n2,1\n3,1\n", "column 1 has no noise: every setting would have",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_one_clear_error_and_nothing_written(what, toml, tmp_path, capsys):
    old, new, message = WRONG[what]
    assert (old in TEXT) or (old in TABLE)
    text = TEXT.replace("gain = 9e-6\n", "") if what == "no noise" else TEXT
    toml.write_text(text.replace(old, new))
    (tmp_path / "noise.csv").write_text(TABLE.replace(old, new))
    assert run(["tdi", str(toml), "--out", str(tmp_path / "out")]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert message in said and "Traceback" not in said
    assert not (tmp_path / "out").exists()
