"""Lost references W and S are found; flights across Greenwich, the equator or 180 degrees are whole."""

import numpy as np
import pytest
from tests.io.sequence_files import flight

from sightline.io.formats.gps_places import mirrored, places
from sightline.io.sequence.load import load_sequence


def wrap(degrees):
    return (degrees + 180.0) % 360.0 - 180.0


@pytest.mark.parametrize(
    "degrees",
    [
        wrap(np.linspace(179.99, 180.01, 60)),  # a small flight across 180 degrees
        wrap(np.linspace(170.0, 200.0, 60)),
        np.linspace(-1.5, 3.5, 51),  # a station in orbit across Greenwich
        np.linspace(-0.1, 10.0, 51),
        np.linspace(-51.0, 51.0, 300),
        np.linspace(-1e-3, 2e-3, 40),
        np.repeat([-0.2, 0.1, 0.4], 20),  # lines of a survey
        np.array([12.0]),
        np.array([-1.0, 1.0]),  # neither can be believed more
    ],
)
def test_flights_across_are_whole(degrees):
    t = np.arange(len(degrees), dtype=float)
    assert not mirrored(t, degrees).any()
    assert not mirrored(t, -degrees).any()
    assert not mirrored(np.full(len(t), np.nan), degrees).any()


@pytest.mark.parametrize("middle", [0.14, 1.0, -46.8, 92.0, -179.0])
@pytest.mark.parametrize("extent", [0.0, 0.02])
def test_lost_references_are_found(middle, extent):
    degrees = middle + np.linspace(-extent, extent, 40)
    lost = np.array([3, 4, 20, 39])
    degrees[lost] *= -1.0
    assert np.flatnonzero(mirrored(np.arange(40.0), degrees)).tolist() == lost.tolist()


def test_a_wild_value_hides_no_lost_reference():
    degrees = np.full(30, 11.0)
    degrees[5], degrees[9] = -11.0, 70.0
    assert np.flatnonzero(mirrored(np.arange(30.0), degrees)).tolist() == [5]


def test_the_others_are_reported_beside_180_degrees():
    lonlat = np.column_stack([wrap(np.linspace(179.99, 180.03, 9)), np.full(9, -17.0)])
    lonlat[4, 1] = 17.0
    warnings = []
    assert np.flatnonzero(~places(np.arange(9.0), lonlat, "abcdefghi", "t.csv", warnings)).tolist() == [4]
    assert "frame e at longitude -179.99, latitude 17, the others at -179.99, -17" in warnings[0]


def test_a_table_across_180_degrees_loses_no_row(tmp_path):
    made = flight(60)
    made.toml = made.toml.replace('"local"', '"lonlat"').replace('attitudes = "attitudes.csv"\n', "")
    for k, row in enumerate(made.positions):
        row[2:5] = [float(wrap(179.999 + 5e-5 * k)), -17.0, 100.0]
    problem = load_sequence(made.write(tmp_path))
    assert np.isfinite(problem.known.position).all()
    assert not any("hemisphere" in words for words in problem.warnings)
    steps = np.linalg.norm(np.diff(problem.images.position, axis=0), axis=1)
    # 5e-5 degrees at latitude 17 of a sphere of 6378.1 km; the ellipsoid's parallel is .03 % longer
    np.testing.assert_allclose(steps, 5e-5 * 111319.5 * np.cos(np.radians(17.0)), rtol=1e-3)
