"""Gyros and quaternions of PHRDIMAP files."""

from __future__ import annotations

import numpy as np
import pytest

import maker_files as maker
from sightline.errors import FormatError
from sightline.estimation.allan import allan_deviation
from sightline.io.formats.products.pleiades_telemetry import read_pleiades_telemetry
from sightline.motion.gyros import fit_gyros


@pytest.fixture(scope="module")
def phrdimap(real_data):
    """The file of a product of Pleiades."""
    return real_data("vendor_models") / "PHRDIMAP_P1BP--2017030824934340CP.XML"


@pytest.fixture(scope="module")
def telemetry(phrdimap):
    """Gyros and attitudes of the file, and the fit of the one to the other."""
    read = read_pleiades_telemetry(phrdimap)
    return read, fit_gyros(read.t, read.counts, read.t_attitude, read.stars_from_body)


def test_gyros_of_pleiades_have_their_published_scale_and_axes(telemetry):
    _, fit = telemetry
    np.testing.assert_allclose(fit.scale, 5.0e-9, rtol=0.01)
    apart = np.degrees(np.arccos((fit.axes @ fit.axes.T)[np.triu_indices(4, 1)]))
    np.testing.assert_allclose(apart, np.degrees(np.arccos(-1 / 3)), atol=0.5)
    assert abs(fit.lag) < 5e-3
    # per .125 s; rounding of the quaternions to 1e-8 alone makes .008 urad
    assert fit.residual.std(axis=0).max() < 0.012e-6


def test_filtered_angles_are_late(phrdimap):
    read = read_pleiades_telemetry(phrdimap, angle="ANGLE_FILT")
    assert 0.010 < fit_gyros(read.t, read.counts, read.t_attitude, read.stars_from_body).lag < 0.020


def test_the_parity_of_pleiades_has_its_allan_deviation(telemetry):
    read, fit = telemetry
    tau, deviation = allan_deviation(fit.parity(read.counts), 1 / 32, [4, 32])
    np.testing.assert_allclose(tau, [0.125, 1.0])
    np.testing.assert_allclose(deviation, [6e-7, 9.5e-8], rtol=0.3)


def test_times_by_the_counters_of_each_gyro_are_there_for_who_wants_them(phrdimap):
    path = phrdimap
    late = [
        read_pleiades_telemetry(path, angle="ANGLE_FILT", clock=clock) for clock in ("labels", "counters")
    ]
    half = [0.5 * 5e-9 * read.counts.sum(axis=1) for read in late]
    deviation = [allan_deviation(sum_, 1 / 32, [1])[1][0] for sum_ in half]
    # the sheet: 7.8e-7 falls to 3.3e-7 rad/s
    np.testing.assert_allclose(deviation, [7.8e-7, 3.3e-7], rtol=0.1)


def test_counters_that_wrap_are_unwrapped(tmp_path):
    read = read_pleiades_telemetry(maker.pleiades(tmp_path))
    assert np.abs(np.diff(read.counts, axis=0)).max() < 1e6
    fit = fit_gyros(read.t, read.counts, read.t_attitude, read.stars_from_body)
    # 4 s of .004 rad: 4e-8 rad of rounding and noise against .003 rad
    np.testing.assert_allclose(fit.axes, maker.AXES, atol=2e-3)
    np.testing.assert_allclose(fit.scale, maker.COUNT, rtol=2e-3)


def test_a_product_without_telemetry_has_none(tmp_path):
    path = maker.pleiades(tmp_path, changes=[("FOG1_Auxiliary_Data_List", "None")])
    assert read_pleiades_telemetry(path) is None


def test_a_hole_in_the_gyros_is_refused(tmp_path):
    changes = [("<STATUS>NOMINAL</STATUS></FOG", "<STATUS>LOST</STATUS></FOG")]
    with pytest.raises(FormatError, match="STATUS is not NOMINAL"):
        read_pleiades_telemetry(maker.pleiades(tmp_path, changes=changes))
