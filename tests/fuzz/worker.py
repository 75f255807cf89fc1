"""A process in which cases are run, one after the other, and watched.

``python -m tests.fuzz.worker`` imports the package once and forks a child that runs cases until it dies,
hangs or has found a fault; then the next is forked. A case that brings the process down thus costs no import.
"""

from __future__ import annotations

import json
import mmap
import os
import pkgutil
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

from numba.core import event

#: Bytes of resident memory that no case may need.
MOST_MEMORY = 2 << 30
#: s of CPU that no case may need.
MOST_SECONDS = 20.0
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


# The parent's side ------------------------------------------------------------------------------------------


class Worker:
    """Runs cases in another process.

    Parameters
    ----------
    folder : Path
        Where it may keep files of its own.
    more : str
        Module with further readers, which its ``register`` adds; none by default.
    """

    def __init__(self, folder: Path, more: str = "") -> None:
        self._folder, self._more = folder, more
        folder.mkdir(parents=True, exist_ok=True)
        self._log = folder / "worker.log"
        self._process: subprocess.Popen[bytes] | None = None

    def run(self, reader: str, case: Path, more: list[str], patience: float) -> dict[str, Any]:
        """What became of a case: see ``_watched``; ``died`` or ``hung`` where the process did not survive it.

        A case that does nothing for `patience` s on the clock is ended.
        """
        if self._process is None or self._process.poll() is not None:
            self._start()
        assert self._process is not None and self._process.stdin is not None
        self._process.stdin.write(
            json.dumps({"reader": reader, "case": str(case), "more": more, "patience": patience}).encode()
            + b"\n"
        )
        self._process.stdin.flush()
        answer = self._answer(3600.0)
        if answer is None:
            self.close()
            return {"hung": True, "seconds": patience, "where": _tail(self._log)}
        return answer

    def _start(self) -> None:
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.fuzz.worker", str(self._folder), self._more],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=os.environ | {"OMP_NUM_THREADS": "1", "TMPDIR": str(self._folder)},
            )
        if self._answer(300.0) != {"ready": True}:
            raise RuntimeError(f"the worker of the fuzzer does not start: {_tail(self._log)}")

    def _answer(self, seconds: float) -> dict[str, Any] | None:
        assert self._process is not None and self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], seconds)[0]:
            return None
        line = self._process.stdout.readline()
        return (
            json.loads(line)
            if line
            else {"died": "the worker ended", "where": _tail(self._log), "seconds": 0.0}
        )

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def _tail(path: Path) -> str:
    """The end of a log, without faulthandler's list of modules."""
    text = path.read_text(errors="replace") if path.is_file() else ""
    return text.split("Extension modules:")[0][-3000:]


# The side that forks ----------------------------------------------------------------------------------------


def _serve(folder: Path, more: str) -> None:
    """Fork a child, hand it the cases of stdin, replace it when it is gone."""
    _prepare(more)
    compiling = mmap.mmap(-1, 1)
    _say({"ready": True})
    child: tuple[int, int, int] | None = None
    for line in sys.stdin.buffer:
        child = child or _fork(folder, compiling)
        pid, ask, tell = child
        os.write(ask, line)
        got = _got(pid, tell, json.loads(line)["patience"], compiling)
        if got:
            answer = json.loads(got)
            if not answer.pop("last"):
                _say(answer)
                continue
        else:
            answer = {} if got is not None else {"hung": True}
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGABRT)  # faulthandler says where
            time.sleep(0.3)
            answer |= {"seconds": MOST_SECONDS if answer else 0.0, "where": _tail(folder / "fault.log")}
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        if "status" not in answer and "hung" not in answer:
            number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
            answer["died"] = signal.Signals(number).name if number else f"status {os.WEXITSTATUS(status)}"
        os.close(ask)
        os.close(tell)
        child = None
        _say(answer)


def _say(answer: dict[str, Any]) -> None:
    os.write(1, json.dumps(answer).encode() + b"\n")


def _prepare(more: str) -> None:
    """Everything that is imported sooner or later, once."""

    import sightline

    for module in pkgutil.walk_packages(sightline.__path__, "sightline."):
        if not module.name.startswith(("sightline.cli.demo", "sightline.__main__")):
            import_module(module.name)
    import_module("rasterio.warp")
    import_module("tests.fuzz.readers")
    if more:
        import_module(more).register()


