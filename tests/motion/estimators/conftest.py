"""Differences of a drawn motion with known error, for the tests of the estimators."""

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.motion.estimators.differences import AngleDifferences

STEP = 1e-3  # s; grid of the drawn motions


def cholesky_of(prior, n):
    from scipy.linalg import toeplitz

    c = toeplitz(prior.autocovariance(STEP * np.arange(n)))
    return np.linalg.cholesky(c + 1e-10 * c[0, 0] * np.eye(n))


def measure(theta, lags_ms, sigma, rng, every=5, gap=None):
    """One AngleDifferences per lag (ms) of a motion (n, 3) on the grid; `gap` = (from, to) in s has none."""
    n = len(theta)
    pairs = []
    for number, lag in enumerate(lags_ms):
        i = np.arange(0, n - lag, every)
        if gap is not None:
            i = i[(i * STEP < gap[0]) | (i * STEP > gap[1])]
        values = theta[i + lag] - theta[i] + sigma * rng.standard_normal((len(i), 3))
        covariance = np.tile(max(sigma, 1e-9) ** 2 * np.eye(3), (len(i), 1, 1))
        pairs.append(
            AngleDifferences(i * STEP, np.full(len(i), lag * STEP), values, covariance, (0, number + 1))
        )
    return pairs


def sigmas(motion):
    return np.sqrt(np.einsum("nii->ni", motion.covariance))


def centred(x):
    return x - x.mean(axis=0)


@pytest.fixture(scope="session")
def series():
    """The functions of this file, and the scene of docs/theory/s1.md, section 5, in px, as attributes."""
    scene = Spectrum(
        (
            Matern(2.0, 1.0, "5/2"),
            Matern(0.10, 1.0 / (2.0 * np.pi * 30.0), "3/2"),
            Tone(0.30, 47.0, 0.1),
            Tone(0.15, 83.0, 0.1),
            Tone(0.08, 121.0, 0.1),
        )
    )
    return SimpleNamespace(
        step=STEP, scene=scene, cholesky_of=cholesky_of, measure=measure, sigmas=sigmas, centred=centred
    )
