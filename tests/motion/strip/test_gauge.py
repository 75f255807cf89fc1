"""How far constants and even rates may be from the reference attitude, given or not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.estimation.prior import Matern, Spectrum
from sightline.motion.strip.estimate import gauge
from sightline.motion.strip.hyper import KnownContent, PriorModel
from sightline.motion.strip.normal_equations import TimeGrid

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
