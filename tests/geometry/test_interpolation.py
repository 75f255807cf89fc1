"""Local polynomials: exact for what they represent, checked by numpy's own polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose

from sightline.geometry.checks import read_only
from sightline.geometry.interpolation import interpolate, interpolate_hermite, stencils, unit_weights

NODES = read_only([0.0, 0.3, 1.1, 1.5, 2.7, 3.0])
PLACES = read_only(np.linspace(0.0, 3.0, 61))


def test_a_cubic_is_reproduced_on_uneven_nodes():
    cubic = Polynomial([1.0, -2.0, 0.5, 0.3])
    out = interpolate(NODES, read_only(cubic(NODES)[:, None]), PLACES)
    assert_allclose(out[:, 0], cubic(PLACES), atol=1e-13)


def test_a_polynomial_of_degree_seven_is_reproduced_with_slopes():
    seventh = Polynomial([1.0, -2.0, 0.5, 0.3, -0.1, 0.2, 0.05, -0.02])
    values, slopes = seventh(NODES)[:, None], seventh.deriv()(NODES)[:, None]
    out = interpolate_hermite(NODES, read_only(values), read_only(slopes), PLACES)
    assert_allclose(out[:, 0], seventh(PLACES), atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_nodes_give_the_polynomial_through_them(count):
    polynomial = Polynomial([1.0, 2.0, -3.0][:count])
    nodes = read_only(NODES[:count])
    places = read_only(np.linspace(nodes[0], nodes[-1], 7))
    out = interpolate(nodes, read_only(polynomial(nodes)[:, None]), places)
    assert_allclose(out[:, 0], polynomial(places), atol=1e-14)


def test_nodes_are_met_exactly():
    values = read_only(np.random.default_rng(0).normal(size=(6, 2)))
    assert_allclose(interpolate(NODES, values, NODES), values, atol=1e-15)


def test_the_stencil_surrounds_its_place_and_stays_inside():
    interval, first, weights = stencils(NODES, read_only([0.0, 1.2, 2.9, 3.0]))
    assert interval.tolist() == [0, 2, 4, 4]
    assert first.tolist() == [0, 1, 2, 2]
    assert_allclose(weights.sum(axis=1), 1.0)


def test_unit_weights_are_lagrange_weights_of_four_whole_numbers():
    for k in range(4):
        assert_allclose(unit_weights(float(k)), np.eye(4)[k], atol=1e-16)
    assert_allclose(unit_weights(1.5), [-1 / 16, 9 / 16, 9 / 16, -1 / 16])
