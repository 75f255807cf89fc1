"""The bound of the constant angles against S2's geometry worked out by hand, and a prototype's figures.

Own computation: S2's axes and angles, derivatives by complex steps, one dense matrix (`s2_dense`). Angles of
the package are minus S2's to first order about the same axes, which changes no sigma.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.photogrammetry import s2_dense
from tests.photogrammetry.s2_dense import ARCSEC, TRUTH, Case

from sightline.geometry.surface import Plane
from sightline.photogrammetry.block.bundle import bound
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.sightings import Sightings

#: prototype: roll, pitch, yaw of camera 1, arcsec.
PROTOTYPE = {
    "pair": ({"pairs": True}, (2.77, 3.35, 7.97)),
    "track": ({}, (1.91, 1.23, 5.17)),
    "pair, 10 m DEM": ({"pairs": True, "dem": 10.0}, (2.42, 1.02, 7.37)),
    "track, 10 m DEM": ({"dem": 10.0}, (1.91, 1.06, 5.17)),
    "track, 5 points of 1 m": ({"control": 5}, (0.43, 0.43, 5.05)),
}


def package(case, *, pairs=False, dem=None, control=0):
    """Principal directions by the package, in the same topocentric world."""
    t, d = s2_dense.positions(case)
    points = s2_dense.scene(case)
    images = 2 * case.shots
    image = np.repeat(np.arange(images), case.points)
    focal = 1.0 / case.pixel
    mount = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    sightings = Sightings(
        np.repeat([0, 1], case.shots),
        np.tile(np.arange(case.shots), 2),
        np.tile(t, 2),
        image,
        np.tile(np.arange(case.points), images),
        image,
        np.zeros((len(image), 2)),
        np.broadcast_to(focal * np.array([[0.0, 1.0], [1.0, 0.0]]), (len(image), 2, 2)),
        np.full(len(image), case.sigma_px),
        d.reshape(-1, 3),
        np.swapaxes(s2_dense.axes_of(d), 2, 3).reshape(-1, 3, 3),
        np.stack([mount, mount]),
    )
    heights = None if dem is None else HeightPrior(Plane(0.0), dem, None)
    known = ControlPoints(np.arange(control), points[:control], np.ones(control)) if control else None
    priors = PointPriors(heights, known) if heights or known else None
    noise = PoseNoise(case.sigma_position, case.sigma_attitude)
    angles, _ = bound(sightings, noise, points, priors=priors, new_points_per_shot=pairs)
    return angles


@pytest.mark.parametrize("name", PROTOTYPE)
def test_bound_is_that_of_a_dense_computation_and_of_the_prototype(name):
    given, prototype = PROTOTYPE[name]
    case = Case()
    found = np.sqrt(np.diag(package(case, **given).covariance())) / ARCSEC
    dense = np.sqrt(np.diag(s2_dense.bound(case, TRUTH, **given))) / ARCSEC
    np.testing.assert_allclose(found, dense, rtol=0.01)
    # the prototype's scene is another draw of 300 points and 8 waves: 5 % over ten draws
    np.testing.assert_allclose(found[:3], prototype, rtol=0.05)


@pytest.mark.parametrize("separation", [10.0, 100.0])
def test_bound_is_that_of_a_dense_computation_at_other_separations(separation):
    case = replace(Case(), separation=separation, shots=24, points=60)
    for pairs in (False, True):
        found = package(case, pairs=pairs).covariance()
        dense = s2_dense.bound(case, TRUTH, pairs=pairs)
        np.testing.assert_allclose(np.diag(found), np.diag(dense), rtol=0.02)


def test_one_shot_leaves_the_turn_about_the_baseline_and_nothing_else():
    case = replace(Case(), shots=1, relief=200.0)
    known = package(case)
    assert known.hidden.tolist() == [True] + [False] * 5
    _, d = s2_dense.positions(case)
    base = (d[0, 0] - d[1, 0]) / np.linalg.norm(d[0, 0] - d[1, 0])
    axis = np.concatenate([s2_dense.axes_of(d)[j, 0] @ base for j in range(2)]) / np.sqrt(2.0)
    assert abs(known.directions[0] @ axis) > 1.0 - 1e-6
    # the dense information: its lowest value is rounding, the five others are numbers
    dense = np.linalg.eigvalsh(s2_dense.information(case, TRUTH))
    np.testing.assert_allclose(known.sigmas[1:], dense[1:] ** -0.5, rtol=0.02)
    # prototype: two are weak, the field being small, by how much depends on the relief; the others not
    np.testing.assert_allclose(known.sigmas[3:] / ARCSEC, [16.0, 8.0, 3.0], rtol=0.1)


def test_the_weakest_direction_over_time_is_common_yaw():
    known = package(replace(Case(), window=32.0))
    common = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0]) / np.sqrt(2.0)
    assert abs(known.directions[0] @ common) > 0.98
    assert known.sigmas[0] / ARCSEC == pytest.approx(12.8, rel=0.05)
