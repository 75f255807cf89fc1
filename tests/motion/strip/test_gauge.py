"""How far constants and even rates may be from the reference attitude, given or not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.estimation.prior import Matern, Spectrum
from sightline.evaluation.score import score_result
from sightline.geometry.surface import Plane
from sightline.motion.statics import ALONG
from sightline.motion.strip.estimate import gauge
from sightline.motion.strip.hyper import KnownContent, PriorModel
from sightline.motion.strip.normal_equations import TimeGrid
from sightline.motion.strip.strip import RecoverOptions, prepared
from sightline.simulate.scenarios import line_of_sight_case

GRID = TimeGrid(0.0, 0.01, 201)


def of_yaw(sigma: float, **given: float) -> tuple[float, float]:
    """Sigma of the constant, and of the even rate (rad/s), of yaw that drifts by `sigma` rad over 2 s."""
    drift = Spectrum((Matern(sigma, 2.0, "5/2"), Matern(1e-3 * sigma, 0.02)))
    strip = SimpleNamespace(grid=GRID, known=KnownContent(**given))
    constant, even = gauge(strip, PriorModel((drift, drift, drift)).processes(GRID))  # type: ignore[arg-type]
    assert constant[:2] == even[:2] == (1e-5, 1e-5)
    said = gauge(strip, PriorModel((drift, drift, drift)).processes(GRID), held=False)  # type: ignore[arg-type]
    usual = KnownContent(**given).usual()
    assert said == ((usual[0], usual[0], constant[2]), (usual[1] * 1.0, usual[1] * 1.0, even[2]))
    return constant[2], even[2] / 1.0


def test_what_is_not_given_of_yaw_is_as_large_as_its_motion() -> None:
    # by the covariance's formula, at the ends and the middle of the grid
    lag = np.sqrt(5.0) * np.abs(np.subtract.outer(GRID.nodes, GRID.nodes)) / 2.0
    covariance = 0.2**2 * (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)
    u = GRID.nodes - 1.0
    mean, even = np.full(201, 1.0 / 201), u / (u @ u)
    expected = np.sqrt([mean @ covariance @ mean, even @ covariance @ even])
    # an autoregression of 80 nodes holds less than half of the strip: of slow drifts it keeps some per cent
    np.testing.assert_allclose(of_yaw(0.2), expected, rtol=0.1)
    assert of_yaw(1e-5) == (1e-2, pytest.approx(1e-3))


def test_what_is_given_stays() -> None:
    assert of_yaw(0.2, attitude_sigma=2e-3, rate_sigma=3e-5) == (2e-3, pytest.approx(3e-5))


def test_what_orbits_and_the_earth_add_is_no_statement_of_the_attitude() -> None:
    given = KnownContent(attitude_added=3e-3).usual()
    assert given == (pytest.approx(np.hypot(1e-2, 3e-3)), 1e-3)
    assert of_yaw(0.2, attitude_added=3e-3) == of_yaw(0.2)
    assert of_yaw(0.2, attitude_sigma=4e-3, attitude_added=3e-3)[0] == pytest.approx(5e-3)


@pytest.mark.parametrize(("seed", "axis"), [(1, "roll"), (2, "pitch")])
def test_offsets_that_are_less_well_known_make_no_motion_worse(seed: int, axis: str) -> None:
    # bands that all look further along, and a roll with as much more of the yaw, are the same to every image
    bands: dict[str, Any] = {"names": ("A", "B", "C"), "lags": (0.0, 0.02, 0.027), "gains": (1.0,) * 3}
    scene = line_of_sight_case("nominal", seed, lines=400, columns=110, gammas=(1.0,) * 3, **bands)
    scores, results = [], []
    for sigma in (1.0, 20.0):
        given = [replace(band, offset_sigma_px=sigma) for band in scene.as_given()]
        results.append(recover_line_of_sight(given, Plane(0.0)))
        scores.append(score_result(results[-1], scene.truth[:, 0], scene.truth[:, 1:]).axes[axis])
    near, far = scores
    # what was given of all bands together stays, and so does its sigma: 1 / sqrt(3) of one band's
    along = [one for one in results[1].statics if one.name.endswith(ALONG)]
    assert abs(sum(one.value for one in along)) < 1e-6
    assert [one.sigma for one in along] == pytest.approx([20.0 / 3.0**0.5] * 3, rel=0.01)
    # offsets were drawn of 1 px: the error stays some three times below the larger sigma. Told by how little
    # roll and yaw resemble each other, it was .11 px at a sigma of .06 (seed 1), .09 at .04 (pitch of seed 2)
    assert far.sigma > 2.0 * near.sigma
    assert far.nees < 1.0
    assert far.rms < 3.0 * near.rms


def test_of_offsets_that_one_band_has_not_none_is_common() -> None:
    scene = line_of_sight_case("nominal", 1, lines=200, columns=110)
    bands = scene.as_given()
    whole = prepared(bands, Plane(0.0), RecoverOptions()).common_offsets
    assert whole is not None and whole.sum(axis=0).tolist() == pytest.approx([len(bands)] * 2)
    exact = [replace(bands[0], offset_sigma_px=0.0), *bands[1:]]
    assert prepared(exact, Plane(0.0), RecoverOptions()).common_offsets is None
