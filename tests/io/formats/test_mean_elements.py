from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.io.acquisition.ephemeris import read_orbit
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.mean_elements import is_tle, read_omm, read_tle

sgp4 = pytest.importorskip("sgp4.api")

#: Elements of 00005 of the test cases of Spacetrack Report #3 (revisited, 2006), with their first states:
#: km, km/s
#: in TEME at the epoch and 360 minutes after it.
TLE = """VANGUARD 1
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""
EPOCH = "2000-06-27T18:50:19.733568Z"
PUBLISHED = {
    0.0: ([7022.46529266, -1400.08296755, 0.03995155], [1.893841015, 6.405893759, 4.534807250]),
    360.0: ([-7154.03120202, -3783.17682504, -3536.19412294], [4.741887409, -4.151817765, -2.093935425]),
}
OMM = """CCSDS_OMM_VERS = 2.0
CREATION_DATE = 2000-06-28T00:00:00
ORIGINATOR = TEST
OBJECT_NAME = VANGUARD 1
OBJECT_ID = 1958-002B
CENTER_NAME = EARTH
REF_FRAME = TEME
TIME_SYSTEM = UTC
MEAN_ELEMENT_THEORY = SGP4
EPOCH = 2000-06-27T18:50:19.733568
MEAN_MOTION = 10.82419157 [rev/day]
ECCENTRICITY = 0.1859667
INCLINATION = 34.2682 [deg]
RA_OF_ASC_NODE = 348.7242
ARG_OF_PERICENTER = 331.7664
MEAN_ANOMALY = 19.3264
EPHEMERIS_TYPE = 0
NORAD_CAT_ID = 5
BSTAR = 0.000028098
"""


def write(tmp_path, text, name="elements"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(("text", "read"), [(TLE, read_tle), (TLE[11:], read_tle), (OMM, read_omm)])
@pytest.mark.parametrize("minutes", sorted(PUBLISHED))
def test_positions_are_the_published_ones(tmp_path, text, read, minutes):
    # a whole number of steps of the table from its margin on: the middle row is the instant itself
    orbit = read(write(tmp_path, text), EPOCH, (60.0 * minutes, 60.0 * minutes))
    row = int(np.argmin(np.abs(orbit.t - 60.0 * minutes)))
    assert orbit.t[row] == pytest.approx(60.0 * minutes, abs=1e-9)
    place, speed = PUBLISHED[minutes]
    # elements are written to a day of 1e-8 (1 ms, 7 m); the OMM's epoch is that of the TLE to 1 us
    np.testing.assert_allclose(orbit.position[row] / 1e3, place, atol=0.01)
    np.testing.assert_allclose(orbit.velocity[row] / 1e3, speed, atol=1e-5)
    assert orbit.age == pytest.approx(minutes / 1440.0, abs=1e-6)
    assert orbit.sigma == pytest.approx(1e3 * np.hypot(1.0, 2.0 * minutes / 1440.0), rel=1e-6)


def test_of_several_sets_the_nearest_is_taken(tmp_path):
    other = TLE.replace("00179.78495062", "00189.78495062").replace("0  4753", "0  4754")
    path = write(tmp_path, TLE + other)
    assert is_tle(path) and not is_tle(write(tmp_path, "t,x,y,z\n0,1,2,3\n", "p.csv"))
    assert read_tle(path, EPOCH, (9.5 * 86400.0, 9.5 * 86400.0)).age == pytest.approx(-0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TLE.replace("34.2682", "34.2683"), "line 3: its check sum is '7', its characters give 8"),
        (TLE.rstrip()[:-20], "line 3: is no line 2 of two-line elements of 69 characters"),
        (TLE.splitlines()[0] + "\n", "holds no two-line elements"),
        (
            TLE + TLE.replace("00005", "00006").replace("4753", "4754").replace("3667", "3668"),
            "elements of several satellites",
        ),
    ],
)
def test_lines_that_are_spoilt_are_refused(tmp_path, text, words):
    with pytest.raises(FormatError, match=words):
        read_tle(write(tmp_path, text), EPOCH)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("= SGP4", "= DSST", "MEAN_ELEMENT_THEORY = DSST is not handled; allowed: SGP4, SGP"),
        ("= TEME", "= EME2000", "REF_FRAME = EME2000 is not handled; allowed: TEME"),
        ("BSTAR = 0.000028098\n", "", "BSTAR is missing, which SGP4 needs"),
        ("0.1859667", "1.1859667", "SGP4 cannot propagate these elements to the images"),
        ("EPHEMERIS_TYPE = 0", "EPHEMERIS_TYPE = 4", "of EPHEMERIS_TYPE 0; give an OEM"),
        ("34.2682", "steep", "an element is no number"),
        (
            "2000-06-27T18",
            "200006-27T18",
            "elements: EPOCH: '200006-27T18:50:19.733568' is not a UTC instant",
        ),
    ],
)
def test_a_message_that_cannot_be_propagated_is_refused(tmp_path, old, new, words):
    with pytest.raises(FormatError, match=words):
        read_omm(write(tmp_path, OMM.replace(old, new)), EPOCH)


def test_a_strip_may_name_elements_and_is_told_how_good_they_are(folder):
    """Against astropy's TEME over the turning Earth."""
    coordinates = pytest.importorskip("astropy.coordinates")
    pytest.importorskip("erfa")
    from astropy import units
    from astropy.time import Time
    from astropy.utils import iers

    iers.conf.auto_download = False
    (folder.path / "orbit.tle").write_text(TLE)
    folder.replace("2026-01-01T00:00:00Z", "2000-06-28T18:50:19.733568Z")
    folder.replace(
        'kind = "level-flight"\naltitude = 700e3\nground_speed = 7000.0',
        'kind = "ephemeris"\npositions = "orbit.tle"\nattitude_sigma = 1e-9',
    )
    acquisition = load_acquisition(folder.write())
    (doubt,) = acquisition.doubts
    assert "orbit.tle: mean elements of 1 days before the images are good to some 2.2 km" in doubt
    assert (
        "orbit.tle: a TLE of VANGUARD 1, of 1 days before the images, by SGP4 in axes TEME"
        in acquisition.sources
    )
    given = acquisition.cameras[0].trajectory.at([0.05]).position
    height = np.linalg.norm(given) - 6378137.0
    # the height counted is that of the nearest position, 5 s away: 1 km/s of climb over 1300 km
    assert acquisition.known_motion.usual()[0] == pytest.approx(np.sqrt(5.0) * 1e3 / height, rel=0.01)
    orbit = read_orbit(folder.path / "orbit.tle", "2000-06-28T18:50:19.733568Z")
    when = Time("2000-06-28T18:50:19.733568", scale="utc") + orbit.t * units.s
    there = coordinates.TEME(orbit.position.T * units.m, obstime=when, representation_type="cartesian")
    fixed = there.transform_to(coordinates.ITRS(obstime=when)).cartesian.xyz.to_value("m").T
    middle = np.array([np.interp(0.05, orbit.t, fixed[:, k]) for k in range(3)])
    # straight between positions 8.6 s apart: 9 m/s^2 (0.05 s)(8.6 s) / 2 = 2 m
    np.testing.assert_allclose(given[0], middle, atol=4.0)
