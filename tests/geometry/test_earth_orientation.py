from __future__ import annotations

import numpy as np
import pytest

from sightline.geometry.earth_orientation import AXES, EarthOrientation, axes_of, fixed_axes

erfa = pytest.importorskip("erfa")
pytest.importorskip("astropy_iers_data")

EPOCH = "2020-06-01T12:00:00"
RADIUS = 7.0e6


@pytest.fixture(scope="module")
def table():
    from sightline.io.formats.earth_orientation import packaged_earth_orientation

    return packaged_earth_orientation(59001.5)


@pytest.fixture(scope="module")
def states():
    """Times (s) from the epoch over two hours, positions, velocities of a circular orbit."""
    t = np.linspace(0.0, 7200.0, 37)
    angle, rate = np.sqrt(3.986e14 / RADIUS**3) * t, np.sqrt(3.986e14 / RADIUS)
    tilt = np.radians(98.0)
    along = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.cos(tilt), np.sin(tilt)])
    place = RADIUS * (np.cos(angle)[:, None] * along[0] + np.sin(angle)[:, None] * along[1])
    speed = rate * (-np.sin(angle)[:, None] * along[0] + np.cos(angle)[:, None] * along[1])
    return t, place, speed


@pytest.mark.parametrize("axes", ["GCRF", "TEME", "CIRS", "TIRS"])
def test_positions_and_velocities_agree_with_astropy(table, states, axes):
    coordinates = pytest.importorskip("astropy.coordinates")
    from astropy import units
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    iers.conf.auto_download = False
    t, place, speed = states
    when = Time(EPOCH, scale="utc") + TimeDelta(t, format="sec")
    given = coordinates.CartesianRepresentation(
        place.T * units.m, differentials=coordinates.CartesianDifferential(speed.T * units.m / units.s)
    )
    theirs = {"GCRF": coordinates.GCRS, "TEME": coordinates.TEME, "CIRS": coordinates.CIRS}
    fixed = fixed_axes(axes, t, (59001, 43200.0 + 37.0), table)
    if (
        axes == "TIRS"
    ):  # astropy has no such axes: what is left is the polar motion of that day, by its matrix
        xp, yp = (float(v) for v in table.pole_at(np.array(59001.5)))
        expected = place @ erfa.pom00(xp, yp, 0.0).T
        # the pole moves 0.2 mas in two hours
        np.testing.assert_allclose(fixed.positions(place), expected, atol=0.02)
        return
    found = theirs[axes](given, obstime=when).transform_to(coordinates.ITRS(obstime=when))
    # what is left out there: dX, dY of some 0.2 mas, 7 mm at 7000 km, and as much per 1.2e6 s of velocity
    np.testing.assert_allclose(fixed.positions(place), found.cartesian.xyz.to_value("m").T, atol=0.02)
    np.testing.assert_allclose(
        fixed.velocities(place, speed), found.velocity.d_xyz.to_value("m/s").T, atol=5e-5
    )


def test_axes_of_equator_and_equinox_are_those_of_erfa(table):
    t = np.array([0.0, 777.0])
    tai = (59001, 43237.0)
    tt = (2400000.5 + 59001, (43237.0 + 32.184 + t) / 86400.0)
    to_fixed = {axes: fixed_axes(axes, t, tai, table).turn for axes in AXES}
    bias, _, mean, _, true = erfa.pn06a(*tt)[3:8]
    # GCRF = B' EME2000 = (P B)' MOD = (N P B)' TOD; dX, dY (0.2 mas, 1e-9 rad) are not in erfa's matrices
    for axes, matrix in (("EME2000", bias), ("MOD", mean), ("TOD", true)):
        expected = to_fixed["GCRF"] @ np.swapaxes(matrix, -1, -2)
        np.testing.assert_allclose(to_fixed[axes], expected, atol=3e-9, err_msg=axes)


def test_the_celestial_pole_is_that_of_the_theory_with_the_offsets_of_the_table():
    """Without polar motion the third of the Earth-fixed axes is the celestial pole, (X + dX, Y + dY)."""
    days, offset, still = np.array([59000.0, 59003.0]), np.array([2e-6, -3e-6]), np.zeros(2)
    table = EarthOrientation(days, np.zeros((2, 2)), still - 37.0, np.tile(offset, (2, 1)), still, still, "")
    t = np.array([0.0, 86400.0])
    pole = fixed_axes("GCRF", t, (59001, 0.0), table).turn[:, 2, :2]
    x, y, _ = erfa.xys06a(2400000.5 + 59001, (32.184 + t) / 86400.0)
    # s' turns by 1e-10 rad about the pole itself
    np.testing.assert_allclose(pole, np.column_stack([x, y]) + offset, rtol=0.0, atol=1e-11)


