"""Kernels start wherever the package lies, whoever runs it, and load nothing that somebody else put there."""

from __future__ import annotations

import gc
import importlib.util
import os
import pickle
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core import config, event
from numba.core.errors import TypingError

from sightline import compiled

KERNELS = """
from sightline.compiled import njit

@njit(cache=True, nogil=True)
def doubled(x):
    return x + x
"""
posix = pytest.mark.skipif(os.name != "posix", reason="not applicable: owners and modes are those of POSIX")


class Place:
    """A package whose folder cannot be written, a home that is none, an empty temporary directory.

    Files stand where folders should be: nobody can write there, not even root.
    """

    def __init__(self, base: Path, patch: pytest.MonkeyPatch) -> None:
        self.package, self.home, self.temporary = base / "package", base / "home", base / "temporary"
        self.package.mkdir()
        self.temporary.mkdir()
        (self.package / "__pycache__").write_text("")
        (self.package / "kernels.py").write_text(KERNELS)
        self.home.write_text("")
        self.kept = self.temporary / f"sightline-kernels-{os.getuid() if os.name == 'posix' else 'own'}"
        self._patch = patch
        for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
            patch.delenv(name, raising=False)
        patch.setenv("HOME", str(self.home))
        patch.setenv("LOCALAPPDATA", str(self.home))
        patch.setattr(config, "CACHE_DIR", "")
        patch.setattr(tempfile, "tempdir", str(self.temporary))

    def start(self) -> ModuleType:
        """The module with the kernel, as a new process would import it."""
        compiled._temporary_folder.cache_clear()
        compiled._say.cache_clear()
        spec = importlib.util.spec_from_file_location("kernels_elsewhere", self.package / "kernels.py")
        module = importlib.util.module_from_spec(spec)
        self._patch.setitem(sys.modules, "kernels_elsewhere", module)
        spec.loader.exec_module(module)
        return module

    def files(self, ending: str) -> list[Path]:
        return sorted(self.kept.rglob(f"*.{ending}"))


@pytest.fixture
def place(tmp_path, monkeypatch):
    yield Place(tmp_path, monkeypatch)
    compiled._temporary_folder.cache_clear()
    compiled._say.cache_clear()


def said(capsys) -> list[str]:
    return capsys.readouterr().err.splitlines()


def hits(kernel) -> int:
    return sum(kernel.stats.cache_hits.values())


def test_kernels_are_kept_in_a_folder_of_this_user_where_nothing_else_can_be_written(place, capsys):
    first = place.start().doubled
    assert first(2) == 4 and hits(first) == 0
    assert Path(first.stats.cache_path).parent == place.kept
    if os.name == "posix":
        assert stat.S_IMODE(place.kept.stat().st_mode) == 0o700
    (line,) = said(capsys)
    assert line.startswith(f"sightline: note: compiled kernels are kept in {place.kept}, ")
    again = place.start().doubled
    assert again(2) == 4 and hits(again) == 1


def test_a_folder_that_the_user_names_prevails_and_nothing_is_said(place, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "named"))
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "named"))
    kernel = place.start().doubled
    assert kernel(2) == 4
    assert Path(kernel.stats.cache_path).parent == tmp_path / "named"
    assert not place.kept.exists() and said(capsys) == []


def test_a_named_folder_that_cannot_be_written_is_named_in_the_line(place, capsys, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(place.home))
    assert place.start().doubled(2) == 4
    (line,) = said(capsys)
    assert f"NUMBA_CACHE_DIR={place.home}" in line and str(place.kept) in line


def test_the_package_and_the_home_folder_come_before_the_temporary_directory(place, capsys, monkeypatch):
    place.home.unlink()
    place.home.mkdir()
    assert str(place.home) in place.start().doubled.stats.cache_path
    (place.package / "__pycache__").unlink()
    assert place.start().doubled.stats.cache_path == str(place.package / "__pycache__")
    assert not place.kept.exists() and said(capsys) == []


def test_a_home_folder_that_is_no_path_is_not_taken_for_one_in_the_working_directory(
    place, monkeypatch, tmp_path
):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for home in ("~", ".", "home"):
        monkeypatch.setenv("HOME", home)
        assert Path(place.start().doubled.stats.cache_path).parent == place.kept
    assert list(Path().iterdir()) == []


