"""Orbits and attitudes in other axes; truth by astropy, or by the Earth-fixed files."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, SpanError
from sightline.io.acquisition.describe import describe_acquisition
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import ccsds, tables
from sightline.io.formats.instants import utc_text

EPOCH = "2026-01-01T00:00:00Z"
RADIUS, RATE = 7.078e6, 7.5e3 / 7.078e6
PIXELS = [[0.0, 0.0], [199.0, 119.0], [100.0, 60.0]]


def flight(t):
    """Over longitude 0, flying north: Earth-fixed positions, velocities, attitudes that look down."""
    angle = RATE * t
    place = RADIUS * np.stack([np.cos(angle), 0 * t, np.sin(angle)], axis=1)
    speed = RADIUS * RATE * np.stack([-np.sin(angle), 0 * t, np.cos(angle)], axis=1)
    down, ahead = -place / RADIUS, speed / (RADIUS * RATE)
    return place, speed, Rotation.from_matrix(np.stack([ahead, np.cross(down, ahead), down], axis=-1))


def celestial(t, place, speed, body):
    """The same in GCRS by astropy."""
    coordinates = pytest.importorskip("astropy.coordinates")
    pytest.importorskip("erfa")
    from astropy import units
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    iers.conf.auto_download = False
    when = Time("2026-01-01T00:00:00", scale="utc") + TimeDelta(t, format="sec")

    def turned(points, change=None):
        rates = None
        if change is not None:
            rates = coordinates.CartesianDifferential(change.T * units.m / units.s)
        given = coordinates.CartesianRepresentation(points.T * units.m, differentials=rates)
        there = coordinates.ITRS(given, obstime=when).transform_to(coordinates.GCRS(obstime=when))
        velocity = None if change is None else there.velocity.d_xyz.to_value("m/s").T
        return there.cartesian.xyz.to_value("m").T, velocity

    axes = [turned(body.as_matrix()[:, :, k])[0] for k in range(3)]
    return *turned(place, speed), Rotation.from_matrix(np.stack(axes, axis=-1))


def ephemeris(folder, more: str = "", names: tuple[str, str] = ("o.oem", "a.aem")):
    """The platform replaced by two files."""
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        f'kind = "ephemeris"\npositions = "{names[0]}"\nattitudes = "{names[1]}"\n{more}',
    )
    return folder


T = np.linspace(-1.0, 2.0, 13)


def write(folder, axes: str = "ITRF", *, t=T, first_last=False):
    place, speed, body = flight(t)
    if axes != "ITRF":
        place, speed, body = celestial(t, place, speed, body)
    quat = body.as_quat()
    ccsds.write_oem(folder.path / "o.oem", t, place, speed, EPOCH, frame=axes)
    ccsds.write_aem(
        folder.path / "a.aem", t, quat[:, [3, 0, 1, 2]] if first_last else quat, EPOCH, frame=axes
    )
    return folder


def seen(acquisition):
    return acquisition.cameras[0].locate(PIXELS, acquisition.surface)


def test_axes_of_the_stars_see_the_same_ground(folder):
    ephemeris(write(folder))
    fixed = seen(load_acquisition(folder.write()))
    write(folder, "GCRF")
    acquisition = load_acquisition(folder.write())
    # dX, dY that astropy leaves out turn the whole by some 1e-9 rad: 1 cm on the ground
    np.testing.assert_allclose(seen(acquisition), fixed, atol=0.03)
    said = describe_acquisition(acquisition)["understood"]
    assert "o.oem: an OEM about Earth, axes GCRF, times in UTC" in said
    assert "a.aem: an AEM, axes GCRF, times in UTC" in said
    assert any(words.startswith("Earth orientation by IERS C04 of astropy-iers-data") for words in said)
    assert acquisition.known_motion.usual()[0] == pytest.approx(1e-2, rel=1e-6)


def test_tables_may_be_in_other_axes_too(folder):
    ephemeris(write(folder))
    fixed = seen(load_acquisition(folder.write()))
    place, _, body = celestial(T, *flight(T))[:3]
    tables.write_positions(folder.path / "p.csv", T, place)
    tables.write_attitudes(folder.path / "q.csv", T, body.as_quat())
    folder.replace('"o.oem"', '"p.csv"').replace('"a.aem"', '"q.csv"')
    folder.replace('"q.csv"\n', '"q.csv"\nposition_axes = "GCRF"\nattitude_axes = "GCRF"\n')
    # 0.25 s between positions without velocities: the fourth derivative, 8e-6 m/s^4, over that, 1e-9 m
    np.testing.assert_allclose(seen(load_acquisition(folder.write())), fixed, atol=0.03)
    folder.replace('"p.csv"', '"o.oem"')
    with pytest.raises(
        FormatError, match=r"is a message, which says its axes itself; remove .* position_axes"
    ):
        load_acquisition(folder.write())


def test_axes_of_attitudes_that_no_table_gives_are_refused(folder):
    ephemeris(write(folder), 'attitude_axes = "GCRF"\n', ("o.oem", "along-track"))
    words = (
        'attitude_axes = "GCRF" is of a table of attitudes.* give attitudes = FILE, or remove attitude_axes'
    )
    with pytest.raises(FormatError, match=words):
        load_acquisition(folder.write())


def test_an_earth_orientation_that_nothing_needs_is_refused(folder):
    write(folder)
    place, _, body = flight(T)
    tables.write_positions(folder.path / "p.csv", T, place)
    tables.write_attitudes(folder.path / "q.csv", T, body.as_quat())
    (folder.path / "finals.txt").write_text("")
    ephemeris(folder, 'earth_orientation = "finals.txt"\n', ("p.csv", "q.csv"))
    with pytest.raises(FormatError, match=r"earth_orientation = .*finals\.txt.* give position_axes"):
        load_acquisition(folder.write())


def test_files_of_one_acquisition_are_of_one_body(folder):
    ephemeris(write(folder))
    place, speed, body = flight(T)
    ccsds.write_oem(folder.path / "o.oem", T, place, speed, EPOCH, frame="IAU_MOON", centre="MOON")
    ccsds.write_aem(folder.path / "a.aem", T, body.as_quat(), EPOCH, frame="IAU_MARS", centre="MARS")
    folder.add("[surface]\nradii = [6.3e6, 6.3e6]\n")
    with pytest.raises(FormatError, match=r"o\.oem: .*IAU_MOON.*a\.aem.*IAU_MARS"):
        load_acquisition(folder.write())


def test_an_old_table_of_the_user_is_told_and_widens_the_sigma(folder):
    data = pytest.importorskip("astropy_iers_data")
    write(folder, "GCRF")
    with open(data.IERS_B_FILE) as stream:
        head = [line for line in stream if line.startswith("#") or line[:4] < "2016"]
    (folder.path / "old.c04").write_text("".join(head))
    ephemeris(folder, 'earth_orientation = "old.c04"\nattitude_sigma = 1e-5\n')
    acquisition = load_acquisition(folder.write())
    (doubt,) = [words for words in acquisition.doubts if "old.c04" in words]
    assert "covers 1962-01-01 to 2015-12-31 and not the images" in doubt and "m on the ground" in doubt
    # 3653 days: UT1 is off by seconds, 1.7 s rms at 3000 and beyond; 1.24e-4 rad of the Earth, 700 km below
    assert acquisition.known_motion.usual()[0] == pytest.approx(1.7 * 7.292e-5 * 6378 / 700, rel=0.02)
    write(folder)  # Earth-fixed: no date is refused, nothing is added
    acquisition = load_acquisition(folder.write())
    assert not acquisition.doubts and acquisition.known_motion.usual()[0] == pytest.approx(1e-5, rel=1e-9)


def test_earth_fixed_files_need_no_table_at_any_date(folder, monkeypatch):
    from sightline.io.formats import earth_orientation

    def never(*_):
        raise AssertionError("asked")

    monkeypatch.setattr(earth_orientation, "orbit_package", never)
    for year in (1959, 2190):
        place, speed, body = flight(T)
        epoch = f"{year}-01-01T00:00:00Z"
        ccsds.write_oem(folder.path / "o.oem", T, place, speed, epoch)
        ccsds.write_aem(folder.path / "a.aem", T, body.as_quat(), epoch)
        if year == 1959:
            ephemeris(folder)
        folder.text = folder.text.replace('"2026-01-01', f'"{year}-01-01').replace(
            '"1959-01-01', f'"{year}-01-01'
        )
        load_acquisition(folder.write())


@pytest.mark.parametrize(("short", "taken"), [(0.4e-6, True), (3e-6, False)])
def test_positions_may_end_with_the_last_line_but_for_rounding(folder, short, taken):
    ephemeris(write(folder))
    last = load_acquisition(folder.write()).cameras
    span = (
        min(c.first_line_time for c in last),
        max(float(np.ravel(c.times(np.array([c.lines - 1.0])))[0]) for c in last),
    )
    write(folder, t=np.linspace(span[0] + short, span[1] - short, 13))
    if taken:
        load_acquisition(folder.write())
        return
    with pytest.raises(SpanError, match="the positions cover"):
        load_acquisition(folder.write())


def test_a_file_that_is_no_earth_orientation_is_named(folder):
    write(folder, "GCRF")
    (folder.path / "eop.txt").write_text("t,x,y\n0,1,2\n")
    ephemeris(folder, 'earth_orientation = "eop.txt"\n')
    with pytest.raises(FormatError, match=r"eop\.txt: is no table of Earth orientation; finals2000A or C04"):
        load_acquisition(folder.write())


def test_a_scalar_first_of_inertial_attitudes_is_recognised(folder):
    ephemeris(write(folder, "GCRF", first_last=True))
    doubts = " ".join(load_acquisition(folder.write()).doubts)
    assert "read with the scalar first (qw,qx,qy,qz) they would make it look" in doubts


def test_attitudes_that_end_a_little_early_are_continued(folder):
    # images are exposed in 0 to 0.0995 s; a roll of 3e-3 rad/s^2 is not even
    step = 0.04
    t = np.arange(-0.36, 0.05, step)
    place, speed, _ = flight(T)
    roll = lambda at: 0.5 * 3e-3 * at**2  # noqa: E731
    ccsds.write_oem(folder.path / "o.oem", T, place, speed, EPOCH)

    def body(at):
        turned = np.stack([roll(at), 0 * at, 0 * at], axis=1)
        return flight(at)[2] * Rotation.from_rotvec(turned)

    ccsds.write_aem(folder.path / "a.aem", t, body(t).as_quat(), EPOCH)
    acquisition = load_acquisition(ephemeris(folder, "attitude_sigma = 1e-7\n").write())
    end = np.array([0.0995])
    off = (body(end).inv() * acquisition.cameras[0].trajectory.at(end).world_from_body).magnitude()[0]
    (doubt,) = acquisition.doubts
    assert "a.aem: attitudes end 0.0595 s (1.5 of their steps) before the images do" in doubt
    told = acquisition.known_motion.attitude_added
    # the error of even continuation is a (s^2 + s step) / 2 = 8.9e-6 rad with a = 3e-3: about one axis in
    # three
    assert off == pytest.approx(0.5 * 3e-3 * 0.0595 * (0.0595 + step), rel=0.02)
    assert told == pytest.approx(off / np.sqrt(3.0), rel=0.05)
    ccsds.write_aem(folder.path / "a.aem", t[:-1], body(t[:-1]).as_quat(), EPOCH)
    with pytest.raises(SpanError, match=r"continued by two of their steps at most \(0\.04 s\)"):
        load_acquisition(folder.write())


def test_the_covariance_of_an_orbit_widens_the_sigma_of_the_attitude(folder):
    write(folder)
    text = (folder.path / "o.oem").read_text()
    block = "\n".join(" ".join("4e-4" if i == j else "0" for j in range(i + 1)) for i in range(6))
    (folder.path / "o.oem").write_text(
        text + f"COVARIANCE_START\nEPOCH = 2026-01-01T00:00:00\n{block}\nCOVARIANCE_STOP\n"
    )
    acquisition = load_acquisition(ephemeris(folder, "attitude_sigma = 1e-7\n").write())
    # 20 m seen from 700 km
    assert acquisition.known_motion.usual()[0] == pytest.approx(20.0 / 700e3, rel=2e-3)


@pytest.mark.parametrize(
    ("frame", "centre", "radii", "words"),
    [
        ("EME2000", "MARS", True, "axes EME2000 about Mars: how Mars turns is known here of the Earth alone"),
        ("ITRF", "MARS", True, "axes of another body than its CENTER_NAME = MARS"),
        ("IAU_MARS", "EARTH", True, "axes of another body than its CENTER_NAME = EARTH"),
        ("IAU_MARS", "MARS", False, r"axes fixed to Mars; give its \[surface\] radii"),
    ],
)
def test_axes_and_bodies_go_together(folder, frame, centre, radii, words):
    place, speed, body = flight(T)
    ccsds.write_oem(folder.path / "o.oem", T, place, speed, EPOCH, frame=frame, centre=centre)
    ccsds.write_aem(folder.path / "a.aem", T, body.as_quat(), EPOCH, frame="IAU_MARS", centre="MARS")
    ephemeris(folder)
    if radii:
        folder.add("[surface]\nradii = [6.3e6, 6.3e6]\n")
    with pytest.raises(FormatError, match=words):
        load_acquisition(folder.write())


def test_another_body_is_seen_in_its_own_axes(folder):
    place, speed, body = flight(T)
    ccsds.write_oem(folder.path / "o.oem", T, place, speed, EPOCH, frame="IAU_MARS", centre="MARS")
    ccsds.write_aem(folder.path / "a.aem", T, body.as_quat(), EPOCH, frame="IAU_MARS", centre="MARS")
    acquisition = load_acquisition(ephemeris(folder).add("[surface]\nradii = [6.3e6, 6.3e6]\n").write())
    np.testing.assert_allclose(np.linalg.norm(seen(acquisition), axis=1), 6.3e6, rtol=1e-9)


def test_an_orbit_runs_on_through_a_leap_second(folder):
    """The strip begins 50 ms before the leap second of 2016 ends, and ends as long after it."""
    epoch = "2016-12-31T23:59:60.95Z"
    place, speed, body = flight(T)
    ccsds.write_oem(folder.path / "o.oem", T, place, speed, epoch)
    ccsds.write_aem(folder.path / "a.aem", T, body.as_quat(), epoch)
    text = (folder.path / "o.oem").read_text()
    assert "T23:59:60." in text and "2017-01-01T00:00:00.200" in text
    ephemeris(folder).replace('"2026-01-01T00:00:00Z"', f'"{epoch}"')
    trajectory = load_acquisition(folder.write()).cameras[0].trajectory
    np.testing.assert_allclose(trajectory.at([0.07]).position, flight(np.array([0.07]))[0], atol=1e-3)


def test_a_missing_extra_is_named(folder, monkeypatch):
    write(folder, "GCRF")
    import sys

    monkeypatch.setitem(sys.modules, "erfa", None)
    with pytest.raises(Exception) as caught:
        load_acquisition(ephemeris(folder).write())
    assert "needs the extra `orbit`, of which erfa is not installed; run `pip install" in str(caught.value)


def test_the_package_does_not_load_the_extra():
    import subprocess
    import sys

    code = (
        "import sys, sightline; print({m.split('.')[0] for m in sys.modules} & {'erfa', 'sgp4', 'ccsds_ndm'})"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "set()\n"


def test_seconds_of_messages_are_to_the_nanosecond():
    assert utc_text(0.123456789, EPOCH) == "2026-01-01T00:00:00.123456789"


@pytest.mark.parametrize(
    ("keys", "words", "size"),
    [
        # 7.5 km/s in 700 km, north, along the track; at the equator the camera moves east with the Earth too,
        # against the stars by 516 m/s, against the ground by 51 m/s
        ("aberration", "aberration is applied: 25.1 urad", 700e3 * np.hypot(7500.0, 516.1) / 299792458.0),
        ("light_time", "light time is applied: 1.55 urad", 700e3 * 465.1 / 299792458.0),
        ("aberration light_time", "aberration is applied", 700e3 * np.hypot(7500.0, 51.0) / 299792458.0),
        ("refraction", "refraction is applied: 0 urad", 0.0),
    ],
)
def test_the_apparent_direction_of_light_is_undone_where_that_is_asked_for(folder, keys, words, size):
    ephemeris(write(folder))
    without = load_acquisition(folder.write())
    folder.replace('"a.aem"\n', '"a.aem"\n' + "".join(f"{key} = true\n" for key in keys.split()))
    acquired = load_acquisition(folder.write())
    assert any(words in said for said in describe_acquisition(acquired)["understood"])
    moved = seen(acquired)[2] - seen(without)[2]
    assert np.linalg.norm(moved) == pytest.approx(size, rel=2e-3, abs=1e-3)
    if "aberration" in keys:
        assert moved[2] < 0.0  # light seems to come from further ahead than it does: the ground lies behind


def test_apparent_directions_are_of_the_turning_earth(folder):
    folder.replace('kind = "level-flight"', 'kind = "level-flight"\naberration = true')
    with pytest.raises(FormatError, match="aberration"):
        load_acquisition(folder.write())
    folder.replace("aberration = true\n", "")
    ephemeris(write(folder), "refraction = true\n").add("[surface]\nradii = [6.37e6, 6.37e6]\n")
    with pytest.raises(FormatError, match="refraction = true is of the turning Earth below a satellite"):
        load_acquisition(folder.write())


def test_rows_beyond_the_useable_time_interpolate_and_do_not_cover(folder):
    write(folder)
    text = (folder.path / "a.aem").read_text()
    span = "USEABLE_START_TIME = {}\nUSEABLE_STOP_TIME = 2026-01-01T00:00:01.9\nSTOP_TIME"
    # between two rows, 0.25 s apart, of which the first is not useable
    early = text.replace("STOP_TIME", span.format("2025-12-31T23:59:59.99"), 1)
    (folder.path / "a.aem").write_text(early)
    acquisition = load_acquisition(ephemeris(folder).write())
    assert not acquisition.doubts
    late = text.replace("STOP_TIME", span.format("2026-01-01T00:00:01.1"), 1)
    (folder.path / "a.aem").write_text(late)
    with pytest.raises(SpanError, match=r"the attitudes cover \[1\.250000, 1\.750000\] s"):
        load_acquisition(folder.write())
