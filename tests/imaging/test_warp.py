"""Images laid on the grid of another, against patterns known in closed form."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.compiled import only_read
from sightline.geometry.interpolation import interpolate
from sightline.imaging.reduce import averaged
from sightline.imaging.source import ArrayImage
from sightline.imaging.warp import WarpedImage, _fill_uneven_weights, _flat_table, lattice_map

SHAPE = (90, 400)
# cycles per px, all within the 0.36 that the kernel promises to carry
WAVES = ((0.11, 0.23, 0.4), (-0.27, 0.09, 1.9), (0.05, -0.31, 2.2), (0.2, 0.02, 5.0))


def pattern(line, column):
    return sum(np.cos(2 * np.pi * (f * line + g * column) + p) for f, g, p in WAVES)


def whole_pattern(shape=SHAPE) -> np.ndarray:
    return pattern(*np.mgrid[0.0 : shape[0], 0.0 : shape[1]])


def linear(matrix, offset):
    def mapping(lines, columns):
        grid = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1)
        return grid @ np.asarray(matrix).T + offset

    return mapping


# The kernel keeps waves up to 0.36 cycles/px to 3 % in amplitude and 0.005 px in place
# (tests/imaging/test_resample) along each of two axes: 2 (0.03 + 2 pi 0.36 0.005) = 0.08 of each wave at
# worst; of the four together, whose worst places never coincide, half of the sum.
KERNEL = 0.5 * len(WAVES) * 0.08
NEARLY = [[1.0, 2e-4], [3e-3, 1.001]]
TURNED = [[0.98, 0.05], [-0.03, 0.96]]


@pytest.mark.parametrize("matrix", [NEARLY, TURNED], ids=["runs with the pixels", "turned and zoomed"])
def test_a_linear_map_reproduces_a_band_limited_pattern(matrix):
    offset = np.array([6.37, 8.81])
    laid = WarpedImage(ArrayImage(whole_pattern()), linear(matrix, offset), (60, 330))
    got = laid.read((5, 60), (10, 330))
    line, column = np.mgrid[5.0:60.0, 10.0:330.0]
    at = np.stack([line, column], axis=-1) @ np.array(matrix).T + offset
    want = pattern(at[..., 0], at[..., 1])
    inside = np.isfinite(got)
    assert inside.mean() > 0.9
    assert np.abs(got - want)[inside].max() < KERNEL
    # worst case apart, the bulk is far better: a tenth
    assert np.sqrt(np.mean((got - want)[inside] ** 2)) < KERNEL / 4
    assert want.std() > 1.0


def test_lines_that_stand_unevenly_are_interpolated_from_where_they_stand():
    # a platform that nods by 0.2 px six lines long, and turns: half as much at the last column
    k = np.arange(float(SHAPE[0]))
    nod = 0.2 * np.sin(2 * np.pi * 0.166 * k)
    places = k[:, None] + nod[:, None] * np.array([1.0, 0.5])
    share = np.arange(SHAPE[1]) / (SHAPE[1] - 1.0)
    column = np.broadcast_to(np.arange(float(SHAPE[1])), SHAPE)
    source = ArrayImage(pattern(places[:, :1] + share * np.diff(places), column))

    def mapping(lines, columns):
        # the line, by the cubic through the four nearest, that stands where line 12.3 + l of even ones would
        out = np.empty((len(lines), len(columns), 2))
        for m, c in enumerate(columns + 20.0):
            x = places @ np.array([1.0 - c / 399.0, c / 399.0])
            fine = np.linspace(0.0, SHAPE[0] - 1.0, 40 * SHAPE[0])
            out[:, m, 0] = np.interp(lines + 12.3, interpolate(k, x[:, None], fine)[:, 0], fine)
            out[:, m, 1] = c
        return out

    want = pattern(*np.meshgrid(np.arange(60.0) + 12.3, np.arange(330.0) + 20.0, indexing="ij"))
    known, even = (
        WarpedImage(source, mapping, (60, 330), places=given).read((0, 60), (0, 330)) - want
        for given in (places, None)
    )
    # lines up to a fifth farther apart carry waves as much shorter a fifth worse
    assert np.sqrt(np.mean(known**2)) < 1.2 * KERNEL / 4
    assert np.sqrt(np.mean(even**2)) > 2.0 * np.sqrt(np.mean(known**2))


def best_weights(x: np.ndarray, y: float) -> tuple[np.ndarray, float]:
    """Of sum 1, that carry waves up to 0.38 per line from places x to y; how many times they tell an error.

    Least squares over frequencies, of which the products are the integral of cos(2 pi f d), with the sum held
    by a multiplier. What is 16 lines apart or more is as like as what is.
    """
    apart = np.minimum(np.abs(np.subtract.outer(np.r_[x, y], x)), 16.0 - 1.0 / 1024.0)
    *normal, right = 0.76 * np.sinc(0.76 * apart)
    system = np.block([[np.array(normal), np.ones((len(x), 1))], [np.ones((1, len(x))), np.zeros((1, 1))]])
    best = np.linalg.solve(system, np.r_[right, 1.0])[:-1]
    return best, len(x) * np.linalg.norm(np.linalg.inv(normal), 2) * max(1.0, np.abs(best).max())


def place_between(x: np.ndarray, share: float) -> float:
    """What stands `share` of the way from the fourth to the fifth of eight places, by a cubic."""
    return float(np.polyval(np.polyfit([-1.0, 0.0, 1.0, 2.0], x[2:6], 3), share))


def test_weights_of_uneven_lines_are_the_best_of_sum_one_for_a_flat_spectrum_up_to_its_edge():
    rng, count = np.random.default_rng(4), 21  # more than are worked on side by side, and no multiple of them
    k = np.arange(60.0)[:, None]
    places = 3.0 + k * [1.02, 0.97] + rng.uniform(-0.35, 0.35, (60, 2))
    places[30:] += [5.0, 90.0]  # a gap, within what the table holds on one side and beyond it on the other
    rows = np.r_[rng.integers(3, 56, count - 3), 28, 29, 30]
    shares = np.r_[rng.uniform(0.0, 1.0, count - 3), 0.0, 0.01, 0.02]
    lines, got = rows + rng.uniform(-0.2, 1.2, count), np.empty((count, 8), np.float32)
    _fill_uneven_weights(*only_read(places, rows, lines, shares, _flat_table()), got)
    for row, line, share, found in zip(rows, lines, shares, got, strict=True):
        x = places[row - 3 : row + 5] @ [1.0 - share, share]
        best, told = best_weights(x, place_between(x, line - row))
        # the table is linear within 2e-7 between its entries; single precision
        assert told < 2e4
        assert_allclose(found, best, rtol=0.0, atol=2e-7 * told + 1e-6)
    assert_allclose(got.sum(axis=1), 1.0, rtol=0.0, atol=1e-5)
    # waves of all frequencies from -0.38 to 0.38 go together where they are, and less at lags of whole lines
    assert_allclose(_flat_table()[::1024], 0.76 * np.sinc(0.76 * np.arange(16)), rtol=0.0, atol=1e-12)


def test_lines_that_stand_in_one_place_share_its_weight():
    # a scan that stood still for one line
    places = np.repeat(np.r_[0.0:5.0, 4.0:11.0][:, None], 2, axis=1)
    x, got = places[1:9, 0], np.empty((1, 8), np.float32)
    given = only_read(places, np.array([4]), np.array([5.6]), np.zeros(1), _flat_table())
    _fill_uneven_weights(*given, got)
    best, told = best_weights(np.delete(x, 4), place_between(x, 1.6))
    # as above; what keeps the two apart is 1e-9 and tells 64-bit rounding as 1e-7
    assert_allclose(
        got[0], np.insert(best, 4, best[3]) * np.where(x == 4.0, 0.5, 1.0), atol=2e-7 * told + 1e-5
    )


def test_between_its_nodes_the_map_is_linear():
    # columns bent by 2e-5 (c - 165)^2 px: between nodes 64 columns apart the chord misses
    # the bend by 2e-5 * 32^2 at most
    bend = 2e-5

    def mapping(lines, columns):
        line, column = np.meshgrid(lines, columns, indexing="ij")
        return np.stack([line + 10.0, column + 8.0 + bend * (column - 165) ** 2], axis=-1)

    column_image = np.tile(np.arange(SHAPE[1], dtype=float), (SHAPE[0], 1))
    got = WarpedImage(ArrayImage(column_image), mapping, (60, 330)).read((0, 60), (0, 330))
    want = np.arange(330) + 8.0 + bend * (np.arange(330) - 165) ** 2
    chord = bend * 32**2
    # 0.005 px is what the kernel promises
    assert np.abs(got - want).max() < chord + 0.005
    assert np.abs(got - want).max() > chord / 2


def test_the_pieces_read_do_not_change_the_pixels_by_more_than_rounding():
    laid = WarpedImage(ArrayImage(whole_pattern()), linear(NEARLY, (6.37, 8.81)), (60, 330))
    whole = laid.read((0, 60), (0, 330))
    part = laid.read((20, 31), (65, 201))
    # other nodes: weights are carried linearly over other intervals; over 64 columns they bend by
    # (0.001 * 64 px)^2 / 8 of their curvature, about (2 pi 0.36)^2
    assert_allclose(part, whole[20:31, 65:201], atol=len(WAVES) * (0.064 * 2.3) ** 2 / 8)


class TestUnusable:
    def test_a_masked_pixel_spreads_to_every_pixel_whose_kernel_meets_it_and_little_further(self):
        mask = np.zeros(SHAPE, bool)
        mask[40, 150] = True
        offset = np.array([6.5, 8.5])
        laid = WarpedImage(ArrayImage(whole_pattern(), mask), linear(np.eye(2), offset), (60, 330))
        got = laid.read((0, 60), (0, 330))
        line, column = np.nonzero(np.isnan(got))
        # pixel p is read from p + 6.5 with taps 3 below to 4 above its floor: 40 is met from 33.5 - 4 to
        # 33.5 + 3
        both = self.reads(40 - 6, 60)[:, None] & self.reads(150 - 8, 330)[None, :]
        met = set(zip(*np.nonzero(both), strict=True))
        found = set(zip(line.tolist(), column.tolist(), strict=True))
        assert len(met) == 64 and met <= found
        # and one pixel of caution around them at the most
        assert len(found) <= 10 * 10

    @staticmethod
    def reads(floor: int, count: int) -> np.ndarray:
        """Which of the pixels p use tap `floor` when they read taps p - 3 .. p + 4."""
        p = np.arange(count)
        return (p - 3 <= floor) & (floor <= p + 4)

    def test_what_is_not_finite_is_unusable_without_a_mask(self):
        image = whole_pattern()
        image[40, 150] = np.nan
        marked = np.isnan(image)
        laid = WarpedImage(ArrayImage(image), linear(NEARLY, (6.37, 8.81)), (60, 330))
        same = WarpedImage(ArrayImage(whole_pattern(), marked), linear(NEARLY, (6.37, 8.81)), (60, 330))
        got, want = laid.read((0, 60), (0, 330)), same.read((0, 60), (0, 330))
        assert np.isnan(want).any()
        assert_allclose(np.isnan(got), np.isnan(want))
        assert laid.mask((0, 60), (0, 330)) is None

    def test_pixels_that_would_read_beyond_the_source_are_absent(self):
        laid = WarpedImage(ArrayImage(whole_pattern()), linear(np.eye(2), (-20.0, 300.0)), SHAPE)
        got = laid.read((0, 90), (0, 400))
        # lines 20 + 3 and later lie inside; columns up to 400 - 5 - 300 at best, in whole intervals of the
        # map at worst
        assert np.isnan(got[:23]).all() and np.isnan(got[:, 96:]).all()
        assert np.isfinite(got[24:, :64]).all()

    def test_an_interval_with_an_unknown_end_is_absent_and_others_are_not(self):
        def mapping(lines, columns):
            at = linear(np.eye(2), (8.0, 8.0))(lines, columns)
            at[:, columns >= 256] = np.nan
            return at

        got = WarpedImage(ArrayImage(whole_pattern()), mapping, (60, 330)).read((0, 60), (0, 330))
        # column 192 is a node itself, and known
        assert np.isnan(got[:, 193:]).all() and np.isfinite(got[:, :192]).all()

    def test_a_map_that_leads_nowhere_gives_nothing(self):
        def nowhere(lines, columns):
            return np.full((len(lines), len(columns), 2), np.nan)

        def far(lines, columns):
            return linear(np.eye(2), (5000.0, 0.0))(lines, columns)

        for mapping in (nowhere, far):
            got = WarpedImage(ArrayImage(whole_pattern()), mapping, (60, 330)).read((0, 20), (0, 50))
            assert got.shape == (20, 50) and np.isnan(got).all()


def test_a_sheared_map_puts_every_window_where_it_says():
    # lines run 0.01 px per column: half a column of delay in the line would move the image by 0.005 px
    matrix = [[1.0, 0.01], [0.0, 1.0]]
    ramp = np.repeat(np.sin(0.9 * np.arange(90.0))[:, None], 400, axis=1)
    for fraction in (0.1, 0.5, 0.9):
        laid = WarpedImage(
            ArrayImage(ramp), linear(matrix, np.array([8.0, 10.0 + fraction])), (60, 330), spacing=8
        )
        got = laid.read((10, 50), (20, 300))
        line, column = np.mgrid[10.0:50.0, 20.0:300.0]
        phase = 0.9 * (line + 0.01 * column + 8.0)
        # shift of the phase by least squares: sin(p + 0.9 d) = sin p + 0.9 d cos p
        shift = np.sum((got - np.sin(phase)) * np.cos(phase)) / np.sum(0.9 * np.cos(phase) ** 2)
        assert abs(shift) < 0.001


@pytest.mark.parametrize("ratio", [1.5, 2.3, 4.0])
def test_parts_of_a_coarse_pixel_average_the_image_as_the_pixel_does(ratio):
    # pixels `ratio` wide over a pattern that they can carry: the mean over a pixel turns each wave down by
    # sinc(ratio f); p parts, no more than a pixel apart, do so but for sinc(ratio f / p) of their own
    parts = (int(np.ceil(ratio)), int(np.ceil(ratio)))
    waves = [(0.3 * f / ratio, 0.3 * g / ratio, p) for f, g, p in ((1.0, 0.7, 0.4), (-0.5, 1.0, 1.9))]

    def shown(line, column, share=lambda f: 1.0):
        return sum(share(f) * share(g) * np.cos(2 * np.pi * (f * line + g * column) + p) for f, g, p in waves)

    fine = ArrayImage(shown(*np.mgrid[0.0:120.0, 0.0:300.0]))
    shape = (int(100 / ratio), int(270 / ratio))
    mapping = linear(ratio * np.eye(2), np.array([10.0, 12.0]))
    coarse = averaged(partial(WarpedImage, fine), mapping, shape, parts)
    got = coarse.read((2, shape[0] - 2), (2, shape[1] - 2))
    at = np.stack(np.mgrid[2.0 : shape[0] - 2, 2.0 : shape[1] - 2], axis=-1) * ratio + [10.0, 12.0]
    want = shown(at[..., 0], at[..., 1], lambda f: np.sinc(ratio * f))
    # 1 / sinc(0.3 / parts) - 1 is at most 0.04 for two parts, along each axis; half a wave each on average
    assert np.sqrt(np.mean((got - want) ** 2)) < 0.06 * want.std()
    assert np.corrcoef(got.ravel(), want.ravel())[0, 1] > 0.999


@pytest.mark.parametrize("gap", [4.0, 15.0, 40.0, 3000.0])
def test_lines_beyond_a_gap_leave_those_before_it_as_they_are(gap):
    lines, columns = np.arange(40.0), 64
    pixels = np.sin(0.5 * lines)[:, None] + np.zeros((1, columns))
    places = np.repeat(lines[:, None] + gap * (lines >= 20.0)[:, None], 2, axis=1)

    def moved(rows, at):
        return np.stack(np.meshgrid(rows + 0.25, at, indexing="ij"), axis=-1)

    image = WarpedImage(ArrayImage(pixels.astype(np.float32)), moved, (40, columns), 16, places)
    seen = image.read((4, 36), (8, 56))
    assert np.isfinite(seen).all() and np.abs(seen).max() < 3.0
    # three lines or more before the gap and behind it
    expected = np.sin(0.5 * (np.arange(4, 36) + 0.25))[:, None]
    far = np.r_[0:12, 20:32]
    assert_allclose(seen[far], np.broadcast_to(expected[far], seen[far].shape), atol=0.01)


@pytest.mark.parametrize("kink", [0.0, 0.2])
def test_a_smooth_map_is_evaluated_at_few_columns_and_a_bent_one_at_all(kink):
    asked = []

    def exact(lines, columns):
        places = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1)
        # lines that move and turn one by one, columns of a detector that is slightly bent
        places[..., 0] += 3.0 + 0.3 * np.sin(0.7 * lines)[:, None] + 1e-8 * columns**2
        places[..., 1] += 0.1 * np.cos(0.9 * lines)[:, None] * (1.0 + 1e-4 * columns) + 1e-11 * columns**3
        places[..., 1] += kink * np.maximum(columns - 1100.0, 0.0) / 1000.0
        return places

    def mapping(lines, columns):
        asked.append(len(lines) * len(columns))
        return exact(lines, columns)

    source = ArrayImage(np.zeros((8, 2100), np.float32))
    nodes, found = WarpedImage(source, mapping, (400, 2048))._positions((0, 400), (0, 2048))
    # cubics are held to 1e-5 px where they are looked at; between those lines it moves and turns alike
    assert_allclose(found, exact(np.arange(400.0), nodes.astype(float)), atol=1.5e-5, rtol=0.0)
    # every fourth column, and what shows that these are enough
    assert (sum(asked) < 0.5 * found[..., 0].size) == (kink == 0.0)


def test_a_map_with_a_corner_is_followed_about_a_rough_column():
    """A tooth of 0.4 px, 6 columns to either side of column 200: columns 64 apart would not see it."""

    def mapping(lines, columns):
        grid = np.stack(np.meshgrid(lines, columns, indexing="ij"), axis=-1)
        grid[..., 0] += 0.4 * np.clip(1.0 - np.abs(columns - 200.0) / 6.0, 0.0, 1.0)
        return grid

    warped = WarpedImage(ArrayImage(whole_pattern()), mapping, SHAPE, rough=(200.0,))
    line, column = np.mgrid[20.0:30.0, 150.0:250.0]
    place = mapping(np.arange(20.0, 30.0), np.arange(150.0, 250.0))
    assert np.abs(warped.read((20, 30), (150, 250)) - pattern(place[..., 0], column)).max() < KERNEL
    assert np.abs(pattern(line, column) - pattern(place[..., 0], column)).max() > 2.0 * KERNEL


def test_a_map_from_its_lattice_is_exact_for_cubics_and_asks_for_few_places():
    asked = []

    def cubic(line, column):
        return np.stack([
            5.0 + line - 0.2 * column + 1e-3 * line * column + 1e-5 * (line**3 - 2.0 * line * column**2),
            -7.0 + 0.3 * line + 1.1 * column - 2e-3 * line**2 + 1e-5 * (column**3 + 3.0 * line**2 * column),
        ], axis=-1)  # fmt: skip

    def exact(grid):
        asked.append(len(grid))
        return cubic(*grid.T)

    lines, columns = np.arange(3.0, 44.0), np.array([10.0, 10.5, 47.0, 60.25])
    found = lattice_map(exact)(lines, columns)
    # places up to 100 px, float64
    assert_allclose(found, cubic(*np.meshgrid(lines, columns, indexing="ij")), rtol=0.0, atol=1e-11)
    # 8 px apart, and one more beyond each end: 8 by 10
    assert asked == [80]