def test_the_change_is_that_of_the_axes(table):
    t = np.array([100.0])
    near = [fixed_axes("EME2000", t + shift, (59001, 0.0), table).turn[0] for shift in (-5.0, 5.0)]
    change = fixed_axes("EME2000", t, (59001, 0.0), table).change[0]
    # the third derivative of a turn at 7.3e-5 rad/s over 5 s: (7.3e-5)^3 5^2 / 6 = 1.6e-12
    np.testing.assert_allclose(change, (near[1] - near[0]) / 10.0, atol=3e-12)


def test_coarse_steps_cost_nothing(table):
    t = np.linspace(0.0, 3000.0, 31)
    together = fixed_axes("GCRF", t, (59001, 0.0), table).turn
    alone = np.stack([fixed_axes("GCRF", [at], (59001, 0.0), table).turn[0] for at in t])
    np.testing.assert_allclose(together, alone, atol=3e-12)


def test_names_of_axes_are_known_in_all_their_spellings():
    for name, key in (
        ("ITRF", "ITRF"), ("ITRF2014", "ITRF"), ("ITRF-97", "ITRF"), ("itrf2000", "ITRF"), ("WGS84", "ITRF"),
        ("EME2000", "EME2000"), ("J2000", "EME2000"), ("ICRF", "GCRF"), ("ICRF3", "GCRF"), ("GCRF", "GCRF"),
        ("TEME", "TEME"), ("TOD", "TOD"), ("TOD_EARTH", "TOD"), ("TEMEOFDATE", "TEME"), ("TDR", "TIRS"),
    ):  # fmt: skip
        assert axes_of(name) == key, name
    for name in ("EME1950", "B1950", "MCI", "RTN", "IAU_MARS", "ITRFX", ""):
        assert axes_of(name) is None, name


def test_beyond_the_table_the_sigma_is_what_that_really_costs(table):
    """The series up to a day, continued, against what came: a third to three times the sigma told."""
    for days in (30.0, 100.0, 1000.0):
        errors, told = [], []
        for end in np.arange(45000.0, table.mjd[-1] - days, 401.0):
            known = table.mjd <= end
            cut = EarthOrientation(
                table.mjd[known], table.pole[known], table.ut1_less_tai[known], table.cip[known],
                table.sigma_pole[known], table.sigma_ut1[known], "cut",
            )  # fmt: skip
            errors.append(float(cut.ut1_less_tai_at(end + days) - table.ut1_less_tai_at(end + days)))
            told.append(cut.sigma_at(end + days)[0])
        ratio = np.sqrt(np.mean(np.square(errors))) / np.mean(told)
        assert 1 / 3 < ratio < 3, (days, ratio)


def test_before_the_table_ut1_is_utc_within_a_second(table):
    assert float(table.ut1_less_tai_at(30000.0)) == -10.0
    # a table that begins late: leap seconds of the day, not of its first row (34 s in 2010, 37 s since 2017)
    known = table.mjd > 58818.0
    cut = EarthOrientation(
        table.mjd[known], table.pole[known], table.ut1_less_tai[known], table.cip[known],
        table.sigma_pole[known], table.sigma_ut1[known], "cut",
    )  # fmt: skip
    assert float(cut.ut1_less_tai_at(55350.0)) == -34.0
    assert abs(float(table.ut1_less_tai_at(55350.0)) + 34.0) < 0.9
    assert table.sigma_at(30000.0)[0] == 0.5 and not table.covers(30000.0)


@pytest.mark.parametrize("later", [1.0, 4000.0])
def test_days_after_c04_are_of_finals2000a(later):
    """Also days that no table reaches: the last row holds, with a sigma that grows."""
    from sightline.io.formats.earth_orientation import packaged_earth_orientation

    c04 = packaged_earth_orientation(0.0)
    day = float(c04.mjd[-1]) + later
    table = packaged_earth_orientation(day)
    assert table.source.startswith("IERS finals2000A") and table.covers(day) == (later == 1.0)
    # UT1 of both on the last day of the former, and what is not known of it later: 15 ms after a year or so
    assert abs(table.ut1_less_tai_at(c04.mjd[-1]) - c04.ut1_less_tai[-1]) < 1e-4
    assert (table.sigma_at(day)[0] > 0.1) == (later > 1.0)


def test_offsets_of_iau_1980_are_refused(tmp_path):
    """dPsi stands where dX does: some -0.1 arcseconds."""
    from sightline.errors import FormatError
    from sightline.io.formats.earth_orientation import read_earth_orientation

    row = (
        " I  0.076577 0.000030  0.282336 0.000028  I-0.1771554 0.0000055  0.4421 0.0030"
        "  I  -104.100    0.230    -8.900    0.160"
    )
    (tmp_path / "finals.all").write_text("\n".join(f"200101 588{49 + k}.00{row}" for k in range(3)))
    with pytest.raises(FormatError, match=r"of the older model IAU 1980 \(dPsi, dEps\)"):
        read_earth_orientation(tmp_path / "finals.all")
