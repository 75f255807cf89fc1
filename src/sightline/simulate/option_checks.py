"""Checks that options of simulations share: each names the option, what is allowed and what was given.

Not here: what depends on several options at once (their own modules).
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from sightline.errors import InputError, printable

_Options = TypeVar("_Options")

#: Largest seed: TOML holds whole numbers of 64 bits.
MOST_SEED = 2**63 - 1
#: px; the most lines and columns that a strip may have.
MOST_LINES, MOST_COLUMNS = 1_000_000, 100_000
_PLAIN_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")
#: Other images of a scene, and devices of Windows.
_OTHER_FILES = {"dem", "con", "prn", "aux", "nul"}


def options_of(
    kind: type[_Options], cases: Mapping[str, Mapping[str, Any]], case: str, overrides: Mapping[str, Any]
) -> _Options:
    """Options of a named case with some replaced; InputError for a case or an option that there is not."""
    if case not in cases:
        raise InputError(f"unknown case: got {case!r}; allowed are {', '.join(cases)}")
    known = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(overrides) - known)
    if unknown:
        raise InputError(f"unknown option: {', '.join(unknown)}; allowed are {', '.join(sorted(known))}")
    return kind(**{**cases[case], **overrides})


def check_options(options: Any) -> None:
    """Numbers of `options` lie within its `RANGES`, words among its `WORDS`, each of several too.

    The schema of scenes is made of the same two tables, so that a file is refused for what a call is.
    """
    for name, allowed in options.WORDS.items():
        if getattr(options, name) not in allowed:
            raise InputError(f"`{name}` must be one of {', '.join(allowed)}, got {getattr(options, name)!r}")
    for name, (low, high) in options.RANGES.items():
        for number in _numbers(getattr(options, name)):
            if not math.isfinite(number):
                raise InputError(f"`{name}` must be finite, got {number}")
            if not low <= number <= high:
                unit = " rad" if descriptions(type(options))[name].startswith("rad") else ""
                degrees = f"; {number:g} degrees are {math.radians(number):.4g} rad" if unit else ""
                raise InputError(
                    f"`{name}` must be from {low:.6g} to {high:.6g}{unit}, got {number}{degrees}"
                )


def descriptions(kind: type[Any]) -> dict[str, str]:
    """What the docstring of a class of options says of each, on one line: the unit first."""
    found: dict[str, str] = {}
    section = inspect.cleandoc(kind.__doc__ or "").partition("Parameters\n----------\n")[2]
    for names, text in re.findall(r"^(\w+(?:, \w+)*) : .*\n((?: +.*\n?)*)", section, re.MULTILINE):
        found |= dict.fromkeys(names.split(", "), " ".join(text.split()).removesuffix("."))
    return found


def _numbers(value: Any) -> Iterator[float]:
    """The numbers of an option: one, none, or those of a list of lists."""
    if isinstance(value, tuple | list):
        for item in value:
            yield from _numbers(item)
    elif value is not None:
        yield value


def check_names(option: str, names: Sequence[str]) -> None:
    """Names of images, which become those of files: plain, no two alike, none that a scene writes beside."""
    for name in names:
        if not _PLAIN_NAME.fullmatch(name) or name.casefold() in _OTHER_FILES:
            raise InputError(
                f"`{option}` must be letters, digits, - and _, up to 40 (the name becomes that of an image "
                f"file), and not {', '.join(sorted(_OTHER_FILES))}; got {printable(name)!r}"
            )
    if len({name.casefold() for name in names}) < len(names):
        raise InputError(f"`{option}` must differ from each other, got {', '.join(names)}")
