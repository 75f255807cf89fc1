"""Checks that options of simulations share: each names the option, what is allowed and what was given.

Not here: what depends on several options at once (their own modules).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from sightline.errors import InputError


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
