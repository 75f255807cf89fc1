"""``sightline batch``: many inputs, each by its own command, on workers of this machine or of a cluster."""

from __future__ import annotations

import os
import secrets
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite
from sightline.execution import time_words

if TYPE_CHECKING:
    from sightline.applications.batch import JobOutcome
    from sightline.cli.jobs import Job

#: Failures that are listed at the end, and inputs under way that a terminal shows.
_LISTED, _ROWS = 20, 12


def batch(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILES... | @list.txt",
            help="ACQUISITION, SEQUENCE, STEREO and TDI.toml, any of them; @list.txt: a file that names one "
            "on each line, from its own folder.",
        ),
    ],
    out: Out,
    workers: Annotated[
        str | None,
        typer.Option(
            "--workers",
            metavar="N|process:N|dask:ADDRESS|dask:local",
            help="N, process:N: so many inputs at a time, each in a process of this machine (1: in this "
            "one); dask: on the workers of a cluster. As many as there are processors if not given.",
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Keep what is done of inputs that are still the same; go on from finished stages of others.",
        ),
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Run the command of every file into a folder of its own below DIR; those that fail stop no other."""
    from sightline.applications.batch import Batch, job_names
    from sightline.cli.jobs import RECORDS, Job, job_runner, lost_job
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import print_json, progress
    from sightline.execution import available_processors, executor_from_name
    from sightline.kinds.batch import Batches
    from sightline.output.folder import Interrupted

    begun = time.perf_counter()
    inputs = listed(files)
    asked = executor_from_name(str(available_processors()) if workers is None else workers)
    names = job_names([Path(file) for file in inputs])
    ours = (out / RECORDS).is_dir() and not (out / RECORDS).is_symlink()
    _refuse_without_a_word(out, ours=ours, allowed=resume or overwrite)
    token, place = secrets.token_hex(8), os.getcwd()
    jobs = [
        Job(name, file, str(out), place, token, overwrite, resume, allow_network)
        for name, file in zip(names, inputs, strict=True)
    ]
    with output_folder(out, overwrite=overwrite or (resume and ours)) as folder:
        outcomes: dict[int, JobOutcome] = {}
        try:
            with _board(jobs) as board, asked as executor:
                for number, outcome in executor.completed(
                    job_runner(), jobs, lost=lost_job, begun=board.begun
                ):
                    outcomes[number] = outcome
                    board.ended(number, outcome)
        except KeyboardInterrupt as error:
            done = sum(not outcome.status for outcome in outcomes.values())
            kept = f"{done} of {len(jobs)} inputs are done and kept; the same command with --resume goes on"
            raise Interrupted(kept) from error
        result = Batch(out.name or str(out), tuple(outcomes[number] for number in range(len(jobs))))
        with progress() as report:
            summary = Batches().render(result, folder, report, begun, inputs=_hashes(inputs))
    if as_json:
        print_json(summary)
    else:
        tell(result, summary, out)
    if result.failed:
        raise typer.Exit(1)


def listed(files: Sequence[str]) -> list[str]:
    """The files of the command line, with those that lists name in the place of the lists.

    Raises
    ------
    InputError
        If there are none, or a list cannot be read.
    """
    from sightline.access import SMALL, read_text
    from sightline.errors import InputError

    found: list[str] = []
    for word in files:
        if not word.startswith("@"):
            found.append(word)
            continue
        path = Path(word[1:])
        text = read_text(
            path, "a list of files", most=SMALL, advice="give a file that names one on each line"
        )
        lines = [line.strip() for line in text.splitlines()]
        for number, line in enumerate(lines, 1):
            if line.startswith("@"):
                raise InputError(
                    f"{path}: line {number} is {line[:60]!r}: a list names no other list; give both lists, "
                    "or the files of that one"
                )
            if "\0" in line:
                raise InputError(f"{path}: line {number} holds a NUL; no file has such a name")
        found += [str(path.parent / line) for line in lines if line and not line.startswith("#")]
    if not found:
        raise InputError(
            f"{', '.join(files)}: names no file; give TOML files, or a list with one on each line"
        )
    return found


def _refuse_without_a_word(out: Path, *, ours: bool, allowed: bool) -> None:
    """InputError where an earlier batch is in the folder, and nothing was said of it."""
    from sightline.errors import InputError

    if ours and not allowed:
        raise InputError(
            f"the output folder holds a batch: {out}; add --resume to keep what is done of it and do the "
            "rest, or --overwrite to do all of it anew, or give another --out"
        )


def _hashes(files: Sequence[str]) -> dict[str, str]:
    """SHA-256 of each file that can be read."""
    from sightline.io.acquisition.acquired import sha256

    found = {}
    for file in files:
        with suppress(OSError, ValueError):
            if Path(file).is_file():
                found[file] = sha256(Path(file))
    return found


def tell(result: Any, summary: dict[str, Any], out: Path) -> None:
    """The batch in a few lines."""
    from sightline.cli.terminal import say

    for one in result.failed[:_LISTED]:
        say(f"{one.name}: exit status {one.status}: {one.message}")
    if len(result.failed) > _LISTED:
        say(f"{len(result.failed) - _LISTED} more failed, see results.csv")
    kept = sum(one.kept for one in result.outcomes)
    said = f"{summary['done']} of {len(result.outcomes)} inputs done" + (f", {kept} kept" if kept else "")
    say(f"{said}, {summary['failed']} failed; {out / 'results.csv'}, {out / 'report.html'}")


# --------------------------------------------------------------------------------- what is shown meanwhile


class _Board(Protocol):
    """Shows what becomes of the inputs."""

    def begun(self, number: int) -> None:
        """An input was given to a worker."""
        ...

    def ended(self, number: int, outcome: JobOutcome) -> None:
        """What became of it."""
        ...


@contextmanager
def _board(jobs: Sequence[Job]) -> Iterator[_Board]:
    """A live table on a terminal, a line for each input elsewhere."""
    if sys.stderr.isatty():
        with _Table(jobs) as table:
            yield table
    else:
        yield _Lines(len(jobs))


class _Lines:
    """A line for each input that has ended."""

    def __init__(self, count: int) -> None:
        self._count, self._ended, self._began = count, 0, time.monotonic()

    def begun(self, number: int) -> None:
        """Nothing to be said."""

    def ended(self, number: int, outcome: JobOutcome) -> None:
        """A line on stderr."""
        from sightline.cli.terminal import complain

        self._ended += 1
        left = (time.monotonic() - self._began) * (self._count - self._ended) / self._ended
        more = f", about {time_words(left)} left" if 1.0 < left else ""
        with suppress(OSError, ValueError):  # nobody reads them any more: the batch goes on
            complain("progress", f"{self._ended} of {self._count}: {_in_words(outcome)}{more}")


def _in_words(outcome: JobOutcome) -> str:
    """An outcome on one line."""
    if outcome.status:
        return f"{outcome.name}: failed with exit status {outcome.status}: {outcome.message}"
    if outcome.kept:
        return f"{outcome.name}: kept"
    return f"{outcome.name}: {outcome.command} done in {time_words(outcome.wall_seconds)}"


class _Table:
    """A table of inputs under way that is drawn anew as it changes; failures stay above it."""

    def __init__(self, jobs: Sequence[Job]) -> None:
        from rich.console import Console
        from rich.live import Live

        self._jobs, self._began = jobs, time.monotonic()
        self._since: dict[int, float] = {}
        self._done = self._kept = self._failed = 0
        # a stream of its own: what jobs print is caught meanwhile
        self._console = Console(file=sys.stderr)
        self._live = Live(
            get_renderable=self._drawn, console=self._console, refresh_per_second=2, transient=True,
            redirect_stdout=False, redirect_stderr=False,
        )  # fmt: skip

    def __enter__(self) -> _Table:
        self._live.__enter__()
        return self

    def __exit__(self, *exc: Any) -> None:
        self._live.__exit__(*exc)

    def begun(self, number: int) -> None:
        """A row more."""
        self._since[number] = time.monotonic()

    def ended(self, number: int, outcome: JobOutcome) -> None:
        """A row less; a failure leaves its line."""
        from rich.text import Text

        from sightline.errors import printable

        self._since.pop(number, None)
        self._done += not outcome.status
        self._kept += outcome.kept
        self._failed += bool(outcome.status)
        if outcome.status:
            self._console.print(Text(printable(_in_words(outcome)), overflow="ellipsis", no_wrap=True))

    def _drawn(self) -> Any:
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        from sightline.errors import printable

        now, count = time.monotonic(), len(self._jobs)
        ended = self._done + self._failed
        title = f"{ended} of {count} inputs: {self._done} done ({self._kept} kept), {self._failed} failed"
        if ended - self._kept > 0 and ended < count:
            left = (now - self._began) * (count - ended) / (ended - self._kept)
            title += f"; about {time_words(left)} left"
        table = Table(box=None, pad_edge=False)
        table.add_column("input", no_wrap=True, overflow="ellipsis")
        table.add_column("for", justify="right")
        under_way = sorted(dict(self._since).items(), key=lambda item: item[1])
        for number, since in under_way[:_ROWS]:
            table.add_row(Text(printable(self._jobs[number].name)), time_words(now - since))
        if len(under_way) > _ROWS:
            table.add_row(f"and {len(under_way) - _ROWS} more", "")
        return Group(Text(title), table)
