"""SBET: none was at hand, so that the files are written here, after the published record."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.io.acquisition.ephemeris import read_orbit
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.sbet import is_sbet, read_sbet

#: A Thursday: four days of the GPS week and the 18 leap seconds since 1980 are gone.
EPOCH, SECONDS = "2026-01-01T00:00:00Z", 4 * 86400.0 + 18.0
LAT, LON, HEIGHT = np.radians(47.0), np.radians(11.0), 3000.0
HEADING, PITCH, ROLL, SPEED = 0.5, 0.03, -0.02, 60.0


def fixed(lat, lon, height):
    """Earth-fixed m, by the definition of WGS 84."""
    a, f = 6378137.0, 1.0 / 298.257223563
    normal = a / np.sqrt(1.0 - f * (2.0 - f) * np.sin(lat) ** 2)
    level = (normal + height) * np.cos(lat)
    return np.array(
        [level * np.cos(lon), level * np.sin(lon), (normal * (1.0 - f) ** 2 + height) * np.sin(lat)]
    )


def records(first=-1.0, count=41, wander=0.0, course=HEADING):
    """Even flight along `course`, 20 records a second."""
    rows = []
    for k in range(count):
        t = first + 0.05 * k
        # radii of curvature within 1 %: a course is compared to .02 rad
        lat = LAT + SPEED * t * np.cos(HEADING) / 6.37e6
        lon = LON + SPEED * t * np.sin(HEADING) / (6.39e6 * np.cos(LAT))
        velocity = (SPEED * np.cos(course + wander), SPEED * np.sin(course + wander), 0.0)
        rows.append(
            (t + SECONDS, lat, lon, HEIGHT, *velocity, ROLL, PITCH, HEADING + wander, wander, *[0.0] * 6)
        )
    return rows


def write(path, rows):
    path.write_bytes(b"".join(struct.pack("<17d", *row) for row in rows))
    return path


def test_places_times_and_attitudes_are_those_of_the_records(tmp_path):
    # a wander angle turns headings and velocities alike: nothing is changed by it
    for wander in (0.0, 0.3):
        read = read_sbet(write(tmp_path / "sbet.out", records(wander=wander)), EPOCH)
        # seconds of a week are told to 1e-10 s, places of the Earth to 1e-9 m
        np.testing.assert_allclose(read.t, -1.0 + 0.05 * np.arange(41), atol=1e-9)
        np.testing.assert_allclose(read.position[20], fixed(LAT, LON, HEIGHT), atol=1e-6)
        up = fixed(LAT, LON, 1.0) - fixed(LAT, LON, 0.0)
        north = fixed(LAT + 1e-7, LON, 0.0) - fixed(LAT - 1e-7, LON, 0.0)
        north /= np.linalg.norm(north)
        forward, right, down = read.fixed_from_body[20].as_matrix().T
        # nose up by the pitch, right wing down by the roll; differences of 1.3 m are good to 1e-8
        assert forward @ up == pytest.approx(np.sin(PITCH), abs=1e-7)
        assert right @ -up == pytest.approx(np.sin(ROLL) * np.cos(PITCH), abs=1e-7)
        assert forward @ north == pytest.approx(np.cos(PITCH) * np.cos(HEADING), abs=1e-7)
        assert forward @ np.cross(north, up) == pytest.approx(np.cos(PITCH) * np.sin(HEADING), abs=1e-7)
        assert down @ -up > 0.99
        assert not read.doubt


@pytest.mark.parametrize("weeks", [-1, 1])
def test_the_week_is_that_of_the_images(tmp_path, weeks):
    rows = [(row[0] + weeks * 604800.0, *row[1:]) for row in records()]
    if weeks < 0:  # before the week began: its end
        rows = [(row[0] + 604800.0, *row[1:]) for row in records()]
    read = read_sbet(write(tmp_path / "sbet.out", rows), EPOCH)
    assert read.t[0] == pytest.approx(-1.0, abs=1e-9)


def test_rows_about_the_images_are_kept(tmp_path):
    path = write(tmp_path / "sbet.out", records(first=-100.0, count=4001))
    t = read_sbet(path, EPOCH, (0.0, 2.0)).t
    assert -10.1 < t[0] < -9.9 and 11.9 < t[-1] < 12.1


def test_velocities_beside_the_positions_are_told_and_contradict_a_wander_angle(tmp_path):
    path = write(tmp_path / "sbet.out", records(course=HEADING + 0.1))
    assert "velocities point 0.1 rad beside the way of the positions" in read_sbet(path, EPOCH).doubt
    with pytest.raises(FormatError, match="export it with wander angle 0"):
        read_sbet(write(path, records(wander=0.2, course=HEADING - 0.4)), EPOCH)


def test_a_damaged_file_is_refused_by_its_record(tmp_path):
    path, rows = tmp_path / "sbet.out", records()
    with pytest.raises(FormatError, match=r"there is no epoch"):
        read_sbet(write(path, rows), None)
    degrees = [(row[0], 47.0, *row[2:]) for row in rows]
    with pytest.raises(FormatError, match="record 1: latitude is 47;"):
        read_sbet(write(path, degrees), EPOCH)
    assert is_sbet(path)
    path.write_text("t,x,y,z\n" + 40 * "0,1,2,3\n")
    assert not is_sbet(path)
    with pytest.raises(FormatError, match="record 3: its time does not follow"):
        read_sbet(write(path, [rows[0], rows[2], rows[1]]), EPOCH)
    with pytest.raises(FormatError, match="record 2: heading is nan"):
        read_sbet(write(path, [rows[0], (*rows[1][:9], np.nan, *rows[1][10:])]), EPOCH)
    path.write_bytes(write(path, rows).read_bytes()[:-5])
    with pytest.raises(FormatError, match="holds 40 records of 136 bytes and 131 bytes more"):
        read_orbit(path, EPOCH)


def test_what_is_no_sbet_is_called_what_it_is(tmp_path):
    path = tmp_path / "given"
    path.write_bytes(b"".join(struct.pack(">17d", *row) for row in records()))
    with pytest.raises(FormatError, match="is a SBET most byte first; least byte first is expected"):
        read_orbit(path, EPOCH)
    oem = "<oem><header></header><body>" + 50 * "<segment></segment>" + "</body></oem>"
    for text, mark in (
        (f'<?xml version="1.0"?>{oem}', "utf-16"),
        (f"<oem>{oem}", "utf-16-le"),
        (oem, "utf-16-be"),
    ):
        path.write_bytes(text.encode(mark))
        with pytest.raises(FormatError, match="is text in UTF-16; text in UTF-8 is expected"):
            read_orbit(path, EPOCH)
    for text, words in (
        (f"<ndm>{oem}{oem}</ndm>", "<ndm> holds 2 messages <oem>; one is needed: write each"),
        ("<ndm><aem></aem></ndm>", "is an NDM of AEM; one OEM or OMM is needed here"),
        ("<html><body>Log in</body></html>", "is XML or HTML that begins with <html>, and no CCSDS message"),
    ):
        path.write_text(text)
        with pytest.raises(FormatError, match=words):
            read_orbit(path, EPOCH)
    # a raster, whose small numbers are doubles of no size
    path.write_bytes(b"II*\0" + bytes(300))
    assert not is_sbet(path)


def test_a_strip_takes_its_positions_and_attitudes(folder):
    write(folder.path / "sbet.out", records(first=-5.0, count=400))
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "sbet.out"\nattitudes = "sbet.out"',
    )
    acquisition = load_acquisition(folder.write())
    place = acquisition.cameras[0].trajectory.at([0.0]).position[0]
    np.testing.assert_allclose(place, fixed(LAT, LON, HEIGHT), atol=1e-3)
    assert any("sbet.out: a SBET of 400 records" in line for line in acquisition.sources)
