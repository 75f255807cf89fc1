"""Spoilt inputs for every reader: one clear error each, within bounds of time and memory, nothing touched.

The cases of the last test are the same in every run; ``make fuzz`` draws new ones.
"""

from __future__ import annotations

import inspect
import pkgutil
import re
import sys
from importlib import import_module

import pytest
from tests.fuzz.hunt import kept_case
from tests.fuzz.mutations import Case, Special
from tests.fuzz.planted import FAULTS, PLANTED
from tests.fuzz.readers import READERS, Reader

import sightline.io

#: Functions of ``sightline.io`` with such names that take a path, or a part of a TOML file, open a file.
OPENS = re.compile(
    r"^(read|load|open|probe|first|header|kind|is|has|line_of|origin_of|positions_from|score)(_|ed$|$)"
)
#: Those that get a part of a TOML file: `check` calls them, and a seed below `check` must reach each.
BY_CHECK = {
    "acquisition.load.read_control", "acquisition.load.read_known_motion", "acquisition.load.read_matching",
    "acquisition.load.read_sensor",
    "acquisition.bands.open_band_image", "sequence.frames.probe_frames", "sequence.frames.read_frames",
    "sequence.rigs.read_rig",
}  # fmt: skip
SEED = 20260101


@pytest.mark.parametrize("name", READERS)
def test_what_is_not_spoilt_is_taken(hunter, name):
    row = READERS[name]
    answer, faults = hunter.judge(row, Case(dict(hunter.files_of(row.seed))))
    assert not faults
    stopped = "the fuzzer goes no further" in str(answer.get("said"))
    assert answer["status"] == (1 if stopped else 0), answer


def opening_functions() -> dict[str, object]:
    """Every public function of ``sightline.io`` that opens a file, as ``module.function``."""
    found = {}
    for module in pkgutil.walk_packages(sightline.io.__path__, "sightline.io."):
        for name, function in vars(import_module(module.name)).items():
            own = inspect.isfunction(function) and function.__module__ == module.name
            takes = " ".join(str(given) for given in getattr(function, "__annotations__", {}).values())
            if own and OPENS.match(name) and re.search("Path|InputFolder|FrameList", takes):
                found[f"{module.name.removeprefix('sightline.io.')}.{name}"] = function
    return found


def test_every_function_that_opens_a_file_is_fuzzed():
    covered = {place for row in READERS.values() for place in row.covers}
    left_out = sorted(set(opening_functions()) - covered - BY_CHECK)
    assert not left_out, f"add a row to tests/fuzz/readers.py for: {', '.join(left_out)}"


def test_what_is_read_for_check_is_reached_by_its_seeds(seeds):
    called = set()
    files = {function.__code__: place for place, function in opening_functions().items()}

    def note(frame, *_):  # of functions written in Python alone, and of no line of them
        if frame.f_code in files:
            called.add(files[frame.f_code])

    for row in READERS.values():
        if row.words[:1] == ("check",) and not row.name.endswith("names"):
            sys.settrace(note)
            try:
                assert row.call(seeds / row.seed) == 0
            finally:
                sys.settrace(None)
    assert called >= BY_CHECK


# The fuzzer finds what it is to find ------------------------------------------------------------------------


@pytest.mark.parametrize("name", PLANTED)
def test_a_reader_with_a_fault_is_found_out(hunter, name):
    _, faults = hunter.judge(PLANTED[name], Case(dict(hunter.files_of("level"))))
    assert any(fault.startswith(FAULTS[name]) for fault in faults), faults


def test_a_failing_case_is_kept_and_read_back(hunter, tmp_path):
    row = READERS["io.config.read_toml"]
    case = Case({"acquisition.toml": b"x = 1", "fifo": Special("fifo")}, ["x"])
    hunter._keep_case(row, case, "a fault", "its words", {"status": 70})
    folder = hunter.findings.pop((row.name, "a fault")).folder
    again, kept = kept_case(folder)
    assert (again, kept.files, kept.edits) == (row, case.files, case.edits)


# The cases themselves ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", range(8))
def test_spoilt_inputs_end_with_one_clear_error(hunter, part):
    hunter.findings.clear()
    for k, (name, row) in enumerate(READERS.items()):
        if k % 8 == part:
            hunter.hunt(name, inputs_of(row), SEED + k)
    said = [
        f"{found.reader}: {found.fault} after {', '.join(found.edits)}; "
        f"python -m tests.fuzz --repeat {found.folder}"
        for found in hunter.findings.values()
    ]
    assert not said, "\n".join(said)


def inputs_of(row: Reader) -> int:
    """A few of each: ``make fuzz`` tries as many as time allows. Commands take longer than functions."""
    return 2 if row.words else 5
