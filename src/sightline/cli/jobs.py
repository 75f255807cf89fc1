"""Command lines that run where an executor has them run: of one command, and of every input of a batch.

What a job does is what the command line does, word by word, so that its files are those of the command. Here
is what surrounds it: on which words, what is said of it, what is kept of an earlier run.

Not here: which inputs there are, and what is shown of them (``batch.py``); the workers (``execution.py``).
"""

from __future__ import annotations

import io
import json
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, replace
from functools import partial
from hashlib import sha256
from multiprocessing import parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sightline.access import SMALL, read_bytes, shut_network
from sightline.cli.statuses import HUNG_UP, INTERRUPTED, TERMINATED, status_of
from sightline.errors import InputError, SightlineError
from sightline.execution import Executor, ProcessExecutor, Workers, available_processors, executor_from_name
from sightline.inputs import apart, unchanged
from sightline.output.lock import HELD
from sightline.output.publish import file_kind
from sightline.version import VERSION
from sightline.writing import whole_text

if TYPE_CHECKING:
    from sightline.applications.batch import JobOutcome

#: Below the folder of a batch: what is kept of each input, by which a later batch knows what is done.
RECORDS = ".batch"
#: Commands that take ``--workers`` in the sense of one job.
ONE_JOB = frozenset(("recover", "georeference", "orient", "register", "tdi", "layout", "match", "tie"))
#: Those that keep finished stages.
_STAGED = frozenset(("recover", "georeference", "tdi"))
#: s that a job waits for one that still writes into its folder: on a cluster whose scheduler was lost, or cut
#: off from it, a job goes on to its end.
_WAITS, _LOOKS = 300.0, 2.0


#: What runs a command line and gives its exit status.
Run = Callable[..., int]
_run: list[Run] = []


def serve(run: Run) -> None:
    """Hang in what runs a command line, which imports this file; it does so once."""
    _run[:] = [run]


def job_runner() -> Callable[[Job], JobOutcome]:
    """What a worker does with an input of a batch."""
    return partial(run_job, _run[0])


# --------------------------------------------------------------------------------- one command elsewhere


@dataclass(frozen=True)
class CommandLine:
    """Words for a worker.

    Attributes
    ----------
    words : tuple of str
    place : str
        Folder in which they were typed.
    debug : bool
    captured : bool
        Whether what is printed is brought back; else it goes where the worker's goes.
    """

    words: tuple[str, ...]
    place: str
    debug: bool
    captured: bool


@dataclass(frozen=True)
class Said:
    """Exit status of a command line, and what it has printed."""

    status: int
    out: str = ""
    err: str = ""


def elsewhere(words: list[str], *, debug: bool) -> int | None:
    """Run a command on the worker that its ``--workers`` asks for, and give its exit status.

    None where it asks for none, or for threads of this process.
    """
    if not words or words[0] not in ONE_JOB:
        return None
    asked, others = _without_workers(words)
    if asked is None:
        return None
    workers = Workers.read(asked)
    if workers.kind == "here":
        return None
    with _one_worker(workers) as executor:
        line = CommandLine(tuple(others), os.getcwd(), debug, captured=workers.kind == "dask")
        ((_, said),) = executor.completed(partial(run_words, _run[0]), [line], lost=_lost_line)
    sys.stdout.write(said.out)
    sys.stderr.write(said.err)
    return said.status


def _one_worker(workers: Workers) -> Executor:
    """An executor for one job."""
    if workers.kind == "dask":
        return executor_from_name(f"dask:{workers.address}")
    return ProcessExecutor(1, threads=workers.count or available_processors())


def _without_workers(words: list[str]) -> tuple[str | None, list[str]]:
    """The value of ``--workers``, the last one if there are several, and all other words."""
    value, others, rest = None, [], iter(words)
    for word in rest:
        if word == "--workers":
            value = next(rest, None)
        elif word.startswith("--workers="):
            value = word.partition("=")[2]
        else:
            others.append(word)
    return value, others


def _lost_line(line: CommandLine, how: str) -> Said:
    raise SightlineError(f"{how}; most often memory ran out: give it a worker with more")


def run_words(run: Run, line: CommandLine) -> Said:
    """What a worker does with a command line; KeyboardInterrupt where it was asked to end."""
    with _ready(line.place, "--allow-network" in line.words):
        if not line.captured:
            return Said(_went(run(list(line.words), debug=line.debug)))
        with _captured() as (out, err):
            status = _went(run(list(line.words), debug=line.debug))
        return Said(status, out.getvalue(), err.getvalue())