def _got(pid: int, tell: int, patience: float, compiling: mmap.mmap) -> bytes | None:
    """What a child answers; nothing where it dies; None where it does nothing for `patience` s, or hangs.

    Kernels that are compiled when first used are no part of the time.
    """
    got, done, idle = b"", _cpu(pid), time.monotonic()
    until = done + 2.0 * MOST_SECONDS
    while not got.endswith(b"\n"):
        if select.select([tell], [], [], 0.5)[0]:
            part = os.read(tell, 1 << 20)
            if not part:
                return b""
            got += part
            continue
        now = _cpu(pid)
        if compiling[0]:
            until = now + 2.0 * MOST_SECONDS
        if now - done > 0.05:
            done, idle = now, time.monotonic()
        if now > until or time.monotonic() - idle > patience:
            return None
    return got


def _cpu(pid: int) -> float:
    """s of CPU that a process has used, as Linux tells it; s on the clock elsewhere."""
    with suppress(OSError):
        words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    return time.monotonic()


def _fork(folder: Path, compiling: mmap.mmap) -> tuple[int, int, int]:
    there_in, there_out = os.pipe(), os.pipe()
    pid = os.fork()
    if pid:
        os.close(there_in[0])
        os.close(there_out[1])
        return pid, there_in[1], there_out[0]
    os.close(there_in[1])
    os.close(there_out[0])
    try:
        _child(folder, there_in[0], there_out[1], compiling)
    finally:
        os._exit(3)


# The child --------------------------------------------------------------------------------------------------


