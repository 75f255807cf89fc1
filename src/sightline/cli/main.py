"""The ``sightline`` command: gathers the commands, one file each, and turns errors into one clear message.

Exit status: 0 done; 1 the data cannot give the answer; 2 wrong input or usage; 70 a defect of Sightline;
130 interrupted, 143 and 129 ended by SIGTERM and SIGHUP, 141 as nobody reads the output any more (128 and the
number of the signal).
What a command does is in its own file, named like it.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
from contextvars import copy_context
from types import FrameType
from typing import Annotated, Any

import typer

from sightline.access import shut_network
from sightline.cli import (
    batch,
    check,
    demo,
    export,
    georeference,
    init,
    layout,
    match,
    noise,
    orient,
    recover,
    register,
    schema,
    score,
    simulate,
    tdi,
    tie,
    version,
    warm_up,
)
from sightline.cli.jobs import elsewhere, serve
from sightline.cli.options import examples
from sightline.cli.statuses import (
    INTERRUPTED,
    UNREAD,
    WRONG_INPUT,
    status_of,
)
from sightline.cli.terminal import complain, warnings_as_messages
from sightline.errors import InputError
from sightline.execution import BLAS_THREADS, one_heap, threads_limited
from sightline.output.folder import Interrupted, published
from sightline.writing import creation_date

# Named through typer, because its newer versions carry a click of their own.
_UsageError: Any = typer.BadParameter.__base__
_ClickException: Any = _UsageError.__base__

app = typer.Typer(
    name="sightline",
    help="Recover where an Earth-observation camera was looking, from its own images, with an error bar on "
    "every number.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(asked: bool) -> None:
    if asked:
        version.version()
        raise typer.Exit


@app.callback()
def options(
    debug: Annotated[bool, typer.Option("--debug", help="On an error, show the whole traceback.")] = False,
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version and exit."),
    ] = False,
) -> None:
    """Options of every command; ``main`` reads ``--debug`` wherever it stands."""


app.command("demo", epilog=examples("demo"))(demo.demo)
app.add_typer(simulate.app, name="simulate")
app.command("init", epilog=examples("init"))(init.init)
app.command("recover", epilog=examples("recover"))(recover.recover)
app.command("layout", epilog=examples("layout"))(layout.layout)
app.command("register", epilog=examples("register"))(register.register)
app.command("export", epilog=examples("export"))(export.export)
app.command("orient", epilog=examples("orient"))(orient.orient)
app.command("georeference", epilog=examples("georeference"))(georeference.georeference)
app.command("tdi", epilog=examples("tdi"))(tdi.tdi)
app.command("noise", epilog=examples("noise"))(noise.noise)
app.command("match", epilog=examples("match"))(match.match)
app.command("tie", epilog=examples("tie"))(tie.tie)
app.command("batch", epilog=examples("batch"))(batch.batch)
app.command("score", epilog=examples("score"))(score.score)
app.command("check", epilog=examples("check"))(check.check)
app.command("schema", epilog=examples("schema"))(schema.schema)
app.command("warm-up", epilog=examples("warm-up"))(warm_up.warm_up)
app.command("version", epilog=examples("version"))(version.version)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status.

    Parameters
    ----------
    arguments
        Words after ``sightline``; None takes those of the process.
    """
    words = sys.argv[1:] if arguments is None else arguments
    debug = "--debug" in words
    if "--allow-network" not in words:
        shut_network()
    _heed_signals()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without some letter shows its number
            stream.reconfigure(errors="backslashreplace")
    # before numpy is loaded; why: docs/decisions/0006-one-thread-for-linear-algebra.md
    for variable in BLAS_THREADS:
        os.environ.setdefault(variable, "1")
    one_heap()
    sys.exit(run([word for word in words if word != "--debug"], debug=debug))


class _Ended(KeyboardInterrupt):
    """A signal other than that of Ctrl-C asks for the end; what stops a command is the same."""


#: The last signal that ended a command.
_ended_by: list[int] = []


def _heed_signals() -> None:
    """SIGTERM and SIGHUP (unless ignored, as under ``nohup``) end a command as Ctrl-C does: it tidies up."""

    def end(number: int, frame: FrameType | None) -> None:
        _ended_by[:] = [number]
        raise _Ended

    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, end)


def run(words: list[str], *, debug: bool = False) -> int:
    """Exit status of the command line `words`; messages of errors have gone to stderr.

    With `debug`, exceptions are left to rise with their traceback.
    """
    _ended_by.clear()
    published.clear()
    try:
        _check_environment()
        _check_words(words)
        status = elsewhere(words, debug=debug)
        if status is not None:
            return status
        with warnings_as_messages(), threads_limited(None):
            # what a command lets be opened ends with it
            status = copy_context().run(app, words, prog_name="sightline", standalone_mode=False)
        if status == INTERRUPTED:  # typer's word for an interruption inside a command
            raise KeyboardInterrupt
    except _ClickException as error:
        _say_usage(error)
        return WRONG_INPUT
    except SystemExit:  # what click makes of a pipe that nobody reads any more, with a status of 1
        return UNREAD
    except Interrupted as kept:
        return _interrupted(str(kept))
    except (typer.Abort, KeyboardInterrupt) as stopped:
        if isinstance(stopped.__cause__, EOFError):  # of a file, which typer takes for Ctrl-D
            return _failed(stopped.__cause__, debug)
        return _interrupted(
            f"the result is complete: {published[-1]}" if published else "no result was written"
        )
    except Exception as error:
        return _failed(error, debug)
    return status if isinstance(status, int) else 0


def _check_words(words: list[str]) -> None:
    """InputError for a word or a value that is empty: as a path it would be the folder of work."""
    for word, before in zip(words, ["", *words], strict=False):
        if not word or re.fullmatch("--[a-z-]+=", word):
            name = word.rstrip("=") or (before if before.startswith("--") else "")
            raise InputError(
                f"{name or 'a word of the command'} is empty; give a value, or leave it out (a variable of "
                "the shell that is not set leaves nothing)"
            )


def _check_environment() -> None:
    """InputError for variables that libraries read where they are loaded, in words of their own."""
    creation_date()
    given = os.environ.get("TERMINAL_WIDTH", "")
    if given and not re.fullmatch("[0-9]{1,5}", given):
        raise InputError(
            f"TERMINAL_WIDTH is {given[:40]!r}; columns of the terminal are expected, at most 99999; "
            "correct it, or unset it"
        )


def _failed(error: Exception, debug: bool) -> int:
    """Exit status of a command that failed, once what failed was said; its traceback with `debug`."""
    if debug:
        raise error
    return status_of(error)


def _interrupted(left: str) -> int:
    """Say that the command was stopped, by what, and what is left of it; give the exit status of that."""
    by, status = "interrupted", INTERRUPTED
    if _ended_by:
        number = _ended_by[0]
        by, status = f"ended by {signal.Signals(number).name}", 128 + number
    complain("error", f"{by}; {left}")
    return status


def _say_usage(error: Any) -> None:
    """Say what is wrong with the words of the command line; a command without any has printed its help."""
    context = getattr(error, "ctx", None)
    message = error.format_message()
    if type(error).__name__ == "NoArgsIsHelpError":
        if message:
            print(message, file=sys.stderr)
    else:
        command = context.command_path if context else "sightline"
        said = message.rstrip(".").replace(": Value error, ", ": ")
        complain("error", f"{said}; see: {command} --help")


serve(run)
