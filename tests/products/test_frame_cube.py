"""A map filled from frames over sloping ground, each pixel by the formula of a pinhole written out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.geometry.instrument import AreaDetector
from sightline.imaging.source import ArrayImage
from sightline.products.cube_bands import camera_bands, frame_bands, line_bands
from sightline.products.cube_grid import CubeGrid, MapSystem
from sightline.products.cube_plan import CubePlan, choose_bands, pixel_size
from sightline.products.cube_tally import CubeTally, picture_factor, picture_grid
from sightline.products.frame_cube import (
    CubeMaker,
    FilledTile,
    FrameViews,
    MapTile,
    covering_grid,
    map_outlines,
    tiles_of,
)

LINES, COLUMNS, FOCAL, PRINCIPAL = 60, 80, 100.0, (28.0, 41.0)
#: m; where frames are taken, on the way north.
PLACES = np.array([[3.0, 10.0 + 6.0 * k, 50.0] for k in range(5)])
#: Two steps of a filter, and how bright the detector makes each line.
LAYOUT = line_bands(np.repeat([500.0, 600.0], [36, 24]))
GAIN = 1.0 + 0.3 * np.sin(0.2 * np.arange(LINES))


def height(x, y):
    return 2.0 + 0.04 * x - 0.02 * y


def bright(x, y):
    return 100.0 + 20.0 * np.sin(0.5 * x) * np.cos(0.4 * y)


def seen(place):
    """What a level frame sees of the ground, lines down to the south: rays meet the slope."""
    line, column = np.mgrid[0.0:LINES, 0.0:COLUMNS]
    right, down = (column - PRINCIPAL[1]) / FOCAL, (line - PRINCIPAL[0]) / FOCAL
    # place + s (right, -down, -1) on z = height
    s = (place[2] - height(*place[:2])) / (1.0 + 0.04 * right + 0.02 * down)
    return bright(place[0] + s * right, place[1] - s * down)


def pixel_of(point, place):
    depth = place[2] - point[..., 2]
    line = PRINCIPAL[0] - FOCAL * (point[..., 1] - place[1]) / depth
    return line, PRINCIPAL[1] + FOCAL * (point[..., 0] - place[0]) / depth


class Damaged(ArrayImage):
    """A frame whose pixels cannot be had."""

    def read(self, lines, columns):
        raise InputError("damaged")


@pytest.fixture(scope="module")
def views():
    down = np.tile(np.diag([1.0, -1.0, -1.0]), (len(PLACES), 1, 1, 1))
    penalty = np.array([0.0, 0.0, 0.3, 0.0, np.inf])
    detector = AreaDetector("frame", (LINES, COLUMNS), FOCAL, PRINCIPAL)
    return FrameViews(detector, PLACES[:, None], down, np.zeros(len(PLACES), int), penalty)


@pytest.fixture(scope="module")
def outline(views):
    def ground(origin, direction):
        slope = np.array([0.04, -0.02, -1.0])
        s = -(origin @ slope + 2.0) / (direction @ slope)
        return origin + s[:, None] * direction

    return map_outlines(views, ground)


def maker_of(views, outline, spoilt=()):
    grid = covering_grid(outline.reshape(-1, 2), MapSystem(), 0.5)
    frames = [seen(place) * GAIN[:, None] for place in PLACES]
    sources = [(Damaged if k in spoilt else ArrayImage)(f.astype(np.float32)) for k, f in enumerate(frames)]
    return CubeMaker(grid, LAYOUT, views, outline, height, [sources], GAIN[None])


def best_by_hand(maker, tile, frames):
    """World points (rows, columns, 3) and the frame (2, rows, columns) that shows each best; -1: none."""
    rows, columns = (
        np.arange(tile.row, tile.row + tile.rows),
        np.arange(tile.column, tile.column + tile.columns),
    )
    x, y = np.meshgrid(maker.grid.west + 0.5 * (columns + 0.5), maker.grid.north - 0.5 * (rows + 0.5))
    world = np.stack([x, y, height(x, y)], axis=-1)
    least, best, clear = np.full((2, *x.shape), 1e9), np.full((2, *x.shape), -1), np.full(x.shape, True)
    for frame in frames:
        line, column = pixel_of(world, PLACES[frame])
        # pixels lie on all sides of it
        there = (line >= 0.0) & (line <= LINES - 1.0) & (column >= 0.0) & (column <= COLUMNS - 1.0)
        for group, (first, last) in enumerate(((0, 35), (36, 59))):
            middle, half = 0.5 * (first + last), 0.5 * (last - first + 1)
            cost = ((line - middle) / half) ** 2 + ((column - 39.5) / 40.0) ** 2
            cost = cost + maker.views.penalty[frame]
            cost[~there | (line < first - 0.5) | (line > last + 0.5)] = 2e9
            clear &= np.abs(cost - least[group]) > 1e-6
            best[group][cost < least[group]] = frame
            least[group] = np.minimum(cost, least[group])
        for edge in (0.0, 35.5, 59.0):
            clear &= np.abs(line - edge) > 1e-6
    return world, best, clear


@pytest.mark.parametrize("spoilt", [(), (1,)], ids=["all frames", "one unreadable"])
def test_every_place_has_its_brightness_from_the_frame_that_shows_it_best(views, outline, spoilt):
    maker = maker_of(views, outline, spoilt)
    rows, columns = maker.grid.shape
    tiles = [MapTile(0, 0, 40, 50), MapTile(40, 0, rows - 40, 50), MapTile(0, 50, rows, columns - 50)]
    filled = maker.fill(tiles)
    assert set(maker.unread) == set(spoilt)
    own = [GAIN[:36].mean(), GAIN[36:].mean()]
    shown, errors = set(), []
    for tile, one in zip(tiles, filled, strict=True):
        world, best, clear = best_by_hand(maker, tile, [k for k in range(4) if k not in spoilt])
        np.testing.assert_allclose(maker.world(tile), world, atol=1e-9)
        np.testing.assert_array_equal(one.view[:, clear], best[:, clear])
        assert clear.mean() > 0.99
        there = one.view >= 0
        np.testing.assert_array_equal(np.isfinite(one.values), there)
        for band in range(2):
            expected = own[band] * bright(world[..., 0], world[..., 1])
            # waves of 25 px and more: below 1e-3 but beside the border of a frame, where taps lie on one side
            errors.append((one.values[band] / expected - 1.0)[there[band]])
        assert one.passed[there].all() and not one.beyond.any()
        shown |= set(np.unique(one.view).tolist())
    assert shown == {-1, *range(4)} - set(spoilt)
    error = np.concatenate(errors)
    assert np.abs(error).max() < 0.02 and np.sqrt((error**2).mean()) < 1e-3


def test_tiles_ask_for_no_more_of_frames_than_may_show_them(views, outline):
    maker = maker_of(views, outline)
    assert [frame for frame, _ in maker.frames_of(MapTile(10, 20, 30, 40), unread={0})] == [1, 2, 3]
    room = 2.0 * 0.5 + 0.02 * np.ptp(outline, axis=1).max()
    for tile in (MapTile(10, 20, 30, 40), MapTile(-30, -40, 400, 300)):
        for frame, box in maker.frames_of(tile):
            (west, south), (east, north) = (
                outline[frame].min(axis=0) - room,
                outline[frame].max(axis=0) + room,
            )
            left, top = maker.grid.west + 0.5 * tile.column, maker.grid.north - 0.5 * tile.row
            for low, high, size, first, last in (
                (box[0], box[1], tile.rows, top - north, top - south),
                (box[2], box[3], tile.columns, west - left, east - left),
            ):
                assert low == np.clip(np.floor(first / 0.5), 0, size)
                assert high == np.clip(np.ceil(last / 0.5), 0, size)
    assert maker.frames_of(MapTile(10_000, 0, 8, 8)) == []


def test_a_map_holds_all_places_at_whole_pixels():
    places = np.array([[10.2, -3.1], [np.nan, 5.0], [31.0, 8.4], [12.0, 20.3]])
    grid = covering_grid(places, MapSystem(), 2.5)
    assert (grid.west, grid.north, grid.shape) == (10.0, 22.5, (11, 9))
    with pytest.raises(InputError, match="looks at the ground"):
        covering_grid(np.full((3, 2), np.nan), MapSystem(), 1.0)


@pytest.mark.parametrize("bands", [3, 200])
def test_tiles_cover_a_map_once_and_fit_the_memory(bands):
    layout = line_bands(np.linspace(400.0, 900.0, 2 * bands), bands)
    grid = CubeGrid(MapSystem(), 0.0, 0.0, 1.0, (1100, 700))
    count = np.zeros(grid.shape, dtype=int)
    for tile in tiles_of(grid, layout):
        count[tile.row : tile.row + tile.rows, tile.column : tile.column + tile.columns] += 1
        # a float32 of each band, a cost, a view, two flags and an order of each group
        bytes_of = tile.rows * tile.columns * bands * (4 + 4 + 4 + 2 + 4)
        assert bytes_of < 48 * 2**20 and tile.rows <= 512
        assert tile.row + tile.rows <= 1100 and tile.column + tile.columns <= 700
    assert (count == 1).all()
    assert tiles_of(grid, layout)[0].rows == (
        512 if bands == 3 else 64 * int(np.sqrt(48 * 2**20 / 3632) / 64)
    )


def test_what_tiles_hold_is_counted_band_by_band():
    rng = np.random.default_rng(8)
    layout = LAYOUT
    tally = CubeTally(layout, CubeGrid(MapSystem(), 0.0, 0.0, 1.0, (8, 12)), (0, 1, 0))
    whole = []
    for column in (0, 6):
        view = rng.integers(-1, 3, (2, 8, 6)).astype(np.int32)
        values = np.where(
            (view >= 0) & (rng.random(view.shape) < 0.8), rng.uniform(1.0, 9.0, view.shape), np.nan
        )
        flags = rng.random((2, *view.shape)) < 0.5
        whole.append((view, values.astype(np.float32), *flags))
        tally.add(FilledTile(MapTile(0, column, 8, 6), values.astype(np.float32), view, *flags))
    view, values, passed, beyond = (np.concatenate(parts, axis=2) for parts in zip(*whole, strict=True))
    there = np.isfinite(values)
    everywhere = {(i, j) for i in range(8) for j in range(12) if passed[0, i, j] and passed[1, i, j]}
    good = {
        (i, j) for i in range(8) for j in range(12)
        if all(view[g, i, j] >= 0 and not beyond[g, i, j] for g in (0, 1))
    }  # fmt: skip
    assert (tally.passed, tally.seen) == (len(everywhere), len(good))
    for band in (0, 1):
        assert tally.of_passed[band] == sum(there[band][at] for at in everywhere)
        assert tally.of_seen[band] == sum(there[band][at] for at in good)
        assert tally.values[band] == there[band].sum()
        assert tally.beyond[band] == sum(beyond[band][there[band]])
        assert tally.total[band] == pytest.approx(values[band][there[band]].sum(dtype=float))
    assert tally.used == {0, 1, 2}


@pytest.mark.parametrize("shape", [(900, 640), (9000, 5203), (701, 20_001)])
def test_the_grid_of_a_picture_covers_the_map_at_half_its_own_pixels(shape):
    grid = CubeGrid(MapSystem(), 100.0, 900.0, 0.2, shape)
    found, factor = picture_grid(grid), picture_factor(shape)
    if factor < 4:
        assert found is grid
        return
    west, south, east, north = grid.extent
    own = found.extent
    assert (own[0], own[3]) == (west, north) and found.gsd == pytest.approx(0.1 * factor)
    assert own[1] <= south + 1e-9 and own[2] >= east - 1e-9
    # no more than a pixel of the picture beyond
    assert own[1] > south - 0.2 * factor and own[2] < east + 0.2 * factor
    assert found.shape[0] % 2 == found.shape[1] % 2 == 0


def test_bands_of_a_rig_go_by_wavelength_and_keep_their_cameras():
    layout = camera_bands(["nir", "all", "blue", "red"], [850.0, np.nan, 470.0, 660.0], [2, 1, 0, 0], 5)
    assert layout.names == ("blue", "red", "nir", "all")
    assert layout.group.tolist() == [0, 0, 2, 1] and layout.channel.tolist() == [2, 3, 0, 1]
    # each line is of all three cameras, best in the middle of the frame
    assert layout.offset.tolist() == [0, 3, 6, 9, 12, 15]
    assert layout.entry_group.tolist() == [0, 1, 2] * 5
    assert set(layout.centre) == {2.0} and set(layout.half) == {2.5} and not layout.spare.any()


def test_a_pixel_of_the_map_has_the_side_of_a_pixel_on_the_ground(views):
    down = map_outlines(views, lambda o, d: o - o[:, 2:] / d[:, 2:] * d)
    problem = SimpleNamespace(detector=views.detector, mosaic_nm=None)
    # 50 m over level ground at 100 px
    assert pixel_size(problem, views, down) == pytest.approx(0.5)
    flat = down * np.array([1.0, 4.0])
    assert pixel_size(problem, views, flat) == pytest.approx(1.0)
    problem.mosaic_nm = np.zeros((2, 3))
    assert pixel_size(problem, views, down) == pytest.approx(1.5)
    with pytest.raises(InputError, match="nothing to map"):
        pixel_size(problem, views, np.full_like(down, np.nan))


def test_bands_are_those_asked_for_to_a_nanometre():
    mosaic = np.array([[700.0, 500.0], [600.0, 400.0]])
    detector = SimpleNamespace(wavelength_nm=None, shape=(20, 20))
    problem = SimpleNamespace(detector=detector, mosaic_nm=mosaic, channel_nm=(), rig=())
    whole = frame_bands((20, 20), mosaic)
    nowhere = np.full((1, 1, 2), np.nan)
    nm = whole.wavelength_nm.tolist()
    for bands, expected in ((None, nm), (4, nm), ([600.9, 399.2], [600.0, 400.0])):
        found = choose_bands(problem, CubePlan(bands=bands), nowhere, 1.0)
        assert found.wavelength_nm.tolist() == expected
    for bands in (3, [600.9, 502.0]):
        with pytest.raises(InputError, match="among the 4 wavelengths"):
            choose_bands(problem, CubePlan(bands=bands), nowhere, 1.0)
    # of a continuous filter by the step from frame to frame: 5 lines of the map
    detector.wavelength_nm = np.linspace(900.0, 450.0, 480)
    steps = np.array([0.0, 9.0, 20.0, 30.0])[:, None, None] * [0.6, 0.8] + np.array(
        [[-3.0, 1.0], [3.0, -1.0]]
    )
    found = choose_bands(problem, CubePlan(lines_per_step=3.0), steps, 2.0)
    assert found.names == line_bands(detector.wavelength_nm, step=5.0, lines_per_step=3.0).names
