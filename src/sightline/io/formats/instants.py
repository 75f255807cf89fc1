"""Instants as files write them, and the seconds between them: UTC with its leap seconds, TAI, GPS, TT, UT1.

t is always elapsed time: SI seconds from the epoch, across a leap second too.

Not here: how the Earth is turned at an instant (``geometry/earth_orientation.py``).
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

from sightline.errors import FormatError

#: Years in which images are taken: the oldest photographs of land from above are of 1858.
FIRST_YEAR, LAST_YEAR = 1850, 2200
#: Days that began right after a leap second (IERS, Bulletin C); TAI - UTC was 10 s when 1972 began.
_AFTER_LEAP = (
    "1972-07-01 1973-01-01 1974-01-01 1975-01-01 1976-01-01 1977-01-01 1978-01-01 1979-01-01 1980-01-01 "
    "1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 1992-07-01 1993-07-01 "
    "1994-07-01 1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 2012-07-01 2015-07-01 2017-01-01"
)
_LEAPS = [datetime.fromisoformat(day).replace(tzinfo=UTC) for day in _AFTER_LEAP.split()]
_FIRST_OFFSET = 10
#: TAI less other even scales, s: GPS time was UTC of 1980; TT by its definition.
_TAI_LESS = {"TAI": 0.0, "GPS": 19.0, "TT": -32.184}
#: Time scales of messages that are read.
TIME_SCALES = ("UTC", "TAI", "GPS", "TT", "UT1")
#: Day 0 of modified Julian dates.
_MJD_0 = datetime(1858, 11, 17, tzinfo=UTC)

_DATE = re.compile(
    r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))(?:[T ](\d\d):(\d\d)(?::(\d\d)(?:\.(\d*))?)?)?(?:Z|\+00:00)?"
)


def epoch_words(epoch: str | None) -> str:
    """When t = 0 is, in words; that a time without a zone is taken as UTC."""
    if epoch is None:
        return "no epoch"
    zoned = epoch.strip().endswith(("Z", "+00:00"))
    return f"t = 0 at {epoch}" + ("" if zoned else " (assumed: UTC, as it has no Z)")


def parse_utc(
    text: str, place: str, years: tuple[int, int] | None = (FIRST_YEAR, LAST_YEAR)
) -> tuple[datetime, float]:
    """An instant as whole seconds and the fraction that datetime would cut at a microsecond.

    Parameters
    ----------
    text : str
        ISO 8601, calendar (2026-01-31T...) or ordinal (2026-031T...), with or without Z.
    place : str
        Named in messages.
    years : (int, int) or None
        First and last that are allowed; None: any, as products with invented dates have.

    Returns
    -------
    whole : datetime
    fraction : float
        s, 0 <= fraction < 1; from 1 on within a leap second, whose beginning is 23:59:59 and 1 s.
    """
    found = _DATE.fullmatch(text.strip())
    whole = None if found is None else _whole(found)
    if found is None or whole is None:
        raise FormatError(
            f"{place}: {text[:80]!r} is not a UTC instant; write it like 2026-01-31T12:00:00.123Z"
        )
    if years is not None and not years[0] <= whole.year <= years[1]:
        raise FormatError(
            f"{place}: {text!r} is an instant of the year {whole.year}; images are of {years[0]} to "
            f"{years[1]}"
        )
    fraction = float(f"0.{found[8] or 0}")
    if found[7] != "60":
        return whole, fraction
    if whole + timedelta(seconds=1) not in _LEAPS:
        raise FormatError(f"{place}: {text!r} is no leap second; seconds are 00 to 59 on that day")
    return whole, 1.0 + fraction


def _whole(found: re.Match[str]) -> datetime | None:
    """The whole seconds of a match, a leap second as the one before; None if there is no such instant."""
    year, month, day, ordinal, hour, minute, second = (
        None if g is None else int(g) for g in found.groups()[:7]
    )
    try:
        if ordinal is None:
            date = datetime(year or 0, month or 0, day or 0, tzinfo=UTC)
        else:
            date = datetime(year or 0, 1, 1, tzinfo=UTC) + timedelta(days=ordinal - 1)
            if not ordinal or date.year != year:
                return None
        return date.replace(
            hour=hour or 0, minute=minute or 0, second=min(second or 0, 59 + (second or 0) // 61)
        )
    except ValueError:
        return None


def tai_offset(utc: datetime) -> int:
    """TAI - UTC (s) from an instant on; before 1972, when UTC ran otherwise, that of its beginning."""
    return _FIRST_OFFSET + bisect_right(_LEAPS, utc)


def elapsed(
    text: str,
    start: tuple[datetime, float],
    place: str,
    years: tuple[int, int] | None = (FIRST_YEAR, LAST_YEAR),
) -> float:
    """Seconds from `start` (of `parse_utc`) to the instant `text`, both UTC, leap seconds counted."""
    whole, fraction = parse_utc(text, place, years)
    leaps = tai_offset(whole) - tai_offset(start[0])
    return (whole - start[0]).total_seconds() + leaps + (fraction - start[1])


def seconds_from_epoch(text: str, epoch: str, place: str) -> float:
    """Seconds from `epoch` to the instant `text`, both UTC, leap seconds counted."""
    return elapsed(text, parse_utc(epoch, "epoch"), place)


def clock(scale: str, epoch: str, ut1_less_utc: Callable[[float], float]) -> Callable[[str, str], float]:
    """What turns instants of a time scale into seconds from the epoch.

    Parameters
    ----------
    scale : str
        One of `TIME_SCALES`.
    epoch : str
        UTC of t = 0.
    ut1_less_utc : callable
        UT1 - UTC (s) at t (s); asked of UT1 alone.

    Returns
    -------
    callable
        Of an instant as text and its place, for messages: t, s.
    """
    start = parse_utc(epoch, "epoch")
    if scale == "UTC":
        return lambda text, place: elapsed(text, start, place)
    if scale == "UT1":
        return lambda text, place: _of_ut1(text, start, place, ut1_less_utc)
    ahead = _TAI_LESS[scale] - tai_offset(start[0])

    def even(text: str, place: str) -> float:
        whole, fraction = parse_utc(text, place)
        if fraction >= 1.0:
            raise FormatError(
                f"{place}: {text!r}: {scale} has no leap seconds; give it as {scale}, or say UTC"
            )
        return (whole - start[0]).total_seconds() + ahead + (fraction - start[1])

    return even


def _of_ut1(
    text: str, start: tuple[datetime, float], place: str, ut1_less_utc: Callable[[float], float]
) -> float:
    """Seconds from the epoch of an instant of UT1.

    `ut1_less_utc` is against UTC that goes on from the epoch without leaps.
    """
    whole, fraction = parse_utc(text, place)
    if fraction >= 1.0:
        raise FormatError(f"{place}: {text!r}: UT1 has no leap seconds; give it as UT1, or say UTC")
    t = (whole - start[0]).total_seconds() + (fraction - start[1])
    return t - ut1_less_utc(t - ut1_less_utc(t))


def utc_text(t: float, epoch: str) -> str:
    """The instant `t` seconds after `epoch`, to the nanosecond, as CCSDS writes it."""
    start, fraction = parse_utc(epoch, "epoch")
    seconds, nanoseconds = divmod(round((t + fraction) * 1e9), 1_000_000_000)
    even = start + timedelta(seconds=seconds + tai_offset(start))
    # leap second k ends when TAI stands k + 10 s beyond the day that follows it
    ends = [day + timedelta(seconds=_FIRST_OFFSET + k) for k, day in enumerate(_LEAPS, 1)]
    passed = bisect_right(ends, even)
    whole = even - timedelta(seconds=_FIRST_OFFSET + passed)
    if passed < len(ends) and even >= ends[passed] - timedelta(seconds=1):
        return f"{whole - timedelta(seconds=1):%Y-%m-%dT%H:%M}:60.{nanoseconds:09d}"
    return f"{whole:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}"


def modified_julian_day(t: float, epoch: str) -> tuple[int, float, int]:
    """Day, s of that day and TAI - UTC (s), of UTC, at `t` s from the epoch; of a leap second the day it "
    "ends."""
    whole, rest = parse_utc(utc_text(t, epoch), "epoch")
    since = whole - _MJD_0
    return since.days, since.seconds + rest, tai_offset(whole)
