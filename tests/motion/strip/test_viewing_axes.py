"""Angles about the line of sight turned back into body axes: covariances and directions by dense algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from motion.strips import plain_star
from sightline.estimation.prior import Matern, Spectrum, Tone
from sightline.motion.strip.normal_equations import TimeGrid, modelled
from sightline.motion.strip.viewing_axes import (
    turned_amplitudes,
    turned_band,
    turned_directions,
    turned_spectra,
    turned_star,
)

TURN = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
RNG = np.random.default_rng(0)


def test_a_banded_covariance_turns_block_by_block():
    nodes, width = 9, 4
    root = RNG.normal(size=(3 * nodes, 3 * nodes))
    dense = root @ root.T
    band = np.zeros((3 * width, 3 * nodes))
    for d in range(len(band)):
        band[d, : 3 * nodes - d] = np.diag(dense, -d)
    whole = np.kron(np.eye(nodes), TURN)
    expected = whole @ dense @ whole.T
    turned = turned_band(band, TURN)
    for row in range(3 * nodes):
        for column in range(row + 1):
            if row // 3 - column // 3 < width:
                assert_allclose(turned[row - column, column], expected[row, column], rtol=1e-10)


def test_a_turned_star_reads_of_the_turned_motion_what_it_read():
    star = plain_star(20, 2, 2)
    uneven = RNG.normal(size=(*star.t.shape, 2, 2, 3, 3)).astype(np.float32)
    star = replace(star, uneven=1e5 * uneven, uneven_at=1e-3 * np.arange(-1.0, 2.0))
    grid = TimeGrid(0.0, 1e-3, 400)
    nodes = 1e-5 * RNG.normal(size=(400, 3))
    expected = modelled(star, grid, nodes, np.zeros(0))
    # sensitivities are float32
    found = modelled(turned_star(star, TURN), grid, nodes @ TURN.T, np.zeros(0))
    assert_allclose(found, expected, atol=1e-5)


def test_hidden_directions_are_again_one_per_axis():
    """Of constants alone the turned ones are the body's constants, in the order of its axes."""
    constants = np.broadcast_to(np.eye(3), (5, 3, 3))
    turned = turned_directions(np.concatenate([constants, 2 * constants], axis=2), TURN)
    assert_allclose(turned[:, :, :3], constants, atol=1e-14)
    assert_allclose(turned[:, :, 3:], 2 * constants, atol=1e-14)


def test_as_much_of_turned_directions_is_the_same_motion_turned():
    """Three constants, three drifts and one of another kind: random amounts, the motion given both ways."""
    rng = np.random.default_rng(2)
    directions, root = rng.normal(size=(6, 3, 7)), rng.normal(size=(7, 7))
    turned = turned_directions(directions, TURN).reshape(18, 7)
    whole = np.einsum("pa,nah->nph", TURN, directions).reshape(18, 7)
    covariance = root @ root.T
    assert_allclose(
        turned @ turned_amplitudes(covariance, TURN) @ turned.T, whole @ covariance @ whole.T, atol=1e-12
    )


def test_spectra_add_by_the_squares_of_the_turn():
    spectra = tuple(Spectrum((Matern(s, 0.3, "5/2"), Tone(s, 40.0 + s, 1.0))) for s in (1.0, 2.0, 3.0))
    frequency = np.array([0.5, 3.0, 41.0, 60.0])
    each = np.stack([s.psd(frequency) for s in spectra])
    turned = turned_spectra(spectra, TURN)
    assert_allclose(np.stack([s.psd(frequency) for s in turned]), TURN**2 @ each, rtol=1e-9)
    same = turned_spectra(spectra, np.eye(3))
    assert [len(s.components) for s in same] == [2, 2, 2]