def _child(folder: Path, ask: int, tell: int, compiling: mmap.mmap) -> None:
    """Run the cases that come, until one has left traces."""
    import faulthandler

    fault = (folder / "fault.log").open("w+b")
    faulthandler.enable(fault)
    held = _bytes_of("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (held + MOST_MEMORY, held + MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _stop_the_work()
    seen, compiled = _Watch(), _Compiled(compiling)
    with os.fdopen(ask, "rb") as lines:
        for line in lines:
            fault.seek(0)
            fault.truncate()
            given = json.loads(line)
            answer = _watched(given["reader"], given["more"], Path(given["case"]), folder, seen, compiled)
            # a failure may leave the process in a state of its own
            answer["last"] = answer.get("status") not in (0, 1, 2) or answer["memory"] > MOST_MEMORY // 2
            os.write(tell, json.dumps(answer).encode() + b"\n")


def _watched(
    reader: str, more: list[str], case: Path, folder: Path, seen: _Watch, compiled: _Compiled
) -> dict[str, Any]:
    """Run one case.

    Returns
    -------
    dict
        ``status`` (what the command gave; of a Python reader that of its exception, 70 where it was none of
        ours), ``error`` (its text), ``where`` (innermost line of the package), ``said`` (all of stderr),
        ``stdout`` (all of it), ``warned``, ``seconds`` (CPU, without that of compiling kernels),
        ``memory`` (largest resident size), ``strayed`` (what it should not have written, asked
        or started), ``check`` (status of `check` where the command called the input wrong).
    """
    import warnings

    from tests.fuzz.readers import READERS

    from sightline.cli.main import run

    row = READERS[reader]
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir(exist_ok=True)
    os.chdir(elsewhere)
    _forget_peak()
    answer: dict[str, Any] = {"status": 0, "error": "", "where": "", "kind": ""}
    begun, compiled.seconds = time.process_time(), 0.0
    with _Captured() as captured, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        seen.begin(case)
        try:
            status = row.call(case, *([more] if more else []))
            answer["status"] = 0 if status is None else status
        except BaseException as error:
            answer |= {"status": _status_of(error), "error": str(error), "kind": type(error).__name__}
            answer["where"] = _where(error)
        finally:
            strayed = seen.end()
    answer["seconds"] = time.process_time() - begun - compiled.seconds
    answer["memory"] = _bytes_of("VmHWM")
    answer["said"], answer["stdout"] = captured.texts()
    answer["warned"] = [f"{w.category.__name__}: {w.message}" for w in warned]
    if row.words and answer["status"] not in (0, 1, 2):
        answer["where"], answer["kind"] = _again([*row.words, *more], case)
    if row.check and answer["status"] == 2:
        with _Captured():
            answer["check"] = run(["check", str(case / row.check)])
    answer["strayed"] = strayed + [f"left {path.name}" for path in elsewhere.iterdir()]
    return answer


def _again(words: list[str], case: Path) -> tuple[str, str]:
    """Where a command failed: the same once more, with the exception left to rise."""
    from tests.fuzz.readers import spoken

    from sightline.cli.main import run

    with _Captured():
        try:
            run(spoken(words, case), debug=True)
        except BaseException as error:
            return _where(error), type(error).__name__
    return "", ""


def _status_of(error: BaseException) -> int:
    from sightline.errors import EstimationError, GeometryError, SightlineError

    if not isinstance(error, SightlineError):
        return 70
    return 1 if isinstance(error, EstimationError | GeometryError) or type(error) is SightlineError else 2


def _where(error: BaseException) -> str:
    """Innermost line of the package in a traceback, and the kind of the exception."""
    place, step = "", error.__traceback__
    while step is not None:
        name = step.tb_frame.f_code.co_filename
        if "/sightline/" in name:
            place = f"{name.rsplit('/sightline/', 1)[1]}:{step.tb_lineno}"
        step = step.tb_next
    return place


class _Compiled(event.Listener):
    """Seconds of CPU in which numba compiled kernels; `flag` is 1 while it does."""

    def __init__(self, flag: mmap.mmap) -> None:
        self.seconds, self._flag, self._depth, self._begun = 0.0, flag, 0, 0.0
        flag[0] = 0
        event.register("numba:compile", self)

    def on_start(self, _: Any) -> None:
        if self._depth == 0:
            self._begun, self._flag[0] = time.process_time(), 1
        self._depth += 1

    def on_end(self, _: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.process_time() - self._begun
            self._flag[0] = 0


class _Captured:
    """What a case says, from C libraries too."""

    def __enter__(self) -> _Captured:
        sys.stdout.flush()
        sys.stderr.flush()
        self._files = [tempfile.TemporaryFile(), tempfile.TemporaryFile()]
        self._kept = [os.dup(2), os.dup(1)]
        for number, file in zip((2, 1), self._files, strict=True):
            os.dup2(file.fileno(), number)
        return self

    def __exit__(self, *_: object) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, kept in zip((2, 1), self._kept, strict=True):
            os.dup2(kept, number)
            os.close(kept)
        self._texts = []
        for file in self._files:
            file.seek(0)
            self._texts.append(file.read(1 << 20).decode("utf-8", "replace"))
            file.close()

    def texts(self) -> list[str]:
        return self._texts


#: Audit events and how many of their arguments are paths that are changed; those that no case may raise.
_PATHS = {
    "os.remove": 1, "os.rename": 2, "os.mkdir": 1, "os.rmdir": 1, "os.symlink": 2, "os.link": 2,
    "os.truncate": 1, "os.chmod": 1, "os.chown": 1, "os.utime": 1, "shutil.rmtree": 1, "shutil.move": 2,
}  # fmt: skip
_NEVER = (
    "socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn",
    "pickle.find_class",
)  # fmt: skip


class _Watch:
    """What is written outside a case, asked of the network, or started, as Python's audit events tell it."""

    def __init__(self) -> None:
        self._allowed: tuple[str, ...] | None = None
        self._found: list[str] = []
        self._cache = tuple(
            filter(None, [os.environ.get("NUMBA_CACHE_DIR"), str(Path(tempfile.gettempdir())), "/dev/null"])
        )
        sys.addaudithook(self._event)

    def begin(self, case: Path) -> None:
        self._found, self._allowed = [], (str(case), *self._cache)

    def end(self) -> list[str]:
        self._allowed = None
        return self._found

    def _event(self, name: str, arguments: tuple[Any, ...]) -> None:
        if self._allowed is None:
            return
        if name in _NEVER:
            if not (name == "pickle.find_class" and _compiling()):
                self._found.append(f"{name} {str(arguments)[:200]}")
        elif name == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & _WRITES:
                self._note(name, path)
        elif name in _PATHS:
            for path in arguments[: _PATHS[name]]:
                self._note(name, path)

    def _note(self, event: str, path: Any) -> None:
        assert self._allowed is not None
        if isinstance(path, int):
            return
        text = os.path.abspath(os.fsdecode(path))
        if not text.startswith(self._allowed) and "__pycache__" not in text:
            self._found.append(f"{event} {text}")


def _compiling() -> bool:
    """Whether numba, which keeps its compiled functions as pickles, is at work."""
    frame: FrameType | None = sys._getframe()
    while frame is not None:
        if "/numba/" in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False


def _stop_the_work() -> None:
    """Long work is left out of the commands: what they read before it is what is tried."""
    from sightline.applications import line_of_sight, sequence_poses
    from sightline.errors import EstimationError

    def stop(*_: object, **__: object) -> None:
        raise EstimationError("acquisition.toml, sequence.toml: read; the fuzzer goes no further")

    for module, name in ((line_of_sight, "recover_line_of_sight"), (sequence_poses, "georeference_sequence")):
        assert callable(getattr(module, name))
        setattr(module, name, stop)


def _bytes_of(name: str) -> int:
    """A size of this process as Linux tells it; 0 elsewhere."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(f"{name}:"):
                return int(line.split()[1]) << 10
    return 0


def _forget_peak() -> None:
    """Begin to count the largest resident size anew."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


if __name__ == "__main__":
    _serve(Path(sys.argv[1]), sys.argv[2])
