"""How often a map is evaluated: as its bend asks, shared by lines where relief asks for more."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.products.image_map import AT_ENDS, COARSE, MAP_TOLERANCE, sample_map

LINES, COLUMNS = (40, 104), (0, 1000)


class Counted:
    """A map that counts the places it is asked for."""

    def __init__(self, bend):
        self.bend, self.places = bend, 0

    def __call__(self, lines, columns):
        self.places += len(lines) * len(columns)
        line, column = np.meshgrid(lines, columns, indexing="ij")
        # jumps from line to line, as motion does
        jump = np.random.default_rng(0).uniform(-1.0, 1.0, 2000)[lines.astype(int)][:, None]
        return np.stack([line + jump + self.bend(line, column), column + 0.5 * jump], axis=-1)


def deviation(mapping, sampled):
    """Largest error of the samples, linear between their columns, at every pixel."""
    rows, j = np.arange(*LINES, dtype=float), np.arange(*COLUMNS, dtype=float)
    exact = mapping(rows, j)
    found = np.stack(
        [[np.interp(j, sampled.nodes, row[:, k]) for k in (0, 1)] for row in sampled.position]
    ).transpose(0, 2, 1)
    return np.abs(found - exact).max()


# halfway between columns q apart the parabola is off by strength (q / 2000)^2
@pytest.mark.parametrize(("strength", "spacing"), [(0.01, 256), (0.2, 128), (0.9, 64)])
def test_columns_are_as_close_as_the_bend_asks(strength, spacing):
    sampled = sample_map(Counted(lambda line, column: strength * (column / 1000.0) ** 2), LINES, COLUMNS)
    assert sampled.nodes[0] == COLUMNS[0] and sampled.nodes[-1] == COLUMNS[1]
    assert np.diff(sampled.nodes)[0] == spacing
    assert sampled.error == pytest.approx(strength * (spacing / 2000.0) ** 2, rel=0.01)
    assert sampled.error <= MAP_TOLERANCE


@pytest.mark.parametrize(("wave", "spacing"), [(200.0, 16), (130.0, 8)])
def test_relief_is_followed_between_lines_too(wave, spacing):
    """Waves of 0.05 px; halfway between places q apart they are off by 0.05 (pi q / wave)^2 / 2, and about as
    much again halfway between lines."""
    mapping = Counted(lambda line, column: 0.05 * np.sin(2 * np.pi * (column + 0.7 * line) / wave))
    sampled = sample_map(mapping, LINES, COLUMNS)
    assert np.diff(sampled.nodes)[0] <= spacing < COARSE
    used = mapping.places
    # the check sees a few lines; elsewhere the deviation may be a little larger
    assert deviation(mapping, sampled) < 1.5 * MAP_TOLERANCE
    # every line at every place would take so many
    assert used < 0.8 * len(sampled.nodes) * (LINES[1] - LINES[0])


def test_where_a_map_ends_little_is_lost():
    def mapping(lines, columns):
        out = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1)
        out[:, columns > 700.0] = np.nan
        return out

    sampled = sample_map(mapping, LINES, COLUMNS)
    known = sampled.nodes[np.isfinite(sampled.position).all(axis=(0, 2))]
    assert known[-1] > 700 - AT_ENDS


def test_a_map_that_knows_nothing_has_no_places():
    sampled = sample_map(
        lambda lines, columns: np.full((len(lines), len(columns), 2), np.nan), LINES, COLUMNS
    )
    assert np.isnan(sampled.position).all()
