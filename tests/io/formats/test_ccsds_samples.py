"""Messages of another implementation's tests, against the lines as they stand, and against astropy."""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
from datetime import datetime

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.io.formats import ccsds
from sightline.io.formats.earth_orientation import TurningEarth

#: Files whose data are MARS GLOBAL SURVEYOR's, by the standard's example, and why the others are refused.
READ = [
    *(f"v2_0_valid_sample{number}" for number in ("01", "03", "05", "07", "09")),
    *("v1_0_valid_sample01", "v3_0_valid_sample01"),
    *("real_CompareExample1", "real_GEO_20s", "real_LEO_10s", "real_MEO_20s"),
]
REFUSED = {
    "v2_0_invalid_sample01": r"begins with 'COMMENT .*'; its first line must be CCSDS_OEM_VERS",
    "v2_0_invalid_sample06": r"line 6: INTERPOLATION_DEGREE = 7\.1 is no whole number",
    "v2_0_invalid_sample08": r"START_TIME = 1996-12-18T12:10:00.331 lies after USEABLE_START_TIME",
    "v2_0_invalid_sample10": r"INTERPOLATION = HERMITE without INTERPOLATION_DEGREE",
    "v2_0_invalid_sample12": r"metadata keyword INVALID_KEY is not known",
    "v2_0_invalid_sample14": r"its segments differ in OBJECT_NAME",
    "v2_0_invalid_sample16": r"line 21 holds 6 values; an instant and 6 or 9 numbers",
    "v2_0_valid_sample11": r"TIME_SYSTEM = ABCD is not handled",
}


def plain(path) -> tuple[list[datetime], np.ndarray]:
    """Instants and the first six numbers of the lines that begin with one."""
    rows = [line.split() for line in path.read_text().splitlines() if re.match(r"\d{4}-\d\d-\d\dT", line)]
    return [datetime.fromisoformat(row[0]) for row in rows], np.array([row[1:7] for row in rows], dtype=float)


@pytest.mark.parametrize("name", READ)
def test_a_valid_message_is_read_with_its_numbers(real_data, name):
    path = real_data("ccsds_samples") / f"{name}.oem"
    instants, numbers = plain(path)
    orbit = ccsds.read_oem(path, instants[0].isoformat())
    # no leap second lies within any of them
    np.testing.assert_allclose(orbit.t, [(at - instants[0]).total_seconds() for at in instants], atol=1e-9)
    np.testing.assert_allclose(np.hstack([orbit.position, orbit.velocity]), numbers * 1e3, rtol=1e-15)
    assert orbit.axes == ("GCRF" if name.startswith("real") else "EME2000")
    assert orbit.centre == ("Earth" if name.startswith("real") else "MARS BARYCENTER")


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_an_invalid_message_is_refused_for_its_reason(real_data, name):
    path = real_data("ccsds_samples") / f"{name}.oem"
    if path.read_text().startswith("<"):
        pytest.importorskip("ccsds_ndm")
    with pytest.raises(FormatError, match=REFUSED[name]):
        ccsds.read_oem(path, "1996-12-18T12:00:00Z")


def test_all_samples_are_tried(real_data):
    assert {path.stem for path in real_data("ccsds_samples").glob("*.oem")} == {*READ, *REFUSED}


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
def test_compressed_messages_are_the_same(real_data, tmp_path, pack):
    path = real_data("ccsds_samples") / "real_LEO_10s.oem"
    packed = tmp_path / "orbit.oem.z"
    packed.write_bytes(pack(path.read_bytes()))
    here, there = (ccsds.read_oem(p, "2020-06-01T12:00:00Z") for p in (path, packed))
    np.testing.assert_array_equal(here.position, there.position)
    packed.write_bytes(pack(path.read_bytes())[:-200])
    with pytest.raises(FormatError, match="cannot be read as a CCSDS message"):
        ccsds.read_oem(packed, "2020-06-01T12:00:00Z")


def test_what_unpacks_without_end_is_refused(tmp_path, monkeypatch):
    from sightline.io.formats import ccsds_message, packed

    path = tmp_path / "bomb.oem"
    path.write_bytes(gzip.compress(b"CCSDS_OEM_VERS = 2.0\n" + b"\0" * 1_000_000))
    small = lambda *given: packed.read_packed_text(*given, most=100_000)  # noqa: E731
    monkeypatch.setattr(ccsds_message, "read_packed_text", small)
    with pytest.raises(FormatError, match="unpacks to more than 100,000 bytes"):
        ccsds.read_oem(path, "2020-06-01T12:00:00Z")


@pytest.mark.parametrize("name", ["real_LEO_10s", "real_MEO_20s", "real_GEO_20s", "real_CompareExample1"])
def test_the_orbit_over_the_turning_earth_is_astropys(real_data, name, capsys):
    coordinates = pytest.importorskip("astropy.coordinates")
    pytest.importorskip("astropy_iers_data")
    from astropy import units
    from astropy.time import Time
    from astropy.utils import iers

    iers.conf.auto_download = False
    path = real_data("ccsds_samples") / f"{name}.oem"
    instants, numbers = plain(path)
    epoch = instants[0].isoformat()
    orbit = ccsds.read_oem(path, epoch)
    fixed = TurningEarth(epoch).axes(orbit.axes, orbit.t)
    mine = fixed.positions(orbit.position), fixed.velocities(orbit.position, orbit.velocity)
    when = Time([at.isoformat() for at in instants], scale="utc")
    given = coordinates.CartesianRepresentation(
        numbers[:, :3].T * units.km,
        differentials=coordinates.CartesianDifferential(numbers[:, 3:].T * units.km / units.s),
    )
    there = coordinates.GCRS(given, obstime=when).transform_to(coordinates.ITRS(obstime=when))
    apart = np.linalg.norm(mine[0] - there.cartesian.xyz.to_value("m").T, axis=1)
    faster = np.linalg.norm(mine[1] - there.velocity.d_xyz.to_value("m/s").T, axis=1)
    with capsys.disabled():
        print(f"\n{path.name} to ITRF against astropy: {apart.max():.3g} m, {faster.max():.2g} m/s at most")
    # the issue asks 1 m; astropy leaves out dX, dY of some 0.2 mas: 1 nrad, 7 mm in a low orbit
    assert (apart <= 2e-9 * np.linalg.norm(mine[0], axis=1)).all() and faster.max() < 1e-4
