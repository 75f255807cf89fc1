"""The page of a stereo orientation: drift, focal length, what one shot cannot tell, maps of heights."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.applications.stereo_orientation import orient
from sightline.io.results.stereo import summarize_orientation
from sightline.io.stereo.load import read_stereo
from sightline.report import stereo_words as words
from sightline.report.stereo_figures import image_noise, residual_figure, residual_vectors
from sightline.report.stereo_height_figure import height_figure, point_heights
from sightline.report.stereo_page import stereo_page
from sightline.simulate.stereo import stereo_case
from sightline.simulate.stereo_files import write_stereo

ARCSEC = np.pi / 648000.0


def oriented(folder, method="ml-track", *, control_points=0, drift=False, **options):
    write_stereo(
        stereo_case("A_paper_T6_K64", 4, points=50, **options), folder, control_points=control_points
    )
    stereo = read_stereo(folder / "stereo.toml")
    result = orient(stereo.problem, method, drift=drift)
    return stereo, result, summarize_orientation(stereo, result, wall_seconds=1.0)


@pytest.fixture(scope="module")
def refined(tmp_path_factory):
    """Errors that drift and lenses that are a thousandth too long, with control points that tell both."""
    return oriented(
        tmp_path_factory.mktemp("refined"), drift=True, control_points=8, shots=12,
        window=60.0, focal_error=1e-3,
    )  # fmt: skip


@pytest.fixture(scope="module")
def one_shot(tmp_path_factory):
    return oriented(tmp_path_factory.mktemp("one"), shots=1)


def test_drift_and_focal_length_are_said_with_their_sigmas(refined):
    stereo, result, summary = refined
    rates = words.drift_rows(result)
    assert [row[0] for row in rates] == ["1", "2"]
    value, _, sigma = rates[0][1].partition(" ± ")
    assert float(value) == pytest.approx(result.drift[0, 0] / ARCSEC, abs=float(sigma))
    assert float(sigma) == pytest.approx(result.drift_sigma[0, 0] / ARCSEC, rel=0.1)
    (_, length, longer, percent), _ = words.focal_rows(stereo.problem, result)
    value, sigma = (float(part) for part in percent.split(" ± "))
    assert value == pytest.approx(100.0 * result.stretch[0], abs=sigma) and 0.0 < sigma < 0.1
    given = stereo.problem.detectors[0].focal_length_px
    assert float(length.split()[0]) - given == pytest.approx(float(longer.split()[0]), abs=0.2)
    page = stereo_page(stereo, result, summary).html
    assert "roll (arcsec/s)" in page and "The errors drift (arcsec/s): camera 1 roll" in page
    assert f"Focal length: of camera 1 {percent} % from that of the file" in page


def test_a_focal_length_that_nothing_tells_is_called_so(refined):
    stereo, result, _ = refined
    object.__setattr__(result, "stretch_sigma", np.array([0.03, 1e-4]))
    rows = words.focal_rows(stereo.problem, result)
    assert rows[0] == ["1", *["not observable"] * 3] and "not observable" not in rows[1]


def test_frame_residuals_are_those_of_the_result(refined):
    stereo, result, _ = refined
    size = np.hypot(*residual_vectors(stereo.problem, result).T)
    # the projection is linearised in what the last step moved
    np.testing.assert_allclose(size, result.residual_px, atol=2e-3)


def test_one_shot_says_what_is_observable_and_advises_no_yaw(one_shot):
    stereo, result, summary = one_shot
    heights = point_heights(stereo, result)

    def said(known):
        angles = {
            camera: {f"sigma_{axis}": 0.01 if axis in known else np.inf for axis in ("roll", "pitch", "yaw")}
            for camera in "12"
        }
        return " ".join(words.sentences(stereo.problem, result, summary | {"angles": angles}, heights))

    assert "in 1 shot, 2 of the 6 constant attitude errors of cameras 1 and 2 were found: pitch of" in (
        said(["pitch"])
    )
    nothing = said([])
    assert "no constant attitude error of cameras 1 and 2 is observable by itself; 5 of their 6" in nothing
    assert "were found" not in nothing and "e+03" not in nothing
    # a single shot of 50 points leaves opposite pitch to about a degree
    assert "Known least of what is seen is pitch" in nothing and " deg;" in nothing
    assert not any("set by image noise" in line for line in words.advice(stereo.problem, summary))
    assert words.drift_rows(result) == [] and words.focal_rows(stereo.problem, result) == []


def test_sizes_are_in_degrees_where_arcsec_are_many():
    assert words.angle_words(12.345 * ARCSEC) == "12 arcsec"
    assert words.angle_words(3600.0 * ARCSEC) == "1 deg"


def test_points_known_poorly_are_crosses_and_in_no_mean(tmp_path):
    stereo, result, _ = oriented(tmp_path, shots=8)
    covariance = np.array(result.point_covariance)
    covariance[3] *= 100.0
    points = np.array(result.points)
    points[3] *= 1.0 + 1e-4  # 600 m up
    object.__setattr__(result, "point_covariance", covariance)
    object.__setattr__(result, "points", points)
    heights = point_heights(stereo, result)
    assert np.flatnonzero(~heights.good).tolist() == [3]
    change = np.delete(heights.after - heights.before, 3)
    assert heights.change == pytest.approx(change.mean())
    figure = height_figure(heights)
    panel = figure[1, 0]
    assert f"mean of {heights.change:+.3g} m" in panel.title
    discs, cross = panel.marks
    assert len(discs.x) == 49 and len(cross.x) == 1 and cross.symbol == "cross"
    assert np.mean(discs.values) == pytest.approx(0.0, abs=1e-6)
    assert discs.high <= np.abs(change - change.mean()).max()


@pytest.mark.parametrize(
    ("method", "title", "share"),
    [
        ("ml-track", "Residual of", 2.0),
        ("epipolar", "epipolar lines", 0.5),
        ("plane", "relief is in it", None),
    ],
)
def test_residuals_are_called_what_they_are(tmp_path, method, title, share):
    stereo, result, _ = oriented(tmp_path, method, shots=6)
    figure = residual_figure(stereo, result)
    assert title in figure[0].title
    noise = image_noise(stereo.problem, method)
    # case A states 0.1 px
    assert noise is None if share is None else noise == pytest.approx(0.1 * np.sqrt(share))
    assert any(mark.name == "as sigma_px says" for mark in figure.marks) == (share is not None)
    assert [text for _, text in figure[1].x.ticks] == list("012345")
