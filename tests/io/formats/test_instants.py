from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.io.formats import instants


def test_leap_seconds_are_those_of_another_table():
    erfa = pytest.importorskip("erfa")
    for year in range(1972, 2026):
        for month in range(1, 13):
            text = f"{year}-{month:02d}-01T00:00:00"
            assert instants.tai_offset(instants.parse_utc(text, "")[0]) == erfa.dat(year, month, 1, 0.0)


def test_time_runs_on_through_a_leap_second():
    epoch = "2016-12-31T23:59:58.5Z"
    for text, seconds in (
        ("2016-12-31T23:59:59.5", 1.0),
        ("2016-12-31T23:59:60.25", 1.75),
        ("2016-366T23:59:60.75", 2.25),
        ("2017-01-01T00:00:00", 2.5),
        ("2017-001T00:00:10Z", 12.5),
    ):
        assert instants.seconds_from_epoch(text, epoch, "") == pytest.approx(seconds, abs=1e-12)
        back = instants.utc_text(seconds, epoch)
        assert instants.seconds_from_epoch(back, epoch, "") == pytest.approx(seconds, abs=1e-9)
    assert instants.utc_text(1.75, epoch) == "2016-12-31T23:59:60.250000000"
    assert instants.utc_text(2.5, epoch) == "2017-01-01T00:00:00.000000000"
    assert instants.utc_text(-12.5, "2017-01-01T00:00:10Z") == "2016-12-31T23:59:58.500000000"


def test_a_leap_second_that_never_was_is_refused():
    with pytest.raises(FormatError, match=r"2016-06-30T23:59:60' is no leap second"):
        instants.parse_utc("2016-06-30T23:59:60", "here")
    for text in (
        "2016-06-30T23:59:61",
        "2016-02-30",
        "2015-366",
        "2016-000",
        "2016-1-1",
        "2016-06-30T24:00:00",
    ):
        with pytest.raises(FormatError, match="is not a UTC instant"):
            instants.parse_utc(text, "here")


@pytest.mark.parametrize(
    # all the same instant: GPS is 18 s ahead of UTC since 2017, TAI = GPS + 19 s, TT = TAI + 32.184 s
    ("scale", "text"),
    [
        ("UTC", "2020-06-01T12:00:00"),
        ("GPS", "2020-06-01T12:00:18"),
        ("TAI", "2020-06-01T12:00:37"),
        ("TT", "2020-153T12:01:09.184"),
        ("UT1", "2020-06-01T11:59:59.75"),
    ],
)
def test_time_scales_are_brought_to_one(scale, text):
    of = instants.clock(scale, "2020-06-01T11:59:00Z", lambda t: -0.25)
    assert of(text, "") == pytest.approx(60.0, abs=1e-9)


def test_time_scales_agree_with_another_implementation():
    erfa = pytest.importorskip("erfa")
    for text, date in (("1985-07-01T00:00:00", (1985, 7, 1)), ("2009-01-01T00:00:00", (2009, 1, 1))):
        utc = erfa.dtf2d("UTC", *date, 0, 0, 0.0)
        tt = erfa.taitt(*erfa.utctai(*utc))
        year, month, day, clock = erfa.d2dtf("TT", 9, *tt)
        hour, minute, second, fraction = (int(clock[name]) for name in "hmsf")
        written = f"{year}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{second:02d}.{fraction:09d}"
        of = instants.clock("TT", "1985-06-30T23:59:00Z", lambda t: 0.0)
        here = instants.seconds_from_epoch(text, "1985-06-30T23:59:00Z", "")
        assert of(written, "") == pytest.approx(here, abs=2e-7)  # days as float64 hold 1e-7 s of 24 years


def test_days_are_counted_with_their_seconds():
    day, second, offset = instants.modified_julian_day(0.0, "2020-06-01T12:00:00.5Z")
    assert (day, second, offset) == (59001, 43200.5, 37)
    np.testing.assert_allclose(
        instants.modified_julian_day(-43200.5, "2020-06-01T12:00:00.5Z")[:2], (59001, 0.0)
    )


def test_ut1_runs_on_through_a_leap_second():
    # 2016-12-31T23:59:60 was one: UT1 - UTC jumps, UT1 does not; against UTC that goes on it is -.408 s
    of = instants.clock("UT1", "2016-12-31T23:59:50Z", lambda t: -0.408)
    assert of("2017-01-01T00:00:05", "") == pytest.approx(15.408, abs=1e-9)
    with pytest.raises(FormatError, match="UT1 has no leap seconds"):
        of("2016-12-31T23:59:60", "")
