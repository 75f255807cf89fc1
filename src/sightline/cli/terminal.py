"""What the user sees: the summary on stdout, progress, warnings and errors on stderr.

Nothing here decides anything; exit statuses are in ``main.py``.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol


class Progress(Protocol):
    """Shows what is being done."""

    def __call__(self, stage: str, done: int = 0, total: int | None = None) -> None:
        """Say a stage; where `total` is known, with a bar and the time left."""


@contextmanager
def progress() -> Iterator[Progress]:
    """Function ``report(stage, done, total)`` that shows what is being done, if stderr is a terminal.

    Each finished stage leaves a line with the time it took; where a total is given, a bar and the time left
    show meanwhile. Elsewhere the function does nothing.
    """
    if not sys.stderr.isatty():
        yield lambda stage, done=0, total=None: None
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
    from rich.text import Text

    class Bar(BarColumn):
        """Only while a total is known."""

        def render(self, task: Task) -> Any:
            return super().render(task) if task.total and not task.finished else Text("")

    class Left(TimeRemainingColumn):
        """Only while a total is known."""

        def render(self, task: Task) -> Text:
            if not task.total or task.finished or task.time_remaining is None:
                return Text("")
            return super().render(task).append(" left")

    done_so_far = SpinnerColumn(finished_text="✓"), TextColumn("{task.description}"), TimeElapsedColumn()
    with Bars(*done_so_far, Bar(), Left(), console=Console(stderr=True), speed_estimate_period=120.0) as bars:
        running: dict[str, TaskID] = {}

        def finish() -> None:
            for task in running.values():
                bars.update(task, total=1, completed=1)
            running.clear()

        def report(stage: str, done: int = 0, total: int | None = None) -> None:
            if stage not in running:
                finish()
                running[stage] = bars.add_task(stage, total=None)
            if total is not None:
                bars.update(running[stage], completed=done, total=max(total, done))

        yield report
        finish()


def print_json(summary: Mapping[str, Any]) -> None:
    """Print a summary on stdout as JSON; numbers that are not finite become null."""
    from sightline.io.json_text import json_text

    print(json_text(summary))


def say(text: str) -> None:
    """Print one line of the summary meant for people, on stdout."""
    print(text)


def complain(kind: str, message: str) -> None:
    """Print one message on stderr: ``sightline: kind: message``."""
    print(f"sightline: {kind}: {message}", file=sys.stderr)


@contextmanager
def warnings_as_messages() -> Iterator[None]:
    """Show Python warnings as one line each on stderr, without the place in the code."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        complain("warning", str(message))

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
