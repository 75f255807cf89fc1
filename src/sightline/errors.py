"""The exceptions and the warning that Sightline raises on purpose.

::

    SightlineError
    ├── InputError (also ValueError)   what you gave is wrong: shape, type, value, unknown key
    ├── SpanError                      a time or a line lies outside what is known there
    ├── GeometryError                  the rays, surfaces and images do not meet
    ├── EstimationError                the data cannot give the answer asked for
    └── FormatError                    a file is missing, unreadable or not what its name says

    UnobservableBandWarning (a UserWarning)   the answer exists, but is blind at some frequencies

Every message has the same form: what happened: what was given; what is allowed; what to do.
A failure of one point is a NaN row in the result; an exception means that the whole call failed.

What other libraries raise becomes one of these in `foreign_errors`, the only place that does so.

This file holds no checks: those of array arguments are in ``geometry/checks.py``, those of files in
``access.py``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")

#: Characters of what another library said that a message repeats, and what no user can read of it.
_QUOTED = 200
_OBJECT = re.compile(r":? ?<[\w.]+ object at 0x[0-9a-f]+>")


#: Characters of a message that are kept; of a longer one, which repeats what a file holds, the middle goes.
_LONGEST = 2000
#: Control characters, breaks of lines, marks that turn or hide text, halves of characters.
STEERING = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)


def printable(text: str) -> str:
    """`text` on one line: characters that break, steer, turn or hide it as Python writes them (``\\x1b``)."""
    return STEERING.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def shortened(text: str, longest: int) -> str:
    """`text`, its middle left out where it has more than `longest` characters."""
    if len(text) <= longest:
        return text
    tail = (longest - 1) // 3
    return f"{text[: longest - 1 - tail]}…{text[len(text) - tail :]}"


class SightlineError(Exception):
    """Base of every exception that Sightline raises on purpose; its message is one line of some length."""

    def __init__(self, *said: object) -> None:
        super().__init__(*(shortened(printable(s), _LONGEST) if isinstance(s, str) else s for s in said))


class InputError(SightlineError, ValueError):
    """What the caller gave is wrong: a shape, a type, a value, a name."""


class SpanError(SightlineError):
    """A time or an image line lies outside the span that a trajectory, motion or table covers."""


class GeometryError(SightlineError):
    """The geometry has no answer: no ray meets the surface, two images do not overlap."""


class EstimationError(SightlineError):
    """The data are well formed but cannot determine what was asked for."""


class FormatError(SightlineError):
    """A file is missing, unreadable, truncated or not of the form expected; names the file and the place."""


class UnobservableBandWarning(UserWarning):
    """The estimate is blind near some frequencies; the message names them."""


@contextmanager
def foreign_errors(
    place: object, failed: str, advice: str, *, raises: type[SightlineError] = FormatError
) -> Iterator[None]:
    """Turn whatever another library raises in the block into one of our errors.

    Parameters
    ----------
    place : object
        File, or file and key, that the message begins with.
    failed : str
        What was tried, as ``"cannot be read as CSV"``.
    advice : str
        What is expected, or what to do.
    raises : type
        Class of the error.

    Notes
    -----
    Our own errors and warnings pass as they are, and so do Ctrl-C and the end of the process. What was raised
    stays the cause of the new error: ``--debug`` shows it. numpy does not warn in the block: what values
    become is checked, and refused where it is no number.
    """
    import numpy as np

    try:
        with np.errstate(all="ignore"):
            yield
    except InputError as error:  # of a check that knows nothing of the file
        if str(place) in str(error) or not issubclass(raises, FormatError):
            raise
        raise raises(f"{place}: {error}") from error
    except (SightlineError, Warning):
        raise
    except Exception as error:
        raise raises(f"{place}: {failed} ({said_by(error)}); {advice}") from error


def reads(
    what: str, advice: str = "the file is damaged, or another one is meant"
) -> Callable[[Callable[_Given, _Result]], Callable[_Given, _Result]]:
    """Make a function of a path raise FormatError for whatever it stumbles over in the file.

    Parameters
    ----------
    what : str
        What the file, the first argument of the function, is expected to be, as ``"a CSV table"``.
    advice : str
        What is expected, or what to do.
    """

    def decorated(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
        @wraps(function)
        def reader(*args: _Given.args, **kwargs: _Given.kwargs) -> _Result:
            place = args[0] if args else next(iter(kwargs.values()), "")
            with foreign_errors(place, f"cannot be read as {what}", advice):
                return function(*args, **kwargs)

        return reader

    return decorated


@contextmanager
def failing_numbers(what: str) -> Iterator[None]:
    """Turn arithmetic that fails in the block into EstimationError: what no finite input should do, data may.

    Parameters
    ----------
    what : str
        What is computed, or file and what: the message begins with it.
    """
    try:
        yield
    except Exception as error:
        # scipy says so of what is singular, and of what is not finite
        singular = type(error).__name__ == "LinAlgError" or "infs or NaNs" in str(error)
        if isinstance(error, SightlineError) or not (isinstance(error, ArithmeticError) or singular):
            raise
        raise EstimationError(
            f"{what}: cannot be computed from these data ({said_by(error)}); look for values that are "
            "extreme, repeated, or do not belong together; --debug shows where it failed"
        ) from error


@contextmanager
def naming(place: object) -> Iterator[None]:
    """Errors of what knows nothing of the file begin with `place`, unless they name it."""
    try:
        yield
    except (EstimationError, GeometryError, InputError, SpanError) as error:
        if f"{place}" in str(error):
            raise
        raise type(error)(f"{place}: {error}") from error


def computes(what: str) -> Callable[[Callable[_Given, _Result]], Callable[_Given, _Result]]:
    """`failing_numbers` about a whole function."""

    def decorated(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
        @wraps(function)
        def computed(*args: _Given.args, **kwargs: _Given.kwargs) -> _Result:
            with failing_numbers(what):
                return function(*args, **kwargs)

        return computed

    return decorated


def said_by(error: BaseException) -> str:
    """What an exception of another library means, on one line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, MemoryError):
        return "it claims more than memory holds"
    if isinstance(error, UnicodeEncodeError):  # of a path; the system's own calls take such bytes
        return "to be renamed: its path holds bytes that are no UTF-8 text"
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start} is no {error.encoding.upper()} text"
    if type(error).__module__.startswith("rasterio"):  # it says what GDAL said in the cause
        lines = str(error.__cause__ or error).strip().splitlines()
        return (lines or [type(error).__name__])[0].rstrip(". ")
    text = " ".join(_OBJECT.sub("", str(error)).split()).rstrip(".;: ")
    if isinstance(error, KeyError):
        return f"{text} is missing"
    if len(text) > _QUOTED:
        text = f"{text[:_QUOTED]}..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
