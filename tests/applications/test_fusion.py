"""A rendered strip with gyro, star tracker and control points: where matching starts, what is absolute."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.estimation.prior import Spectrum, TabulatedPsd
from sightline.evaluation.score import score_motion, score_result
from sightline.geometry.trajectory import Motion, Trajectory
from sightline.io.formats.tables import read_motion
from sightline.motion.sensors import AttitudeSensor, ControlSightings
from sightline.motion.strip.hyper import KnownContent
from sightline.motion.strip.strip import RecoverOptions

#: rad/s; between PAN and B1, 0.15 s apart, this is 30 px, and the first search goes 8 px far.
RAMP = np.array([0.0, 200.0 * 5e-6, 0.0])
ONE_PASS = RecoverOptions(passes=1)


@pytest.fixture(scope="module")
def turning(recovery):
    """The strip of `recovery` with a reference attitude that turns away by RAMP: bands, truth against it."""
    old = recovery.acquisition.bands[0].camera.trajectory
    t = np.linspace(*old.span, 201)
    turned = old.at(t).world_from_body * Rotation.from_rotvec(-np.outer(t, RAMP))
    reference = Trajectory(old.t_position, old.position, t, turned, velocity=old.velocity)
    base = recovery.acquisition.bands[:3]  # of four: two thirds of the pairs would say no more
    bands = [replace(b, camera=b.camera.with_trajectory(reference)) for b in base]
    true = read_motion(recovery.scene / "truth.csv")
    # the reference falls behind by RAMP t
    whole = Rotation.from_rotvec(np.outer(true.t, RAMP)) * Rotation.from_rotvec(true.angles)
    truth = Motion(true.t, whole.as_rotvec())
    return SimpleNamespace(
        bands=bands,
        truth=truth,
        surface=recovery.acquisition.surface,
        base=base,
        truth_of_base=Motion(true.t, true.angles),
    )


def gyro(truth: Motion, rng, sigma: float) -> AttitudeSensor:
    """Increments at 100 Hz."""
    edges = np.arange(truth.t[0], truth.t[-1], 0.01)
    angles = np.diff(truth.at(edges), axis=0) + sigma * rng.standard_normal((len(edges) - 1, 3))
    return AttitudeSensor(
        "gyro", "gyro", edges[:-1], edges[1:], angles, np.full(len(angles), sigma), 0.0, 0.0, 0.0
    )


def tracker(truth: Motion, rng, sigma: float) -> AttitudeSensor:
    """Ten fixes."""
    t = np.linspace(truth.t[0], truth.t[-1], 10)
    angles = truth.at(t) + sigma * rng.standard_normal((10, 3))
    return AttitudeSensor("tracker", "star-tracker", t, t, angles, np.full(10, sigma), 0.0, 0.0, 0.0)


def control(bands, truth: Motion, surface, rng, count: int) -> ControlSightings:
    """Points of the first band, whose true place in its focal plane is not known: sigma 3.4 m is one px."""
    camera = bands[0].camera.with_trajectory(bands[0].camera.trajectory.with_motion(truth))
    pixels = rng.uniform([20.0, 0.0], [620.0, 319.0], (count, 2))
    points = camera.locate(pixels, surface) + 3.4 * rng.standard_normal((count, 3)) * [1.0, 1.0, 0.0]
    return ControlSightings(points, np.full(count, 3.4), np.zeros(count, dtype=np.intp), pixels)


def kept_share(result) -> float:
    """Of the windows tried between the first and the second image, 0.17 s apart."""
    pair = next(p for p in result.pairs if p.images == (0, 1))
    return pair.kept / pair.tried


def nees_bound(axis) -> float:
    """How far NEES may be from 1: some 150 independent errors, sigma known to 10 % on so short a strip."""
    return float(5.0 * np.sqrt(2.0 / axis.effective_samples) + 0.2)


def test_a_motion_beyond_the_search_loses_the_long_lags_without_sensors(turning):
    result = recover_line_of_sight(turning.bands, turning.surface, options=ONE_PASS)
    assert kept_share(result) < 0.1
    assert any("PAN matches nothing" in said for said in result.warnings)


def test_a_gyro_leads_the_matches_and_a_tracker_gives_the_constant(turning):
    rng = np.random.default_rng(5)
    sensors = [gyro(turning.truth, rng, 0.05 * 5e-6), tracker(turning.truth, rng, 3.0 * 5e-6)]
    result = recover_line_of_sight(turning.bands, turning.surface, sensors=sensors, options=ONE_PASS)
    score = score_motion(
        result.motion.t,
        result.motion.angles,
        result.sigma,
        turning.truth.t,
        turning.truth.angles,
        hidden=result.hidden,
        absolute_sigma=result.absolute_sigma,
        ifov=result.ifov,
        half_field_px=159.5,
    )
    assert kept_share(result) > 0.9
    for axis in score.axes.values():
        assert abs(axis.nees - 1.0) < nees_bound(axis)
    # ten fixes of 3 px, known to each other by the gyro to far less
    for name in ("roll", "pitch"):
        assert score.absolute[name].sigma == pytest.approx(3.0 / np.sqrt(10.0), rel=0.1)
        # a constant of one draw: 4 sigma
        assert score.absolute[name].rms < 4.0 * score.absolute[name].sigma
    assert [use.name for use in result.sensors] == ["gyro", "tracker"]
    assert result.sensors[1].used == 10
    assert all(factor == 1.0 for factor in result.sensors[0].sigma_factor)


def test_control_points_tie_what_they_see(turning):
    rng = np.random.default_rng(6)
    points = control(turning.base, turning.truth_of_base, turning.surface, rng, 13)
    pixels = points.pixels.copy()
    pixels[12, 0] += 5000.0
    points = replace(points, pixels=pixels)
    base = turning.base[:2]
    result = recover_line_of_sight(base, turning.surface, control_points=points, options=ONE_PASS)
    error = result.motion.angles - turning.truth_of_base.at(result.motion.t)
    sigma = result.absolute_sigma
    assert any("1 of 13 control points lie beyond the image" in said for said in result.warnings)
    assert np.isfinite(sigma).all()
    assert (np.abs(error.mean(axis=0)) < 4.0 * sigma.mean(axis=0)).all()
    # twelve points of one px, and the offset of their own band, known to one px a priori and better beside
    # the other bands, whose offsets differ: between 1 / sqrt(12) and 1.1 px
    assert (sigma[:, :2].mean(axis=0) / 5e-6 > 0.28).all()
    assert (sigma[:, :2].mean(axis=0) / 5e-6 < 1.1).all()


def test_a_given_spectrum_is_taken_as_it_is(turning):
    # half a px^2 up to 60 Hz, nothing above
    px = [5e-6, 5e-6, 1.0 / 159.5]
    given = [Spectrum((TabulatedPsd((0.0, 60.0), (0.5 / 60.0, 0.5 / 60.0)),)).scaled(p) for p in px]
    known = KnownContent(spectra=(given[0], given[1], given[2]))
    result = recover_line_of_sight(turning.base[:2], turning.surface, known=known, options=ONE_PASS)
    assert result.spectra == known.spectra
    found = np.abs(np.fft.rfft(result.motion.angles[:, 0] * np.hanning(640)))
    f = np.fft.rfftfreq(640, 5e-4)
    # the strip's own tone of 83 Hz (0.15 px) and all else above is not let through
    assert found[f > 75.0].max() < 0.05 * found[(f > 1.0) & (f < 60.0)].max()


def test_one_wrong_reading_does_not_spoil_what_the_images_tell(turning):
    truth = turning.truth_of_base
    wrong_gyro = gyro(truth, np.random.default_rng(8), 1e-8)
    angles = wrong_gyro.angles.copy()
    angles[12, 1] += 60.0 * 5e-6
    points = control(turning.base, truth, turning.surface, np.random.default_rng(9), 6)
    pixels = points.pixels.copy()
    pixels[2, 0] += 60.0
    result = recover_line_of_sight(
        turning.base,
        turning.surface,
        sensors=[replace(wrong_gyro, angles=angles)],
        control_points=replace(points, pixels=pixels),
        options=ONE_PASS,
    )
    # 60 px believed would be hundreds of sigmas
    for axis in score_result(result, truth.t, truth.angles).axes.values():
        assert abs(axis.nees - 1.0) < nees_bound(axis)
    assert kept_share(result) > 0.9


def test_a_given_spectrum_that_lacks_the_motion_is_said_to(turning):
    # 20 to 60 Hz alone: the strip drifts by pixels below
    band = TabulatedPsd((0.0, 19.0, 20.0, 60.0, 61.0), (0.0, 0.0, 0.01, 0.01, 0.0))
    given = [Spectrum((band,)).scaled(p) for p in (5e-6, 5e-6, 1.0 / 159.5)]
    known = KnownContent(spectra=(given[0], given[1], given[2]))
    result = recover_line_of_sight(turning.base[:2], turning.surface, known=known, options=ONE_PASS)
    assert any("does not hold the motion that the images show" in said for said in result.warnings)
    # the windows were moved by the motion that the images show, not by what the band makes of it
    assert kept_share(result) > 0.5
