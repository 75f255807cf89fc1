"""Axes of a figure: their ranges, the numbers beside them, and values as px.

Not here: how they are drawn (``figure.py``).
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: px: width of the drawing, size of its text.
WIDTH, SIZE = 1080.0, 13.0
#: Share of an axis left free beside what is drawn.
_FREE = 0.05
_DIGITS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def array(values: ArrayLike) -> Array:
    """Values as float64."""
    return np.asarray(values, dtype=np.float64)


def text_width(text: str, size: float = SIZE) -> float:
    """px that a text takes, about."""
    return size * sum(1.0 if unicodedata.east_asian_width(c) in "WF" else 0.57 for c in text)


def number(value: float) -> str:
    """A number beside an axis: in full, or as a power of ten where that is much shorter."""
    if value == 0.0 or 1e-4 <= abs(value) < 1e7:
        return f"{value:,.10g}".replace("-", "−")
    digits, power = f"{value:.6e}".split("e")
    digits = digits.rstrip("0").rstrip(".").replace("-", "−")
    ten = "10" + str(int(power)).translate(_DIGITS)
    return ten if digits == "1" else f"{digits}×{ten}"


@dataclass
class Axis:
    """What an axis says, and its range; what is not given follows from the marks.

    Attributes
    ----------
    title : str
    low, high : float, optional
    log, from_zero, downward, grid : bool
        `from_zero`: 0 is in the range; `downward`: the least value is at the top, or at the right.
    ticks : sequence of (value, text), optional
    tight : bool
        Nothing is left free beside the marks.
    """

    title: str = ""
    low: float | None = None
    high: float | None = None
    log: bool = False
    from_zero: bool = False
    downward: bool = False
    grid: bool = True
    ticks: Sequence[tuple[float, str]] | None = None
    tight: bool = False

    def range(self, values: Iterable[Array]) -> tuple[float, float]:
        """Ends of the axis for marks with such values."""
        parts = [v[np.isfinite(v) & ((v > 0.0) | (not self.log))] for v in values]
        seen = np.concatenate([*parts, np.zeros(0)])
        low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.1, 1.0)
        if self.from_zero:
            low, high = min(low, 0.0), max(high, 0.0)
        low, high = (np.log10(low), np.log10(high)) if self.log else (low, high)
        if high - low <= 1e-12 * max(abs(low), abs(high), 1e-300):
            half = 0.5 if self.log or low == 0.0 else 0.05 * abs(low)
            low, high = low - half * (not self.from_zero or low < 0.0), high + half
        free = 0.0 if self.tight else _FREE * (high - low)
        low, high = low - free * (not self.from_zero or low < 0.0), high + free
        low, high = (10.0**low, 10.0**high) if self.log else (low, high)
        return low if self.low is None else self.low, high if self.high is None else self.high

    def marked(self, low: float, high: float, room: float) -> list[tuple[float, str]]:
        """Values with their texts for an axis from `low` to `high` that has room for so many texts."""
        if self.ticks is not None:
            rim = 1e-6 * (high - low)
            return [(v, t) for v, t in self.ticks if low - rim <= v <= high + rim]
        values = log_ticks(low, high, room) if self.log else linear_ticks(low, high, room)
        return [(float(v), number(float(f"{v:.10g}"))) for v in values]


def linear_ticks(low: float, high: float, room: float) -> Array:
    """Whole multiples of 1, 2 or 5 of some decade."""
    least = (high - low) / max(room, 2.0)
    decade = 10.0 ** np.floor(np.log10(least))
    step = float(next(m * decade for m in (1.0, 2.0, 5.0, 10.0) if m * decade >= least * (1.0 - 1e-9)))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return np.arange(first, last + 1.0) * step + 0.0


def log_ticks(low: float, high: float, room: float) -> Array:
    """Decades, with 2 and 5 of each where they are few; as on a linear axis within less than one."""
    decades = np.log10(high / low)
    if decades < 0.7:
        return linear_ticks(low, high, room)
    powers = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    if decades > room:
        powers = powers[:: int(np.ceil(decades / room))]
    inner = np.arange(1.0, 10.0) if 9.0 * decades <= room else np.array([1.0, 2.0, 5.0])
    inner = inner if 3.0 * decades <= 1.6 * room else np.array([1.0])
    values = (10.0 ** powers[:, None] * inner).ravel()
    return np.asarray(values[(values >= low * (1.0 - 1e-9)) & (values <= high * (1.0 + 1e-9))])


@dataclass(frozen=True)
class Scale:
    """Values of an axis as px: the end `low` at `start`, the other `length` further (or back)."""

    low: float
    high: float
    log: bool
    start: float
    length: float

    def to(self, values: ArrayLike) -> Array:
        """As they lie on the axis, linear in px; NaN where they cannot."""
        v = array(values)
        with np.errstate(invalid="ignore", divide="ignore"):
            v = np.log10(np.where(v > 0.0, v, np.nan)) if self.log else v
        return np.where(np.isfinite(v), v, np.nan)

    def __call__(self, values: ArrayLike) -> Array:
        """Places, px."""
        low, high = self.to([self.low, self.high])
        # far outside is as good as just outside, and numbers stay short
        places = self.start + self.length * (self.to(values) - low) / (high - low)
        return np.clip(places, -4.0 * WIDTH, 4.0 * WIDTH)

    def back(self, px: Array) -> Array:
        """Places as they lie on the axis."""
        low, high = self.to([self.low, self.high])
        return np.asarray(low + (px - self.start) / self.length * (high - low))


@dataclass(frozen=True)
class Box:
    """A panel as it is drawn: its two scales."""

    x: Scale
    y: Scale

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, top, width and height, px."""
        x, y = self.x, self.y
        left, top = min(x.start, x.start + x.length), min(y.start, y.start + y.length)
        return left, top, abs(x.length), abs(y.length)

    def holds(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Which places (px) lie inside, or on its rim."""
        left, top, w, h = self.corners
        return (x >= left - 1.0) & (x <= left + w + 1.0) & (y >= top - 1.0) & (y <= top + h + 1.0)