class Evil:
    """What runs when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


def plant(place: Place, trace: Path) -> None:
    """A folder of kept kernels whose index, when it is read, leaves `trace`."""
    assert place.start().doubled(2) == 4
    (index,) = place.files("nbi")
    index.write_bytes(pickle.dumps(Evil(trace)))


@posix
def test_what_is_planted_in_the_folder_would_run_if_it_were_loaded(place, tmp_path):
    # what the next tests stand on: in a folder that passes for this user's own the same file does run
    plant(place, tmp_path / "ran")
    kernel = place.start().doubled
    assert kernel(2) == 4 and hits(kernel) == 0
    assert (tmp_path / "ran").exists()


@posix
@pytest.mark.parametrize("how", ["open to all", "open to a group", "a link", "of another user", "a file"])
def test_a_folder_that_another_user_could_have_filled_is_never_loaded_from(place, capsys, tmp_path, how):
    plant(place, tmp_path / "ran")
    if how == "open to all":
        place.kept.chmod(0o777)
    elif how == "open to a group":
        place.kept.chmod(0o770)
    elif how == "a link":
        place.kept.rename(tmp_path / "elsewhere")
        place.kept.symlink_to(tmp_path / "elsewhere")
    elif how == "of another user":
        if os.geteuid() != 0:
            pytest.skip("not applicable: only root gives a folder to another user")
        os.chown(place.kept, 65534, 65534)
    else:
        place.kept.rename(tmp_path / "elsewhere")
        place.kept.write_text("")
    capsys.readouterr()
    kernel = place.start().doubled
    assert kernel(2) == 4 and hits(kernel) == 0
    assert not (tmp_path / "ran").exists()
    folder = Path(kernel.stats.cache_path).parent
    assert folder.parent == place.temporary and folder != place.kept
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)  # worker processes share it
    (line,) = said(capsys)
    assert str(folder) in line and str(place.kept) in line and "until this run ends" in line


@posix
def test_a_folder_that_is_opened_to_others_while_a_run_lasts_is_loaded_from_no_more(place, tmp_path):
    plant(place, tmp_path / "ran")
    kernel = place.start().doubled
    place.kept.chmod(0o777)
    assert kernel(2) == 4
    assert not (tmp_path / "ran").exists()


@posix
def test_a_cache_folder_at_home_that_others_can_write_is_not_used(place):
    place.home.unlink()
    (place.home / ".cache" / "numba").mkdir(parents=True)
    (place.home / ".cache" / "numba").chmod(0o777)
    assert Path(place.start().doubled.stats.cache_path).parent == place.kept


def test_kernels_work_where_nothing_at_all_can_be_written_and_that_is_said_once(place, capsys, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(place.home))
    module = place.start()
    assert module.doubled(2) == 4 and module.doubled.stats.cache_path is None
    (line,) = said(capsys)
    assert "compiled anew in every run" in line and "NUMBA_CACHE_DIR" in line


def test_the_working_directory_does_not_pass_for_a_temporary_one(place, monkeypatch, tmp_path):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "here"))  # Python's last resort
    assert place.start().doubled.stats.cache_path is None
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("length", [0, 10])
def test_a_damaged_file_is_compiled_again_and_replaced(place, ending, length):
    assert place.start().doubled(2) == 4
    (file,) = place.files(ending)
    file.write_bytes(file.read_bytes()[:length])
    damaged, after = place.start().doubled, place.start().doubled
    assert damaged(2) == 4 and hits(damaged) == 0
    assert after(2) == 4 and hits(after) == 1


def test_a_temporary_directory_that_is_tidied_while_a_run_lasts_ends_nothing(place):
    kernel = place.start().doubled
    Path(kernel.stats.cache_path).rmdir()
    place.kept.rmdir()
    assert kernel(2) == 4
    if os.name == "posix":
        assert stat.S_IMODE(place.kept.stat().st_mode) == 0o700
    again = place.start().doubled
    assert again(2) == 4 and hits(again) == 1


def test_a_disk_that_is_full_ends_nothing_and_is_said_once(place, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    kernel = place.start().doubled
    monkeypatch.setattr(kernel._cache._cache_file, "_save_index", full)
    assert kernel(2) == 4 and kernel(2.0) == 4.0
    _, line = said(capsys)
    assert (
        line == f"sightline: note: compiled kernels cannot be kept in {place.kept}: No space left on device"
    )


def test_two_signatures_never_share_a_file_whatever_the_order_in_which_processes_compile_them(place):
    assert place.start().doubled(2) == 4
    (first,) = place.files("nbc")
    first.rename(first.with_name("aside"))
    (index,) = place.files("nbi")
    index.unlink()
    assert place.start().doubled(2.5) == 5.0
    (second,) = place.files("nbc")
    assert first.name != second.name
    (second.with_name("aside")).rename(first)
    both = place.start().doubled
    assert both(2.5) == 5.0 and hits(both) == 1
    assert both(2) == 4 and hits(both) == 1


def test_worker_processes_share_the_folder_and_leave_the_line_to_the_one_that_started_them(place):
    (place.package / "work.py").write_text(
        "import kernels\n"
        "def work(x):\n"
        "    return kernels.doubled(x), kernels.doubled.stats.cache_path\n"
        "if __name__ == '__main__':\n"
        "    from sightline.execution import process\n"
        "    with process(2) as executor:\n"
        "        for value, path in executor.map(work, [1, 2, 3]):\n"
        "            print(value, path)\n"
    )
    source = str(Path(compiled.__file__).parents[1])
    environment = {**os.environ, "TMPDIR": str(place.temporary), "TEMP": str(place.temporary)}
    environment["PYTHONPATH"] = os.pathsep.join([source, str(place.package)])
    ran = subprocess.run(
        [sys.executable, str(place.package / "work.py")],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    rows = [line.split(maxsplit=1) for line in ran.stdout.splitlines()]
    assert [value for value, _ in rows] == ["2", "4", "6"]
    assert {Path(path).parent for _, path in rows} == {place.kept}
    assert ran.stderr.count("compiled kernels are kept in") == 1 and len(ran.stderr.splitlines()) == 1


def test_what_may_round_freely_stands_in_its_callers_code():
    # where a call is left, code of the same name that another process kept may answer it, and round otherwise
    @compiled.njit(cache=False, fastmath=True)
    def rounded_helper(values, k):
        total = 0.0
        for j in range(len(values)):
            total += values[j] * values[j] * k
        for j in range(len(values) - 1):  # of a size at which the compiler leaves the call
            total += np.sin(values[j]) * np.exp(values[j + 1]) - np.exp(values[j]) * np.sin(values[j + 1])
        return total

    @compiled.njit(cache=False, fastmath=True)
    def caller(values):
        return sum([rounded_helper(values, k) for k in range(9)]) + rounded_helper(values, 9)

    assert caller(np.ones(5)) == pytest.approx(5.0 * 45, rel=1e-12)  # summed in an order of its own
    (code,) = caller.inspect_asm().values()
    assert "caller" in code
    assert not [line for line in code.splitlines() if "rounded_helper" in line and "NumbaEnv" not in line]


@pytest.mark.parametrize("sought", [True, False])
def test_cycles_are_not_sought_while_a_kernel_is_compiled_and_again_afterwards_where_they_were(sought):
    seen = []

    class Heard(event.Listener):
        def on_start(self, begun):
            seen.append(gc.isenabled())

        def on_end(self, ended):
            pass

    heard, inner = Heard(), compiled.njit(cache=False)(lambda x: x + 1)
    outer, wrong = (
        compiled.njit(cache=False)(lambda x: inner(x) * 2),
        compiled.njit(cache=False)(lambda x: x.no),
    )
    event.register("numba:compile", heard)  # after that of the module
    was = gc.isenabled()
    try:
        (gc.enable if sought else gc.disable)()
        assert outer(1) == 4 and gc.isenabled() is sought
        with pytest.raises(TypingError):
            wrong(1)
        assert gc.isenabled() is sought
    finally:
        event.unregister("numba:compile", heard)
        (gc.enable if was else gc.disable)()
    assert len(seen) >= 3 and not any(seen)
