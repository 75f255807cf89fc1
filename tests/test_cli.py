"""The command line: exit statuses, one clear message, no traceback, nothing half-written."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from sightline.cli import main as command
from sightline.cli import terminal, warm_up
from sightline.cli.terminal import print_json, progress
from sightline.errors import (
    EstimationError,
    FormatError,
    GeometryError,
    InputError,
    SightlineError,
    SpanError,
    UnobservableBandWarning,
    printable,
)
from sightline.version import VERSION


@pytest.fixture
def failing_with(monkeypatch):
    """Make `sightline version` raise an exception of one's choice."""

    def arrange(error):
        def fails(words, **options):
            raise error

        monkeypatch.setattr(command, "app", fails)

    return arrange


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (EstimationError("yaw is not observable"), 1),
        (GeometryError("no ray meets the surface"), 1),
        (SightlineError("a worker process ended"), 1),
        (InputError("wrong shape"), 2),
        (FormatError("a.toml: no such file"), 2),
        (SpanError("line 12 is outside the span"), 2),
        (PermissionError(13, "Permission denied", "a.tif"), 2),
        (MemoryError(), 1),
        (ZeroDivisionError("division by zero"), 70),
    ],
)
def test_the_exit_status_says_whose_the_problem_is(failing_with, capsys, error, status):
    failing_with(error)
    assert command.run(["version"]) == status
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1 and said.err.startswith("sightline: ")
    assert "Traceback" not in said.err


def test_a_message_of_ours_is_given_word_for_word(failing_with, capsys):
    failing_with(InputError("`workers` must be 1 or more, got 0"))
    command.run(["version"])
    assert capsys.readouterr().err == "sightline: error: `workers` must be 1 or more, got 0\n"


def test_with_debug_the_exception_itself_rises(failing_with):
    failing_with(InputError("wrong shape"))
    with pytest.raises(InputError, match="wrong shape"):
        command.main(["version", "--debug"])


def test_a_defect_of_ours_asks_for_a_report(failing_with, capsys):
    failing_with(ZeroDivisionError("division by zero"))
    command.run(["version"])
    assert "ZeroDivisionError: division by zero; this is a fault of Sightline" in capsys.readouterr().err


def test_output_that_nobody_reads_any_more_is_no_fault_of_the_data():
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-m", "sightline", "schema", "acquisition"]
    ran = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert ran.returncode == 141 and "Traceback" not in ran.stderr


def test_an_interruption_is_no_error_of_anybody(failing_with, capsys):
    failing_with(KeyboardInterrupt())
    assert command.run(["version"]) == 130
    assert "no result was written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["recover"], "Missing argument 'ACQUISITION.toml'; see: sightline recover --help"),
        (["recver"], "Did you mean 'recover'?"),
        (["recover", "a.toml"], "Missing option '--out'"),
        (["simulate", "line-of-sight", "--seed", "-1", "--out", "x"], "Invalid value for '--seed'"),
    ],
)
def test_wrong_words_are_answered_with_where_to_read(capsys, words, message):
    assert command.run(words) == 2
    said = capsys.readouterr().err
    assert message in said and len(said.splitlines()) == 1


def test_warnings_are_one_line_without_a_place_in_the_code(monkeypatch, capsys):
    def warns(words, **options):
        warnings.warn("blind at 100 Hz, 200 Hz", UnobservableBandWarning, stacklevel=2)

    monkeypatch.setattr(command, "app", warns)
    assert command.run(["version"]) == 0
    assert capsys.readouterr().err == "sightline: warning: blind at 100 Hz, 200 Hz\n"


def test_a_file_that_is_not_there_is_named(tmp_path, capsys):
    missing = tmp_path / "strip.toml"
    out = tmp_path / "result"
    assert command.run(["recover", str(missing), "--out", str(out)]) == 2
    assert f"{missing}: no such file" in capsys.readouterr().err
    assert not out.exists()
    assert command.run(["check", str(missing)]) == 2


def test_what_a_message_quotes_is_one_line_that_steers_no_terminal(tmp_path, capsys):
    path = tmp_path / f"\x1b[2J\nsightline: error: forged\u202e{'n' * 200}"
    assert command.run(["check", str(path)]) == 2 and command.run(["check", "--\x1b[2Jn\n"]) == 2
    said = capsys.readouterr().err
    assert printable(said.replace("\n", "")) == said.replace("\n", "") and len(said.splitlines()) == 2
    assert "\\x1b[2J\\nsightline: error: forged\\u202ennn" in said