def _went(status: int) -> int:
    """The exit status, unless the command was stopped: then it has to be begun again, or all ends."""
    if status in (INTERRUPTED, TERMINATED, HUNG_UP):
        raise KeyboardInterrupt
    return status


@contextmanager
def _ready(place: str, network: bool) -> Iterator[None]:
    """A worker as the command line finds its own process: in the folder of its words, without a network."""
    if parent_process() is not None and not network:  # the process of the command line has done so itself
        shut_network()
    before = os.getcwd()
    try:
        os.chdir(place)
    except OSError as error:
        raise InputError(
            f"the folder {place} is not there on the worker {socket.gethostname()} ({error.strerror}): all "
            "workers must see the same files under the same names"
        ) from error
    try:
        yield
    finally:
        os.chdir(before)


@contextmanager
def _captured() -> Iterator[tuple[io.StringIO, io.StringIO]]:
    """What is printed in the block."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        yield out, err


# --------------------------------------------------------------------------------- an input of a batch


@dataclass(frozen=True)
class Job:
    """One input of a batch.

    Attributes
    ----------
    name : str
        Of its folder.
    file, out : str
        The input, and the folder of the batch, as they were given.
    place : str
        Folder in which that was.
    batch : str
        Distinguishes this batch from any other.
    overwrite, resume, allow_network : bool
        As given.
    version : str
        Of Sightline, where the batch was begun.
    """

    name: str
    file: str
    out: str
    place: str
    batch: str
    overwrite: bool
    resume: bool
    allow_network: bool
    version: str = VERSION

    @property
    def folder(self) -> Path:
        """Of its result."""
        return Path(self.out, self.name)

    @property
    def record(self) -> Path:
        """What is kept of it."""
        return Path(self.out, RECORDS, f"{self.name}.json")


def run_job(run: Run, job: Job) -> JobOutcome:
    """What a worker does with an input: its own command into its own folder; never raises but to end.

    One that an earlier batch, or this one on a worker that was lost afterwards, has done is left as it is.
    """
    from sightline.applications.batch import JobOutcome

    begun, cpu = time.perf_counter(), time.process_time()
    outcome = JobOutcome(job.name, job.file, worker=f"{socket.gethostname()}:{os.getpid()}")
    with _captured() as (_, err):
        try:
            # what a job reads is no input of the batch around it, which may end days later
            with _ready(job.place, job.allow_network), apart(job.folder):
                outcome = _done(run, job, outcome, err)
        except Exception as error:
            outcome = replace(outcome, status=status_of(error))
    if outcome.status and not outcome.message:
        outcome = replace(outcome, message=_why(err.getvalue()))
    if outcome.kept or outcome.wall_seconds:
        return outcome
    return replace(outcome, wall_seconds=time.perf_counter() - begun, cpu_seconds=time.process_time() - cpu)


def lost_job(job: Job, how: str) -> JobOutcome:
    """The outcome of an input whose workers ended again and again."""
    from sightline.applications.batch import JobOutcome

    return JobOutcome(
        job.name, job.file, status=1, message=f"{how}; most often memory ran out: use fewer workers"
    )


def _done(run: Run, job: Job, outcome: JobOutcome, err: io.StringIO) -> JobOutcome:
    """The outcome of an input, its own times left out where an earlier run has them."""
    from sightline.applications.batch import JobOutcome
    from sightline.io.results.line_of_sight import peak_memory

    if job.version != VERSION:
        raise InputError(
            f"the worker {outcome.worker} has Sightline {VERSION}, and the batch was begun by {job.version}: "
            "results would differ; install the same on all"
        )
    _refuse_links(job)
    earlier = _earlier(job.record)
    ours = earlier.get("batch") == job.batch
    if (job.resume or ours) and _holds(job, earlier):
        return replace(JobOutcome(**earlier["outcome"]), file=job.file, kept=not ours)
    command, options = _command_of(Path(job.file))
    outcome = replace(outcome, command=command)
    again = bool(earlier) and (job.resume or ours)
    if again and not job.overwrite and earlier.get("file", "") != os.path.abspath(job.file):
        raise InputError(
            f"{job.folder}: holds what was made of {earlier.get('file', 'another file')}, not of {job.file}; "
            "give another --out, or --overwrite"
        )
    words = [command, *options, "--out", str(job.folder)]
    words += ["--overwrite"] if job.overwrite or again else []
    words += ["--resume"] if command in _STAGED and (job.resume or ours) else []
    words += ["--allow-network"] if job.allow_network else []
    words += ["--", job.file]
    kept: dict[str, Any] = {"version": VERSION, "file": os.path.abspath(job.file), "batch": job.batch}
    _keep(job, kept)
    begun, cpu = time.perf_counter(), time.process_time()
    listing = _listing(Path(job.file))
    with apart(job.folder) as inputs:
        status = _waiting_for_others(run, words, err)
        stamps = inputs.stamps()
    summary = _summary(job.folder) if status == 0 else {}
    outcome = replace(
        outcome,
        status=status,
        wall_seconds=time.perf_counter() - begun,
        cpu_seconds=time.process_time() - cpu,
        peak_memory_bytes=peak_memory(),
        warnings=len(summary.get("warnings", ())),
        figures=_figures(summary),
    )
    if status == 0:
        outcome = replace(outcome, outline=_outline(command, Path(job.file), job.folder))
        result = _stamp(job.folder / "summary.json")
        _keep(
            job, {**kept, "inputs": stamps, "listing": listing, "result": result, "outcome": asdict(outcome)}
        )
    return outcome


def _waiting_for_others(run: Run, words: list[str], err: io.StringIO) -> int:
    """Exit status of a command, begun again while another run still writes into its folder."""
    until = time.monotonic() + _WAITS
    while True:
        place = err.tell()
        status = _went(run(words))
        err.seek(place)
        if HELD not in err.read() or time.monotonic() > until:
            return status
        err.seek(place)
        err.truncate()
        time.sleep(_LOOKS)


def _command_of(file: Path) -> tuple[str, list[str]]:
    """The command that a TOML file is for, and its options."""
    from sightline.io.config import schema_of
    from sightline.io.stereo.plan import has_plan

    kind = schema_of(file)
    if kind == "stereo":
        return "orient", ["--predict"] if has_plan(file) else []
    commands = {"acquisition": "recover", "sequence": "georeference", "tdi": "tdi"}
    if kind not in commands:
        raise InputError(
            f"{file}: is a file of kind {kind}, of which a batch makes nothing; it takes ACQUISITION, "
            "SEQUENCE, STEREO and TDI.toml"
        )
    return commands[kind], []


def _why(said: str) -> str:
    """The message of a command that failed, without what stands before every message."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith(("sightline: error: ", "sightline: defect: "))]
    line = (errors or lines or ["no message"])[-1]
    return line.removeprefix("sightline: ").removeprefix("error: ").removeprefix("warning: ")


