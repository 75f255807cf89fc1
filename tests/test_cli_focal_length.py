"""``sightline georeference`` of a camera whose given focal length is wrong: every file has the one found."""

from __future__ import annotations

import json

import numpy as np
import pytest

from consistency import assert_possible
from sightline.cli.main import run
from sightline.io.formats.colmap import read_colmap_model
from sightline.io.formats.opensfm import read_opensfm
from sightline.io.formats.tables import read_columns
from sightline.io.results.poses import read_pose_covariance
from sightline.io.sequence.load import load_sequence

#: Level ground, and positions to 5 cm above it.
WORDS = (
    "--case small --frames 24 --seed 5 --set truth_bands=0 --set relief=0.001 --set position_sigma=0.05 "
    "--set position_bias_sigma=0.05 --set distortion=-0.15 --set focal_error=0.02 "
    f"--set attitude_sigma={np.radians(0.05)}"
).split()


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    out = tmp_path_factory.mktemp("focal") / "flight"
    assert run(["simulate", "frames", *WORDS, "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def done(flight):
    out = flight.parent / "located"
    assert run(["georeference", str(flight / "sequence.toml"), "--poses-only", "--out", str(out)]) == 0
    return out


def test_what_is_given_is_wrong_and_how_well_it_is_known(flight):
    problem = load_sequence(flight / "sequence.toml")
    given = problem.detector.focal_length_px
    assert given == pytest.approx(250.0 / 1.02) and problem.focal_length_sigma_px == pytest.approx(
        0.02 * given
    )
    assert (flight / "truth-focal.csv").read_text() == "camera,focal_length_px\n1,250.0\n"


def test_the_summary_and_the_covariances_have_it(done):
    focal = json.loads((done / "summary.json").read_text())["focal_length"]
    # the flying height is given to 0.1 m of 80 m and less, a trend of pitch over the short flight to 0.1 deg
    assert focal["sigma_px"] < 0.5 * focal["told_sigma_px"]
    assert abs(focal["focal_length_px"] - 250.0) < 4.0 * focal["sigma_px"]
    kept = read_pose_covariance(done / "covariance.npz").focal_length
    assert kept is not None and kept.px == focal["focal_length_px"]
    assert np.sqrt(kept.covariance[6]) == pytest.approx(focal["sigma_px"])


def test_other_programs_get_the_camera_that_was_found(done):
    px = json.loads((done / "summary.json").read_text())["focal_length"]["focal_length_px"]
    for model in (read_colmap_model(done / "colmap"), read_opensfm(done / "reconstruction.json")[0]):
        assert model.detectors[0].focal_length_px == pytest.approx(px)
        assert model.detectors[0].distortion[0] == pytest.approx(-0.15)
    # a flat world: the model has its axes
    priors = read_columns(done / "colmap" / "pose_priors.csv", ("x", "cov_xx", "cov_yz"))
    covariance = read_pose_covariance(done / "covariance.npz")
    np.testing.assert_allclose(priors["cov_xx"], covariance.covariance[:, 0, 0], rtol=1e-6)
    np.testing.assert_allclose(priors["cov_yz"], covariance.covariance[:, 1, 2], rtol=1e-6)
    assert covariance.scale_sigma > 0.0 and covariance.pair_covariance is not None


def test_the_score_compares_it_with_the_truth(flight, done, capsys):
    capsys.readouterr()
    assert run(["score", str(done), str(flight / "poses-truth.csv")]) == 0
    score = json.loads(capsys.readouterr().out)
    focal = json.loads((done / "summary.json").read_text())["focal_length"]
    assert score["focal_length"]["error_px"] == pytest.approx(focal["focal_length_px"] - 250.0)
    assert abs(score["focal_length"]["error_over_sigma"]) < 4.0
    assert_possible(score["absolute"]["nees"], 6)  # all frames share one draw of the datum


def test_words_on_the_terminal_and_the_page(flight, done, capsys):
    capsys.readouterr()
    assert run(["check", str(flight / "sequence.toml")]) == 0
    assert "it is found with the poses" in capsys.readouterr().out
    page = (done / "report.html").read_text()
    assert "The focal length was found with the poses" in page and "given was 245.098 px" in page


def test_an_error_beyond_half_is_refused(tmp_path, capsys):
    assert run(["simulate", "frames", "--set", "focal_error=0.7", "--out", str(tmp_path / "no")]) == 2
    assert "focal_error" in capsys.readouterr().err and not (tmp_path / "no").exists()