def test_a_number_without_end_is_not_repeated_to_its_end(failing_with, capsys):
    failing_with(FormatError(f"file.toml: line_period = {'9' * 5000} is not allowed; give less"))
    command.run(["schema", "acquisition"])
    said = capsys.readouterr().err
    assert (
        len(said) < 1100
        and said.startswith("sightline: error: file.toml: line_period")
        and "; give less" in said
    )


def test_an_output_folder_with_files_is_refused_before_any_work(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("keep")
    words = ["simulate", "line-of-sight", "--lines", "64", "--columns", "64", "--out", str(tmp_path)]
    assert command.run(words) == 2
    assert "holds mine.txt" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["mine.txt"]


def test_version_and_schema_print_on_stdout(capsys):
    assert command.run(["version"]) == 0
    assert capsys.readouterr().out.strip().count(".") == 2
    assert command.run(["schema", "acquisition"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["platform"]
    assert command.run(["schema", "acquisitoin"]) == 2
    assert "acquisition" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["lines", "columns"])
def test_the_help_of_simulate_states_the_size_of_every_case(name):
    from sightline.cli import simulate
    from sightline.simulate.instruments import InstrumentOptions
    from sightline.simulate.strip_options import CASE_OPTIONS, StripOptions

    usual = getattr(StripOptions(), name)
    other = [f"; {case}: {given[name]}" for case, given in CASE_OPTIONS.items() if name in given]
    other.append(f"; instruments, --acquisition: {getattr(InstrumentOptions(), name)}")
    assert getattr(simulate, f"_{name.upper()}") == f"{usual}{''.join(other)}"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["simulate", "line-of-sight"], ["3000; real: 2400", "1000; real: 640"]),
        (["recover"], ["per line of a strip's bands, or per frame"]),
        (["schema"], ["acquisition, instrument, scene, sequence, stereo, tdi; summary"]),
    ],
)
def test_help_says_what_a_first_reader_asks(capsys, words, said):
    assert command.run([*words, "--help"]) == 0
    shown = " ".join(re.sub(r"[│\s]+", " ", capsys.readouterr().out).split())
    assert all(text in shown for text in said), shown


def test_the_version_is_an_option_and_a_command(capsys):
    for words in (["--version"], ["version"], ["--version", "recover"]):
        assert command.run(words) == 0
        assert capsys.readouterr().out == f"{VERSION}\n"


def test_no_document_names_an_option_that_no_command_has():
    import typer.main

    from sightline.cli.main import app

    def options(group):
        for entry in getattr(group, "commands", {}).values():
            yield from options(entry)
        yield from (name for option in group.params for name in [*option.opts, *option.secondary_opts])

    known = {*options(typer.main.get_command(app)), "--help"}
    root = Path(__file__).resolve().parents[1]
    names = ("README.md", "docs/commands.md", "docs/gotchas.md")
    pages = [*(root / name for name in names), *sorted((root / "docs" / "formats").iterdir())]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= known, page


def test_json_has_no_numbers_that_json_does_not_know(capsys):
    import numpy as np

    print_json({"sigma": np.array([1.0, np.inf, np.nan]), "count": np.int64(3), "path": sys.executable})
    assert json.loads(capsys.readouterr().out) == {
        "sigma": [1.0, None, None],
        "count": 3,
        "path": sys.executable,
    }


def test_the_help_of_every_command_ends_with_examples_that_can_be_typed(capsys):
    from typer.main import get_command

    from sightline.cli.options import EXAMPLES

    def commands(group, *before):
        for name, one in group.commands.items():
            if hasattr(one, "commands"):
                yield from commands(one, *before, name)
            else:
                yield " ".join([*before, name]), one

    every = dict(commands(get_command(command.app)))
    assert every.keys() == EXAMPLES.keys()
    for name, lines in EXAMPLES.items():
        assert command.run([*name.split(), "--help"]) == 0
        shown = [line.strip() for line in capsys.readouterr().out.splitlines() if line.strip()]
        assert shown[-1 - len(lines) :] == ["Examples:", *(f"sightline {line}" for line in lines)]
        for line in lines:
            words = line.split()
            assert " ".join(words[: len(name.split())]) == name
            every[name].make_context(name, words[len(name.split()) :])  # its arguments and options exist


