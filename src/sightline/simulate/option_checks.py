"""Checks that options of simulations share: each names the option, what is allowed and what was given.

Not here: what depends on several options at once (their own modules).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from sightline.errors import InputError

_Options = TypeVar("_Options")


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


def check_finite(options: Any) -> None:
    """No number among the fields of `options` is infinite or NaN."""
    for name, value in vars(options).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"`{name}` must be finite, got {value}")


def check_one_of(options: Any, name: str, allowed: Sequence[str]) -> None:
    """The option `name` is one of some words."""
    if getattr(options, name) not in allowed:
        raise InputError(f"`{name}` must be one of {', '.join(allowed)}, got {getattr(options, name)!r}")


def check_positive(options: Any, *names: str) -> None:
    """The options `names` are above 0."""
    for name in names:
        if not getattr(options, name) > 0.0:
            raise InputError(f"`{name}` must be positive, got {getattr(options, name)}")


def check_least(options: Any, least: float, *names: str) -> None:
    """The options `names` are `least` or more."""
    for name in names:
        if not getattr(options, name) >= least:
            raise InputError(f"`{name}` must be {least:g} or more, got {getattr(options, name)}")


def check_within(options: Any, name: str, low: float, high: float) -> None:
    """The option `name` lies from `low` to `high`."""
    if not low <= getattr(options, name) <= high:
        raise InputError(f"`{name}` must be from {low:g} to {high:g}, got {getattr(options, name)}")
