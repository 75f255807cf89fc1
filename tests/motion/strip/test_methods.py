"""S1's own estimators (claim 6) in the place of the joint estimate: what they find, and their sigma."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sightline.applications import line_of_sight
from sightline.cli.main import run
from sightline.errors import EstimationError, InputError
from sightline.estimation.prior import Spectrum, TabulatedPsd
from sightline.evaluation.score import remove_directions, score_result
from sightline.geometry.trajectory import Motion
from sightline.io.formats.tables import read_motion
from sightline.motion.strip import methods
from sightline.motion.strip.hyper import KnownContent, window_means
from sightline.motion.strip.methods import by_method
from sightline.motion.strip.normal_equations import TimeGrid
from sightline.motion.strip.strip import METHODS

OTHERS = METHODS[1:]


@pytest.fixture(scope="module")
def truth(recovery):
    return read_motion(recovery.scene / "truth.csv")


@pytest.fixture(scope="module")
def found(recovery):
    """The result of every method beside the joint one."""
    return {method: by_method(*recovery.solved, method) for method in OTHERS}


def visible(result, angles):
    """Angles (N, 3) in px less the hidden directions."""
    return remove_directions(angles / result.scale, result.hidden / result.scale[:, None])


@pytest.mark.parametrize("method", OTHERS)
def test_a_slow_motion_comes_back_whole(recovery, method):
    strip, state, result = recovery.solved
    t = result.motion.t
    size = np.array([3.0, -2.0, 4.0]) * result.scale

    def motion(when):
        x = (when - t[0]) / (t[-1] - t[0])
        return size * np.stack([x**2, x**3, x**2 - x**4], axis=1)

    # differences without error, as the rows of the strip have their times, lags and sigmas
    exact = [replace(d, angles=motion(d.t + d.lag) - motion(d.t)) for d in result.differences]
    back = by_method(strip, state, replace(result, differences=tuple(exact)), method)
    # beyond the first and the last row of windows the departure from the joint estimate is held; cubics of
    # nodes two lines apart reach four lines in
    first, last = min(d.t[0] for d in exact) + 0.002, max((d.t + d.lag).max() for d in exact) - 0.002
    inner = (t > first) & (t < last)
    assert inner.mean() > 0.95
    shapes = result.hidden[inner] / result.scale[:, None]
    left, there = (
        remove_directions(angles[inner] / result.scale, shapes)
        for angles in (back.motion.angles - motion(t), motion(t))
    )
    # A polynomial of degree 5 holds it and leaves the filters nothing. Each method is free of a constant of
    # some px, which is hidden but for what the hidden directions tie to it: 1e-3 of it. Kalman's prior draws
    # the motion towards none by a part of its error.
    tolerance = 3.0 * np.median(result.sigma / result.scale) if method == "kalman" else 3e-3 * 3.0
    assert np.abs(left).max() < tolerance
    assert np.abs(there).max() > 0.2


@pytest.mark.parametrize("method", OTHERS)
def test_sigma_is_true_and_the_error_is_the_departure_from_the_joint_estimate(recovery, truth, found, method):
    result = found[method]
    score, joint = (score_result(one, truth.t, truth.angles).axes for one in (result, recovery.result))
    apart = np.sqrt((visible(result, result.method.departure) ** 2).mean(axis=0))
    for k, axis in enumerate(("roll", "pitch", "yaw")):
        one = score[axis]
        # error of the method = departure + error of the joint estimate, and rms is a norm
        assert abs(one.rms - apart[k]) <= joint[axis].rms * 1.001
        assert abs(one.nees - 1.0) < 5.0 * math.sqrt(2.0 / one.effective_samples) + 0.2, (method, axis)


def test_sigma_of_a_method_is_turned_from_the_axes_of_the_estimate_to_those_of_the_body(
    recovery, monkeypatch
):
    strip, state, result = recovery.solved
    turn = Rotation.from_rotvec([0.4, -0.7, 0.9]).as_matrix()
    root = np.array([[3.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [0.5, 1.5, 1.0]]) * 1e-7
    covariance = root @ root.T

    def estimated(method, differences, t, state):
        return Motion(t, np.zeros((len(t), 3)), np.tile(covariance, (len(t), 1, 1)))

    monkeypatch.setattr(methods, "_estimated", estimated)
    found = by_method(replace(strip, turn=turn), state, result, "inverse")
    # about each axis of the body: a row of the turn there and back
    sigma = [np.sqrt(row @ covariance @ row) for row in turn]
    assert_allclose(found.method.stated_sigma, np.tile(sigma, (len(result.motion.t), 1)), rtol=1e-9)


def test_what_each_method_leaves_out_shows(recovery, truth, found):
    error = {
        method: score_result(result, truth.t, truth.angles).pitch.rms for method, result in found.items()
    }
    joint = score_result(recovery.result, truth.t, truth.angles).pitch.rms
    # tones of 0.30, 0.15 and 0.08 px are no polynomial: sqrt(0.30^2 + 0.15^2 + 0.08^2) / sqrt 2 = 0.24 px
    assert error["polynomial"] > 0.2
    # the smoother knows the spectrum, ends and gaps; filters do not, and a lag is half of this strip
    assert error["kalman"] < 0.2 * min(error[name] for name in ("inverse", "wiener", "polynomial"))
    # exact but for what pairs share, which is correlated by 1/2: a variance of up to twice the best
    assert joint * 0.8 < error["kalman"] < joint * math.sqrt(2.0) * 1.2


def test_files_and_cameras_follow_the_method(found, recovery):
    result, joint = found["polynomial"], recovery.result
    moved = result.cameras[0].trajectory.at(result.motion.t).world_from_body
    before = joint.cameras[0].trajectory.at(result.motion.t).world_from_body
    turned = (before.inv() * moved).as_rotvec()
    # angles are below a mrad, their products below 1e-6 of it; cameras interpolate on the grid
    assert_allclose(turned, result.method.departure, atol=0.01 * np.abs(result.method.departure).max())
    # 0.24 px of tones that it leaves show in every pair
    for left, before in zip(result.after_px, joint.after_px, strict=True):
        assert np.nanmean(left**2) > np.nanmean(before**2) + 0.1**2
    variance = result.band.band[0] - joint.band.band[0]
    assert (variance >= 0.0).all() and variance.max() > 0.0
    assert (result.sigma >= joint.sigma).all()


def test_differences_are_those_of_the_truth_but_for_what_is_hidden(recovery, truth):
    step = 1e-4
    grid = TimeGrid(truth.t[0], step, int((truth.t[-1] - truth.t[0]) / step) + 1)
    nodes = np.stack([np.interp(grid.nodes, truth.t, x) for x in truth.angles.T], axis=1)
    scaled = []
    for pair in recovery.result.differences:
        inside = (pair.t > truth.t[0] + pair.window) & (pair.t + pair.lag < truth.t[-1] - pair.window)
        t, lag = pair.t[inside], pair.lag[inside]
        true = window_means(grid, nodes, t + lag, pair.window) - window_means(grid, nodes, t, pair.window)
        error = (pair.angles[inside] - true) / pair.sigma()[inside]
        # a drift of each axis is hidden, and what is tied to it: a constant and a drift of the differences
        line = np.stack([np.ones(len(t)), t - t.mean()], axis=1) / pair.sigma()[inside][:, :1]
        line /= np.sqrt((line**2).sum(axis=0))
        scaled.append(error - line @ np.linalg.lstsq(line, error, rcond=None)[0])
    left = np.concatenate(scaled)
    assert len(left) > 150
    # of so many rows a mean square scatters by sqrt(2 / n); errors of neighbouring rows, and of pairs of one
    # image, are correlated by up to 1/2: so many effective ones
    spread = 5.0 * math.sqrt(2.0 / (len(left) / 3.0)) + 0.1
    assert ((left**2).mean(axis=0) < 1.0 + spread).all()
    assert ((left**2).mean(axis=0) > 1.0 - spread).all()


class TestCommand:
    @pytest.fixture
    def quick(self, recovery, monkeypatch):
        """Words of the command for the rendered strip, matched and solved already."""
        monkeypatch.setattr(line_of_sight, "joint_line_of_sight", lambda *_: recovery.solved)
        return ["recover", str(recovery.scene / "acquisition.toml")]

    def test_the_method_and_its_own_sigma_are_in_the_summary_and_its_sigma_in_the_table(
        self, quick, found, tmp_path, capsys
    ):
        out = tmp_path / "out"
        assert run([*quick, "--method", "wiener", "--out", str(out)]) == 0
        assert "(by wiener; apart from the joint estimate by roll " in capsys.readouterr().out
        said = json.loads((out / "summary.json").read_text())["method"]
        assert said["name"] == "wiener"
        stated = np.sqrt((found["wiener"].method.stated_sigma ** 2).mean(axis=0)) / found["wiener"].scale
        assert list(said["rms_stated_sigma_px"].values()) == pytest.approx(stated)
        assert min(said["rms_departure_from_joint_px"].values()) > 0.0
        table = read_motion(out / "motion.csv")
        assert_allclose(table.sigma, found["wiener"].sigma, rtol=1e-6)
        assert "method “wiener”, from the angular differences" in (out / "report.html").read_text(
            encoding="utf-8"
        )

    def test_differences_are_written_for_the_joint_estimate_too(self, recovery):
        with (recovery.folder / "differences.csv").open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        assert list(rows[0]) == ["first", "second", "t", "lag", "axis", "value", "sigma"]
        names, differences = recovery.result.image_names, recovery.result.differences
        assert len(rows) == 3 * sum(len(one) for one in differences)
        last = differences[-1]
        assert (rows[-1]["first"], rows[-1]["second"]) == tuple(names[k] for k in last.images)
        assert rows[-1]["axis"] == "yaw" and float(rows[-1]["value"]) == pytest.approx(last.angles[-1, 2])
        assert float(rows[-1]["t"]) == last.t[-1] and float(rows[-1]["lag"]) == pytest.approx(last.lag[-1])
        assert float(rows[-1]["sigma"]) == pytest.approx(last.sigma()[-1, 2])

    def test_a_word_that_is_no_method_is_refused_with_those_that_are(self, quick, tmp_path, capsys):
        assert run([*quick, "--method", "kalmann", "--out", str(tmp_path / "out")]) == 2
        assert "`method` is 'kalmann'; allowed are joint, inverse, wiener" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    def test_frames_have_the_joint_estimate_only(self, tmp_path, capsys):
        scene = tmp_path / "scene"
        few = ["--case", "frames", "--frames", "3"]
        assert run(["simulate", "line-of-sight", *few, "--out", str(scene)]) == 0
        words = ["recover", str(scene / "acquisition.toml"), "--out", str(tmp_path / "out")]
        assert run([*words, "--method", "polynomial"]) == 2
        assert "--method polynomial is for the bands of a strip" in capsys.readouterr().err


def test_a_table_of_a_spectrum_is_no_prior_for_kalman(recovery):
    psd = Spectrum((TabulatedPsd((0.0, 100.0), (1e-12, 1e-12)),))
    with pytest.raises(InputError, match=r"\[known_motion\] psd is a table: leave it out, or take another"):
        line_of_sight.recover_line_of_sight(
            recovery.acquisition.bands,
            recovery.acquisition.surface,
            known=KnownContent(spectra=(psd, psd, psd)),
            options=line_of_sight.RecoverOptions(method="kalman"),
        )


def test_without_a_row_that_shows_all_angles_a_method_is_refused(recovery):
    strip, state, result = recovery.solved
    with pytest.raises(EstimationError, match="rows of windows that show all three angles, and no pair has"):
        by_method(strip, state, replace(result, differences=()), "inverse")
