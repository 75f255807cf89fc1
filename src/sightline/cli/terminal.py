"""What the user sees: the summary on stdout, progress, warnings and errors on stderr.

Nothing here decides anything; exit statuses are in ``statuses.py``.
"""

from __future__ import annotations

import re
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from sightline.errors import SightlineError, UnobservableBandWarning, printable, shortened
from sightline.execution import Progress, time_words

if TYPE_CHECKING:
    from sightline.applications.expected_cost import Cost
    from sightline.io.acquisition.acquired import Acquisition


#: s between lines of a stage under way, and that a stage took at least of which a line is left, in a log.
_EVERY, _WORTH_A_LINE = 30.0, 1.0
#: Columns of a bar, of all that stands beside the words of a stage, and of these words at least.
_BAR, _BESIDE_WORDS, _LEAST_WORDS = 16, 48, 12
#: Characters of a word of a message: numbers and names that a file holds have no end.
_LONGEST_WORD = 1000


class _Log:
    """Plain lines where stderr is no terminal: one when a stage ends, one now and then while it lasts."""

    def __init__(self) -> None:
        self._stage, self._begun, self._first = "", 0.0, 0
        self._done, self._total = 0, 0
        self._ended = threading.Event()
        # of its own, as one long step may report nothing for minutes
        self._beat = threading.Thread(target=self._tell_now_and_then, daemon=True)
        self._beat.start()

    def __call__(self, stage: str, done: int = 0, total: int | None = None) -> None:
        """A stage, and how far it has come."""
        if stage != self._stage:
            self._finish()
            self._stage, self._begun, self._first = stage, time.monotonic(), done
            self._total = 0
        self._done, self._total = done, self._total if total is None else total

    def close(self, *, finished: bool) -> None:
        """The end of all stages."""
        self._ended.set()
        self._beat.join()
        if finished:
            self._finish()

    def _finish(self) -> None:
        took = time.monotonic() - self._begun
        if self._stage and took >= _WORTH_A_LINE:
            _progress_line(f"{self._stage}: {time_words(took)}")

    def _tell_now_and_then(self) -> None:
        while not self._ended.wait(_EVERY):
            if self._stage and time.monotonic() - self._begun >= 0.5 * _EVERY:
                _progress_line(self._under_way())

    def _under_way(self) -> str:
        """How far the stage has come, and the time left by its pace so far."""
        took, done = time.monotonic() - self._begun, self._done - self._first
        text = f"{self._stage}: {time_words(took)} so far"
        if self._total <= 1:
            return text
        text += f", {self._done} of {self._total}"
        if done <= 0 or self._done >= self._total:
            return text
        return f"{text}, about {time_words(took * (self._total - self._done) / done)} left"


def _progress_line(text: str) -> None:
    """Say how far a run is; one that nobody reads any more goes on."""
    with suppress(OSError, ValueError):
        complain("progress", text)


@contextmanager
def progress() -> Iterator[Progress]:
    """Function ``report(stage, done, total)`` that shows on stderr what is being done.

    On a terminal each finished stage leaves a line with the time it took; where a total is given, a bar, the
    share and the time left show meanwhile. Elsewhere, as in a log, plain lines say the same: one for each
    finished stage of a second or more, and one every 30 s of a stage under way.
    """
    if not sys.stderr.isatty():
        log, finished = _Log(), False
        try:
            yield log
            finished = True
        finally:
            log.close(finished=finished)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        SpinnerColumn,
        Task,
        TaskID,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars
    from rich.table import Column
    from rich.text import Text

    class Bar(BarColumn):
        """Only while a total is known."""

        def render(self, task: Task) -> Any:
            return super().render(task) if task.total and not task.finished else Text("")

    class Share(TextColumn):
        """Only while a total is known."""

        def render(self, task: Task) -> Text:
            return super().render(task) if task.total and not task.finished else Text("")

    class Left(TimeRemainingColumn):
        """Only while a total is known."""

        def render(self, task: Task) -> Text:
            if not task.total or task.finished or task.time_remaining is None:
                return Text("")
            return super().render(task).append(" left")

    console = Console(stderr=True)
    words = TextColumn(
        "{task.description}",
        markup=False,
        table_column=Column(
            no_wrap=True, overflow="ellipsis", max_width=max(console.width - _BESIDE_WORDS, _LEAST_WORDS)
        ),
    )
    done_so_far = SpinnerColumn(finished_text="✓"), words, TimeElapsedColumn()
    under_way = Bar(bar_width=_BAR), Share("{task.percentage:>3.0f} %"), Left()
    with Bars(*done_so_far, *under_way, console=console, speed_estimate_period=120.0) as bars:
        running: dict[str, TaskID] = {}

        def finish() -> None:
            for task in running.values():
                bars.update(task, total=1, completed=1)
            running.clear()

        def report(stage: str, done: int = 0, total: int | None = None) -> None:
            if stage not in running:
                finish()
                running[stage] = bars.add_task(printable(stage), total=None)
            if total is not None:
                bars.update(running[stage], completed=done, total=max(total, done))

        yield report
        finish()


def print_json(summary: Mapping[str, Any]) -> None:
    """Print a summary on stdout as JSON; numbers that are not finite become null."""
    from sightline.io.formats.json_text import json_text

    print(json_text(summary))


def answered(summary: Mapping[str, Any], as_json: bool) -> bool:
    """Whether a summary printed as JSON is all that was asked for; if not, its warnings are said."""
    if as_json:
        print_json(summary)
        return True
    for warning in summary.get("warnings", ()):
        complain("warning", warning)
    return False


def say(text: str) -> None:
    """Print one line of the summary meant for people, on stdout."""
    print(_line(text))


def announce(cost: Cost) -> None:
    """Warn of a run of an hour, or of half of the memory, before it is begun."""
    for words in cost.warnings:
        complain("warning", words)


@contextmanager
def with_doubts(acquired: Acquisition) -> Iterator[None]:
    """Where what is done with an acquisition fails, say first what of it is suspicious: it may be why."""
    from sightline.io.acquisition.describe import what_is_doubtful

    try:
        yield
    except SightlineError:
        for words in what_is_doubtful(acquired):
            complain("warning", words)
        raise


def complain(kind: str, message: str) -> None:
    """Print one message on stderr, on one line whatever it quotes: ``sightline: kind: message``."""
    print(_line(f"sightline: {kind}: {message}"), file=sys.stderr)


def _line(text: str) -> str:
    """`text` as one line that a terminal only shows."""
    return re.sub(r"\S+", lambda word: shortened(word[0], _LONGEST_WORD), printable(text))


@contextmanager
def warnings_as_messages() -> Iterator[None]:
    """Show our own warnings as one line each on stderr, without the place in the code; no others.

    Those of other libraries speak of their arrays and functions, which are nobody's input.
    """

    def show(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        if issubclass(category, UnobservableBandWarning):
            complain("warning", str(message))

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
