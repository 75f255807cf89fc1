"""A read-only package works for a user without a home; the whole demo is tried by validation/read_only.py."""

from __future__ import annotations

import importlib.util
import tempfile
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "validation" / "read_only.py"


@pytest.fixture(scope="module")
def elsewhere():
    if not SCRIPT.is_file():
        pytest.skip("not applicable: validation/ is not part of this copy")
    spec = importlib.util.spec_from_file_location("read_only", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(SCRIPT.parent)  # scripts import their helper beside them
        spec.loader.exec_module(module)
    refused = module.cannot()
    if refused:
        pytest.skip(f"not applicable: a read-only package cannot be tried here, {refused}")
    return module


@pytest.fixture
def open_path():
    """A temporary folder that other users may enter, which those of pytest are not."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


def test_a_read_only_package_works_for_another_user_without_a_home(elsewhere, open_path):
    work, temporary = open_path / "work", open_path / "temporary"
    # few kernels, which are compiled twice here
    words = ["simulate", "stereo", "--shots", "3", "--points", "12", "--out"]
    first = elsewhere.run_elsewhere([*words, "first"], work, temporary)
    assert first.returncode == 0, first.stderr
    notes = [line for line in first.stderr.splitlines() if "note: " in line]
    kept = temporary / f"sightline-kernels-{elsewhere.NOBODY}"
    assert len(notes) == 1 and f"compiled kernels are kept in {kept}," in notes[0]
    assert kept.stat().st_uid == elsewhere.NOBODY and kept.stat().st_mode & 0o777 == 0o700
    written = elsewhere.kernels(temporary)
    again = elsewhere.run_elsewhere([*words, "again"], work, temporary)
    assert again.returncode == 0 and written and elsewhere.kernels(temporary) == written
    bare = elsewhere.run_elsewhere([*words, "bare"], work, temporary, bare=True)
    assert bare.returncode == 0 and "compiled anew in every run" in bare.stderr
    results = [elsewhere.contents(work / name) for name in ("first", "again", "bare")]
    assert results[0] and results[0] == results[1] == results[2]
    assert sorted(path.name for path in work.iterdir()) == ["again", "bare", "first"]
    assert [path.name for path in temporary.iterdir()] == [kept.name]