def test_stages_of_no_time_leave_no_lines_in_a_log(capsys):
    with progress() as report:
        report("matching")
        report("matching", 1, 3)
    said = capsys.readouterr()
    assert said.out == said.err == ""


def test_a_log_gets_a_line_now_and_then_and_one_for_each_finished_stage(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "_EVERY", 0.2)
    monkeypatch.setattr(terminal, "_WORTH_A_LINE", 0.1)
    with progress() as report:
        report("matching", 10, 100)
        time.sleep(0.15)
        report("matching", 40, 100)
        time.sleep(0.15)
        report("writing")
        time.sleep(0.12)
    said = capsys.readouterr()
    lines = said.err.splitlines()
    assert said.out == "" and lines[-1] == "sightline: progress: writing: 0 s"
    assert "sightline: progress: matching: 0 s so far, 40 of 100, about 0 s left" in lines
    assert "sightline: progress: matching: 0 s" in lines


def test_a_run_goes_on_when_nobody_reads_its_log_any_more(monkeypatch):
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    monkeypatch.setattr(terminal, "_WORTH_A_LINE", 0.0)
    monkeypatch.setattr(sys, "stderr", Closed())
    with progress() as report:
        report("matching")
        report("writing")


def test_the_time_left_is_that_of_the_pace_since_the_start(monkeypatch):
    log = terminal._Log()
    now = [100.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    log("frames followed", 600, 1000)  # the first 600 were taken over
    now[0] = 400.0
    log("frames followed", 700, 1000)
    # a hundred in 300 s: 300 more take 900
    assert log._under_way() == "frames followed: 5 min so far, 700 of 1000, about 15 min left"
    log.close(finished=False)


def test_progress_with_a_total_shows_the_time_left(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setenv("TERM", "xterm")
    with progress() as report:
        report("reading")
        for done in range(1, 5):
            report("following", done, 8)
            # the bar is drawn ten times a second
            time.sleep(0.12)
    assert "following" in shown.getvalue() and " left" in shown.getvalue()
    assert " 50 %" in shown.getvalue()


def test_the_share_and_the_time_left_of_a_long_stage_fit_a_narrow_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    for name, value in {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"}.items():
        monkeypatch.setenv(name, value)
    with progress() as report:
        for done in range(1, 5):
            report("pass 1 of at most 4: " + "matching windows of all pairs of bands " * 2, done, 8)
            time.sleep(0.12)
    assert (
        " left" in shown.getvalue()
        and " 50 %" in shown.getvalue()
        and "pass 1 of at most 4" in shown.getvalue()
    )


def test_a_simulated_strip_can_be_checked(tmp_path, capsys):
    scene = tmp_path / "scene"
    size = ["--lines", "400", "--columns", "200"]
    assert command.run(["simulate", "line-of-sight", *size, "--out", str(scene), "--json"]) == 0
    written = json.loads(capsys.readouterr().out)["files"]
    assert sorted(entry.name for entry in scene.iterdir()) == sorted(written)
    assert command.run(["check", str(scene / "acquisition.toml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    lags = {(pair["a"], pair["b"]): pair["lag"] for pair in said["pairs"]}
    # The lag is the look-ahead's tangent times altitude over speed, as the case was laid out.
    assert lags["PAN", "B1"] == pytest.approx(0.1500, abs=1e-6)
    assert lags["B1", "B0"] == pytest.approx(0.0074, abs=1e-6)
    blind = next(
        pair["blind_frequencies"] for pair in said["pairs"] if (pair["a"], pair["b"]) == ("B1", "B0")
    )
    assert blind[0] == pytest.approx(1.0 / 0.0074, rel=1e-3)
    assert command.run(["check", str(scene / "acquisition.toml")]) == 0
    assert "blind at" in capsys.readouterr().out


def test_a_file_that_ends_too_early_is_no_interruption(monkeypatch, capsys):
    def fails(*_, **__):
        raise EOFError("No data left in file")

    monkeypatch.setattr("sightline.cli.check.schema_of", fails, raising=False)
    monkeypatch.setattr("sightline.io.config.schema_of", fails)
    assert command.run(["check", "a.toml"]) == 70
    assert "EOFError: No data left in file" in capsys.readouterr().err


def test_warnings_of_other_libraries_are_not_shown(monkeypatch, capsys):
    def warns(words, **options):
        for category in (RuntimeWarning, UserWarning, DeprecationWarning, FutureWarning):
            warnings.warn("invalid value encountered in sqrt", category, stacklevel=2)

    monkeypatch.setattr(command, "app", warns)
    assert command.run(["version"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "given"),
    [
        *(("SOURCE_DATE_EPOCH", given) for given in ("abc", "1e9", "", "1" * 23)),
        *(("TERMINAL_WIDTH", given) for given in ("abc", " ", "9" * 5000)),
    ],
)
@pytest.mark.parametrize("words", [["version"], ["check", "a.toml"], ["recover", "--help"]])
def test_a_variable_that_libraries_stumble_over_is_refused_before_any_command(
    monkeypatch, capsys, name, given, words
):
    monkeypatch.setenv(name, given)
    assert command.run(words) == 2
    assert f"error: {name} is" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["recover", ""], "a word of the command"),
        (["simulate", "frames", "--scene="], "--scene"),
        (["simulate", "frames", "--scene", "", "--out", "x"], "--scene"),
    ],
)
def test_what_is_empty_is_not_taken_for_the_folder_of_work(capsys, words, name):
    assert command.run(words) == 2
    assert f"error: {name} is empty; give a value" in capsys.readouterr().err


def test_a_variable_that_the_compiler_stumbles_over_is_refused():
    code = (
        "from sightline.cli import main, check\n"
        "check.describe = lambda file: __import__('sightline.compiled')\n"
        "raise SystemExit(main.run(['check', 'a.toml']))"
    )
    given = {**os.environ, "NUMBA_NUM_THREADS": "0"}
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=given, timeout=120)
    assert run.returncode == 2 and "NUMBA_" in run.stderr and "defect" not in run.stderr, run.stderr


def test_what_a_command_lets_be_opened_ends_with_it(tmp_path, monkeypatch):
    from sightline.access import current_access

    met = []
    monkeypatch.setattr("sightline.io.config.schema_of", lambda file: met.append(current_access().network))
    command.run(["check", "a.toml", "--allow-network"])
    command.run(["check", "a.toml"])
    assert met == [True, False] and not current_access().network


READING = (
    "check", "export", "georeference", "init", "layout", "match", "noise", "orient", "recover", "register",
    "score", "tdi", "tie",
)  # fmt: skip


@pytest.mark.parametrize("name", READING)
def test_every_command_that_reads_can_be_let_ask_servers(name, capsys):
    command.run([name, "--help"])
    assert "--allow-network" in capsys.readouterr().out


def test_a_command_takes_from_gdal_and_proj_what_asks_servers():
    code = (
        "import os, sys\n"
        "from sightline.cli.main import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        "import rasterio, pyproj\n"
        "with rasterio.Env() as environment:\n    drivers = environment.drivers()\n"
        "found = [name in drivers for name in ('WMS', 'HTTP', 'GTiff')]\n"
        "print(*found, pyproj.network.is_network_enabled())\n"
    )
    # commands of other tests, run in this process, have taken theirs
    environment = {**os.environ, "GDAL_SKIP": "", "PROJ_NETWORK": "ON"}
    for words, said in (
        (["version"], "False False True False"),
        (["version", "--allow-network"], "True True True True"),
    ):
        run = subprocess.run(
            [sys.executable, "-c", code, *words], capture_output=True, text=True, env=environment, timeout=120
        )
        assert run.stdout.splitlines()[-1] == said, run.stderr


def test_warm_up_leaves_nothing_but_kernels_and_says_what_went_wrong(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        warm_up,
        "JOBS",
        ("simulate stereo --shots 4 --points 30 --out pair", "check pair/stereo.toml"),
    )
    assert command.run(["warm-up"]) == 0
    assert "kept" in capsys.readouterr().out and not list(tmp_path.iterdir())
    monkeypatch.setattr(warm_up, "JOBS", ("orient nothing.toml --out o",))
    assert command.run(["warm-up"]) == 1
    assert "nothing.toml" in capsys.readouterr().err


def test_jobs_of_warm_up_are_those_of_every_command_that_computes():
    assert {job.split()[0] for job in warm_up.JOBS} == {
        "simulate", "recover", "register", "tdi", "orient", "georeference",
    }  # fmt: skip