def _outline(command: str, file: Path, folder: Path) -> list[list[list[float]]]:
    from sightline.io.results.batch import outline_of

    return outline_of(command, file, folder)


def _figures(summary: Any) -> dict[str, float | None]:
    from sightline.io.results.batch import figures_of

    return figures_of(summary)


# --------------------------------------------------------------------------------- what is kept


def _refuse_links(job: Job) -> None:
    """InputError where a folder of the job leads elsewhere: nothing is written outside ``--out``."""
    for path in (job.folder, job.record.parent):
        if file_kind(path) not in ("", "folder"):
            raise InputError(f"{path}: is a {file_kind(path)}, where a folder is to be written; move it away")


def _holds(job: Job, earlier: dict[str, Any]) -> bool:
    """Whether what an earlier run has left is the result of the same files as they are now."""
    try:
        return (
            earlier["version"] == VERSION
            and earlier["file"] == os.path.abspath(job.file)
            and earlier["outcome"]["status"] == 0
            and earlier["result"] == _stamp(job.folder / "summary.json")
            and earlier["listing"] == _listing(Path(job.file))
            and unchanged(earlier["inputs"])
        )
    except (KeyError, TypeError, ValueError, AttributeError):  # of a run that was stopped, or changed since
        return False


def _earlier(path: Path) -> dict[str, Any]:
    """The record of an earlier run; empty where there is none that can be read."""
    if file_kind(path) != "file":
        return {}
    try:
        found = json.loads(read_bytes(path, "a record", most=64 * SMALL))
    except (SightlineError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _keep(job: Job, content: dict[str, Any]) -> None:
    """Write the record, complete or not at all."""
    job.record.parent.mkdir(parents=True, exist_ok=True)
    whole_text(job.record, json.dumps(content))


def _stamp(path: Path) -> list[int]:
    known = os.stat(path) if os.path.exists(path) else None
    return [known.st_size, known.st_mtime_ns] if known is not None else [-1, -1]


def _listing(file: Path) -> str:
    """What is in a folder of frames that a file names: more of them are another input; "" of other files."""
    from sightline.io.config import read_toml

    named = read_toml(file).get("frames")
    folder = file.parent / named if isinstance(named, str) else None
    if folder is None or not folder.is_dir():
        return ""
    return sha256("\n".join(sorted(os.listdir(folder))).encode(errors="replace")).hexdigest()


def _summary(folder: Path) -> dict[str, Any]:
    """The ``summary.json`` of a result that was just written."""
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return found
