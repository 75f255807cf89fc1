"""A rendered strip whose orbit and attitude are Earth-fixed, and in EME2000: the same geometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats import ccsds, tables

EPOCH = "2026-01-01T00:00:00Z"
#: GCRF against the mean equator and equinox of 2000 (IERS Conventions 2010, 5.21 and 5.33), rad.
MAS = np.pi / 180.0 / 3600e3
XI, ETA, ALPHA = -16.6170 * MAS, -6.8192 * MAS, -14.6 * MAS


def eme2000_from_gcrf() -> Rotation:
    """The frame bias as a small turn: R1(-eta) R2(xi) R3(d alpha) of components."""
    return Rotation.from_rotvec([ETA, -XI, -ALPHA])


def eme2000(t, place, speed, body):
    """Earth-fixed states in EME2000: by erfa as a whole, IERS tables by astropy, the bias above."""
    erfa = pytest.importorskip("erfa")
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    iers.conf.auto_download = False
    table = iers.IERS_B.open()

    def gcrf_from_fixed(at):
        when = Time(EPOCH[:-1], scale="utc") + TimeDelta(at, format="sec")
        (x, y), (dx, dy) = table.pm_xy(when), table.dcip_xy(when)
        tt = when.tt
        ut1 = when.utc.jd1, when.utc.jd2 + table.ut1_utc(when).to_value("s") / 86400.0
        cx, cy = erfa.xy06(tt.jd1, tt.jd2)
        turn = erfa.c2txy(
            tt.jd1, tt.jd2, *ut1, cx + dx.to_value("rad"), cy + dy.to_value("rad"),
            x.to_value("rad"), y.to_value("rad"),
        )  # fmt: skip
        return np.swapaxes(turn, -1, -2)

    bias = eme2000_from_gcrf().as_matrix()
    turn = bias @ gcrf_from_fixed(t)
    change = bias @ (gcrf_from_fixed(t + 0.5) - gcrf_from_fixed(t - 0.5))
    velocity = np.einsum("nij,nj->ni", turn, speed) + np.einsum("nij,nj->ni", change, place)
    return np.einsum("nij,nj->ni", turn, place), velocity, Rotation.from_matrix(turn) * body


def states(folder):
    """Times, positions, velocities and attitudes of a scene's tables, at the times of its attitudes."""
    t_place, place = tables.read_positions(folder / "positions.csv")
    t, quat = tables.read_attitudes(folder / "attitudes.csv")
    # any smooth path will do, as long as both files hold it: a polynomial through the table
    fit = np.polynomial.Polynomial
    curves = [fit.fit(t_place, place[:, k], 8) for k in range(3)]
    inside = (t >= t_place[0]) & (t <= t_place[-1])
    t, body = t[inside], Rotation.from_quat(quat[inside])
    position = np.stack([curve(t) for curve in curves], axis=1)
    velocity = np.stack([curve.deriv()(t) for curve in curves], axis=1)
    return t, position, velocity, body


#: rad; a thousandth of the least sigma of motion that `recover` tells of such strips (3e-8 rad, 1600 lines).
LIMIT = 1e-3 * 3e-8


@pytest.mark.parametrize("altitude", [410e3, 680e3], ids=["iss-like", "leo"])
def test_attitudes_in_eme2000_and_in_itrf_are_one_to_a_thousandth_of_the_sigma(tmp_path, altitude, capsys):
    """What the motion is counted from, and where every band sees what another sees, is the same.

    The estimate itself stops where a pass changes it by less than .2 sigma: it differs by more than this test
    asks where the same file is changed by 1e-12 rad.
    """
    pytest.importorskip("astropy")
    from sightline.cli.main import run

    words = f"simulate line-of-sight --case pushbroom --lines 400 --columns 200 --set altitude={altitude}"
    assert run([*words.split(), "--seed", "3", "--out", str(tmp_path / "scene")]) == 0
    folder = tmp_path / "scene"
    toml = folder / "acquisition.toml"
    toml.write_text(toml.read_text().replace("positions.csv", "o.oem").replace("attitudes.csv", "a.aem"))
    t, place, speed, body = states(folder)
    given = {}
    for axes, state in (("ITRF", (place, speed, body)), ("EME2000", eme2000(t, place, speed, body))):
        ccsds.write_oem(folder / "o.oem", t, *state[:2], EPOCH, frame=axes)
        ccsds.write_aem(folder / "a.aem", t, state[2].as_quat(), EPOCH, frame=axes)
        given[axes] = load_acquisition(toml)
    here, there = given["ITRF"], given["EME2000"]
    times = here.cameras[0].times(np.arange(400.0))
    poses = [one.cameras[0].trajectory.at(times) for one in (here, there)]
    apart = (poses[0].world_from_body.inv() * poses[1].world_from_body).magnitude()
    pixels = np.stack(np.meshgrid(np.arange(0, 400, 57.0), np.arange(0, 200, 33.0)), axis=-1).reshape(-1, 2)
    seen = [
        [camera.project(one.cameras[0].locate(pixels, one.surface)) for camera in one.cameras[1:]]
        for one in (here, there)
    ]
    shift = max(float(np.nanmax(np.abs(a - b))) for a, b in zip(*seen, strict=True))
    with capsys.disabled():
        print(f"\n{altitude / 1e3:.0f} km: EME2000 and ITRF {apart.max():.2g} rad and {shift:.2g} px apart")
    assert apart.max() < LIMIT
    # of one band against another the common part is gone: a thousandth of what a match knows, 0.01 px at best
    assert shift < 1e-5
