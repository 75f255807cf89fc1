"""Parts of the links by features alone: fits that most of the points agree with."""

from __future__ import annotations

import numpy as np

from sightline.imaging.source import ArrayImage
from sightline.photogrammetry.flight.wide_links import _sharpness, fit_affine, fit_similarity


def test_an_affine_map_is_that_of_most_of_the_points():
    rng = np.random.default_rng(0)
    true = np.array([[30.0, -12.0], [0.9, 0.2], [-0.3, 1.1]])
    a = rng.uniform(0.0, 200.0, (60, 2))
    b = true[0] + a @ true[1:] + 0.05 * rng.standard_normal((60, 2))
    b[:15] += rng.uniform(20.0, 80.0, (15, 2))
    found = fit_affine(a, b)
    # three quarters of the points, 0.05 px each; the others, 45 px off, pull with a weight of 0.1 / 45
    assert np.abs(found[1:] - true[1:]).max() < 5e-3
    assert (
        np.abs(found[0] + 100.0 * found[1:].sum(axis=0) - true[0] - 100.0 * true[1:].sum(axis=0)).max() < 0.15
    )


def test_white_noise_is_eight_times_as_sharp_as_its_means_of_eight_pixels():
    pixels = 500.0 + 20.0 * np.random.default_rng(1).standard_normal((400, 640))
    sharpness, contrast = _sharpness(ArrayImage(pixels))
    # a pixel less half of two others: sqrt(1.5) of the noise; 4000 means of eight by eight tell theirs to 2 %
    assert abs(contrast / (np.sqrt(1.5) * 20.0 / 500.0) - 1.0) < 0.01
    assert abs(sharpness / 8.0 - 1.0) < 0.08


def test_a_similarity_is_found_whatever_its_turn():
    points, middle = np.random.default_rng(4).uniform(0.0, 400.0, (30, 2)), np.array([200.0, 150.0])
    turn, growth = 2.5, 1.3
    c, s = growth * np.cos(turn), growth * np.sin(turn)
    line, column = (points - middle).T
    moved = middle + np.array([7.0, -4.0]) + np.column_stack([c * line - s * column, s * line + c * column])
    assert np.allclose(fit_similarity(points, moved, middle), [7.0, -4.0, turn, growth - 1.0])
