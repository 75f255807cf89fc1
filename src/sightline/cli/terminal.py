"""What the user sees: the summary on stdout, progress, warnings and errors on stderr.

Nothing here decides anything; exit statuses are in ``main.py``.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

Progress = Callable[[str], None]


@contextmanager
def progress() -> Iterator[Progress]:
    """Function ``report(stage)`` that shows what is being done, if stderr is a terminal.

    Each finished stage leaves a line with the time it took; elsewhere the function does nothing.
    """
    if not sys.stderr.isatty():
        yield lambda stage: None
        return
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(finished_text="✓"), TextColumn("{task.description}"), TimeElapsedColumn())
    with Bars(*columns, console=Console(stderr=True)) as bars:
        running: list[TaskID] = []

        def finish() -> None:
            for task in running:
                bars.update(task, total=1, completed=1)
            running.clear()

        def report(stage: str) -> None:
            finish()
            running.append(bars.add_task(stage, total=None))

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
