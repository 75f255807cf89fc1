"""The examples and the README's own Python run as they stand."""

from __future__ import annotations

import contextlib
import io
import re
import runpy
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from sightline.cli.main import run as run_command

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PYTHON, TDI, STEREO, FLIGHTS = (
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("python", "tdi", "stereo", "flights")
)
#: The real data set that an example is about.
ABOUT = {
    "iss_frames": "iss_astropi_a",
    "iss_stereo": "iss_astropi_a",
    "junocam_spin_scan": "junocam_spin_scan",
    "sentinel2_bands": "s2_l1b_bands",
}
#: How many of the files of a set an example is given here: enough for all that it does.
FEW = {"iss_stereo": ("photo_*.jpg", 3), "sentinel2_bands": ("*.tif", 1)}


@pytest.fixture
def run(monkeypatch, capsys, tmp_path) -> Callable[..., str]:
    """What a file, or the Python of a page, prints, as a program that begins anew but for what is loaded."""

    def call(program: Path | str, folder: Path = ROOT, **environment: str) -> str:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", [str(program)])
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        capsys.readouterr()
        if isinstance(program, str):
            exec(compile(program, "a page", "exec"), {"__name__": "__main__"})
            return capsys.readouterr().out
        monkeypatch.syspath_prepend(program.parent)
        for other in EXAMPLES:  # which look at the environment as they are loaded
            monkeypatch.delitem(sys.modules, other.stem, raising=False)
        runpy.run_path(str(program), run_name="__main__")
        return capsys.readouterr().out

    return call


def command(words: list[str]) -> str:
    """What a command prints that succeeds."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert run_command(words) == 0
    return said.getvalue()


def part_of(data: Path, example: str, folder: Path) -> Path:
    """A folder that holds what an example is given of a set of real data."""
    pattern, count = FEW.get(example, ("*", None))
    (folder / data.name).mkdir()
    for path in sorted(data.glob(pattern))[:count]:
        (folder / data.name / path.name).symlink_to(path)
    return folder


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    """The simulated flight of the pages."""
    folder = tmp_path_factory.mktemp("simulated") / "flight"
    command(["simulate", "frames", "--case", "small", "--out", str(folder), "--seed", "1"])
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_prints(path, real_data, tmp_path, run):
    given = {}
    if path.stem in ABOUT:
        data = real_data(ABOUT[path.stem])
        given["SIGHTLINE_DATA"] = str(part_of(data, path.stem, tmp_path))
    assert run(path, **given)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_which_folder_it_is_not_given(path, run):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 80 and (path.stem in ABOUT) == ("SIGHTLINE_DATA" in text)
    if path.stem in ABOUT:
        with pytest.raises(SystemExit) as ended:
            run(path)
        assert "in $SIGHTLINE_DATA" in ended.value.code and ABOUT[path.stem] in ended.value.code


@pytest.mark.slow
def test_the_python_of_the_readme_runs_and_prints_three_axes(run):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) <= 12
    assert block in PYTHON
    lines = run(block).splitlines()
    assert [line.split()[0] for line in lines] == ["roll", "pitch", "yaw"]
    shown = re.search(r"```text\n(roll .*?)```", readme, re.DOTALL)
    assert shown is not None
    # libraries of another version may change the last digit by one, not what is said
    for printed, stated in zip(lines, shown[1].splitlines(), strict=True):
        numbers = [[float(n) for n in re.findall(r"\d+\.\d+", line)] for line in (printed, stated)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.05, abs=0.0011)


@pytest.mark.slow
def test_the_tdi_files_and_python_of_the_pages_run_as_stated(tmp_path, run):
    # the other is a part of an ACQUISITION.toml
    (toml, _), (columns,) = (re.findall(rf"```{kind}\n(.*?)```", TDI, re.DOTALL) for kind in ("toml", "csv"))
    (tmp_path / "tdi.toml").write_text(toml, encoding="utf-8")
    (tmp_path / "columns.csv").write_text(columns, encoding="utf-8")
    python, text = (re.findall(rf"```{kind}\n(.*?)```", PYTHON, re.DOTALL) for kind in ("python", "text"))
    assert run(python[1], tmp_path) == text[1]
    assert run(python[4], tmp_path) == text[4]
    assert (tmp_path / "copy" / "table.bin").read_bytes() == (tmp_path / "tdi" / "table.bin").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "stated_as"),
    [
        (2, "simulate stereo --out pass --seed 1 "),
        (3, "simulate frames --case small --out flight --seed 1 "),
    ],
    ids=["stereo", "sequence"],
)
def test_the_python_on_what_is_simulated_runs_as_stated(tmp_path, flight, number, stated_as, run):
    python, text = (re.findall(rf"```{kind}\n(.*?)```", PYTHON, re.DOTALL) for kind in ("python", "text"))
    assert stated_as in STEREO + FLIGHTS
    if number == 2:
        command(["simulate", "stereo", "--out", str(tmp_path / "pass"), "--seed", "1"])
    else:
        shutil.copytree(flight, tmp_path / "flight")
    printed, stated = run(python[number], tmp_path), text[number]
    digits = r"[+-]?\d+\.\d+"
    assert re.sub(digits, "#", printed) == re.sub(digits, "#", stated)
    # libraries of another version may change the last digit by one
    assert [float(n) for n in re.findall(digits, printed)] == pytest.approx(
        [float(n) for n in re.findall(digits, stated)], abs=0.11
    )


@pytest.mark.slow
def test_the_table_of_the_page_of_flights_is_what_score_prints(tmp_path, flight):
    (stated,) = re.findall(r"```console\n(frames .*?)```", FLIGHTS, re.DOTALL)
    located = str(tmp_path / "located")
    command(["georeference", str(flight / "sequence.toml"), "--out", located, "--poses-only"])
    printed = command(["score", located, str(flight / "poses-truth.csv"), "--table"])
    lines = printed.splitlines()
    wanted = [part.splitlines() for part in stated.split("...\n")]
    for part in wanted:
        first = next(k for k, line in enumerate(lines) if line[:40] == part[0][:40])
        for line, said in zip(lines[first : first + len(part)], part, strict=True):
            assert line[:40].strip() == said[:40].strip()
            numbers = [[float(n) for n in re.findall(r"[\d.]+", text[40:])] for text in (line, said)]
            # libraries of another version may change a pose by a hundredth of its sigma
            assert numbers[0] == pytest.approx(numbers[1], rel=0.03, abs=0.02)
