"""Parts of the cube alone: weights at the border of frames, bands, the ground through points, maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sightline.compiled import only_read
from sightline.errors import EstimationError, InputError
from sightline.geometry.earth import WGS84, from_geodetic
from sightline.geometry.instrument import AreaDetector
from sightline.imaging.source import ArrayImage
from sightline.products import ground_model
from sightline.products.cube_bands import frame_bands, line_bands
from sightline.products.cube_fit import error_map, fit_pairs, pairs_of
from sightline.products.cube_grid import CubeGrid, MapSystem, map_system
from sightline.products.cube_kernels import (
    PHASES,
    cells_by_phase,
    choose_views,
    fill_bands,
    place_weights,
    see_places,
)
from sightline.products.cube_tally import CubePicture, picture_bands, picture_factor
from sightline.products.frame_cube import FilledTile, FrameViews, MapTile, line_gain, map_outlines
from sightline.products.ground_model import GroundModel, fit_ground
from sightline.products.resample import BEFORE, TAPS, product_weights


@pytest.mark.parametrize(
    ("place", "worst"), [(7.5, 1e-3), (7.25, 1e-3), (3.5, 3e-3), (1.5, 0.02), (0.5, 0.1), (0.0, 1e-6)]
)
def test_weights_keep_a_wave_up_to_the_border_of_the_frame(place, worst):
    table = place_weights()
    row = table[round(place * PHASES)]
    assert row.sum() == pytest.approx(1.0, abs=1e-6) and (row**2).sum() <= 2.0
    for frequency in (0.0, 0.05, 0.15, 0.25, 0.3):
        wave = np.exp(2j * np.pi * frequency * np.arange(TAPS))
        assert abs(row @ wave - np.exp(2j * np.pi * frequency * place)) < worst


def test_weights_in_the_middle_are_those_of_all_products():
    fraction = np.array([0.0, 0.25, 0.5])
    rows = np.round((BEFORE + fraction) * PHASES).astype(int)
    assert place_weights()[rows] == pytest.approx(product_weights(fraction), abs=2e-3)


def own_lines(layout):
    """First and last own line of each group."""
    line = np.repeat(np.arange(len(layout.offset) - 1.0), np.diff(layout.offset))
    rows = [line[(layout.entry_group == g) & ~layout.spare] for g in range(layout.groups)]
    return np.array([r.min() for r in rows]), np.array([r.max() for r in rows])


def test_bands_of_a_filter_with_steps_are_its_steps():
    nm = np.repeat([500.0, 600.0, 700.0], [4, 6, 5])
    layout = line_bands(nm)
    assert layout.wavelength_nm.tolist() == [500.0, 600.0, 700.0]
    assert np.diff(layout.offset).tolist() == [1] * 15
    assert layout.entry_group.tolist() == [0] * 4 + [1] * 6 + [2] * 5
    assert layout.centre[[0, 4, 10]].tolist() == [1.5, 6.5, 12.0]
    assert not layout.spare.any()
    first, last = own_lines(layout)
    assert first.tolist() == [0.0, 4.0, 10.0] and last.tolist() == [3.0, 9.0, 14.0]
    # lines of the next step stand in only when they are asked to
    assert line_bands(nm, fill_nm=100.0).spare.any()


def test_pictures_have_the_bands_nearest_to_the_wavelengths_asked_for():
    layout = line_bands(np.repeat([450.0, 550.0, 660.0, 850.0], 4))
    assert picture_bands(layout) == (2, 1, 0)
    assert picture_bands(layout, (860.0, 650.0, 555.0)) == (3, 2, 1)


def test_bands_of_a_continuous_filter_have_lines_for_the_steps_flown():
    nm = np.linspace(900.0, 450.0, 480)
    layout = line_bands(nm, step=5.0)
    first, last = own_lines(layout)
    assert len(layout) == 64 and (last - first + 1 >= 7.0).all()
    assert np.diff(layout.wavelength_nm).min() > 0.0
    three = line_bands(nm, [500.0, 655.5, 800.0], step=5.0)
    assert three.centre[three.entry_group == 1][0] == pytest.approx(
        np.interp(655.5, nm[::-1], 479.0 - np.arange(480))
    )
    assert (np.bincount(three.entry_group, ~three.spare) <= 9).all()
    assert len(line_bands(nm, 10)) == 10
    # 480 lines over three steps of 5 lines
    assert len(line_bands(nm, step=5.0, lines_per_step=3.0)) == 32
    one = layout.of([3, 60])
    assert one.names == (layout.names[3], layout.names[60]) and set(one.entry_group) == {0, 1}


def test_wavelengths_asked_for_lie_within_half_a_band_of_the_lines():
    """Lines from 450 to 900 nm: ten bands of 45 nm, which reach 22.5 nm beyond either end."""
    nm = np.linspace(900.0, 450.0, 480)
    step = 480 / 10
    for ends in ([428.0, 600.0], [922.0, 600.0]):
        assert line_bands(nm, ends, step=step, lines_per_step=1.0).wavelength_nm.tolist() == ends
    for wrong in (427.0, 923.0, np.nan):
        with pytest.raises(InputError, match=f"from 450 to 900 nm, got {wrong:g}"):
            line_bands(nm, [600.0, wrong], step=step, lines_per_step=1.0)
    with pytest.raises(InputError, match="twice"):
        line_bands(nm, [600.0, 600.0])


def test_bands_that_are_asked_for_close_together_part_their_lines_halfway():
    """Lines 1 nm apart; bands of 90 lines would be 89.8 nm wide, of which neighbours leave less."""
    nm = np.linspace(451.0, 900.0, 450)
    asked = np.array([640.2, 500.4, 655.7, 530.1, 820.0])
    layout = line_bands(nm, asked, step=60.0)
    line = np.repeat(np.arange(450), np.diff(layout.offset))
    for group, band in enumerate(asked):
        own = line[(layout.entry_group == group) & ~layout.spare]
        near = np.minimum(np.sort(np.abs(asked - band))[1], 89.8) / 2.0
        assert own.tolist() == np.flatnonzero(np.abs(nm - band) <= near).tolist()


def test_bands_of_whole_frames():
    mosaic = frame_bands((20, 20), np.array([[700.0, 500.0], [600.0, 400.0]]))
    assert mosaic.wavelength_nm.tolist() == [400.0, 500.0, 600.0, 700.0]
    assert mosaic.phase.tolist() == [[1, 1], [0, 1], [1, 0], [0, 0]] and mosaic.groups == 1
    colour = frame_bands((20, 20), None, (620.0, 540.0, 460.0))
    assert colour.channel.tolist() == [2, 1, 0]
    assert frame_bands((20, 20)).names == ("all light",)
    # each line has its own entry, the same for all
    assert mosaic.offset.tolist() == list(range(21)) and len(mosaic.entry_group) == 20
    # about the middle of the frame, which reaches half its height to either side
    assert set(mosaic.centre) == {9.5} and set(mosaic.half) == {10.0} and not mosaic.spare.any()


def test_a_surface_through_points_is_better_than_they_are():
    rng = np.random.default_rng(0)
    flat = rng.uniform(0.0, 30.0, (700, 2))

    def true(x, y):
        return 3.0 + 0.1 * x + np.sin(x / 6.0) * np.cos(y / 8.0)

    points = np.column_stack([flat, true(*flat.T) + 0.1 * rng.standard_normal(len(flat))])
    points[::40, 2] += 3.0
    model = fit_ground(points, np.full(len(points), 0.1))
    x, y = np.meshgrid(np.linspace(2.0, 28.0, 60), np.linspace(2.0, 28.0, 60))
    # a dozen points to a period of 6 postings: a third of the noise of a point is left, and what the grid
    # cannot follow; 18 false points would add 0.1 m rms
    assert np.sqrt(np.mean((model.at(x, y) - true(x, y)) ** 2)) < 0.06
    # what points are missed by: their own noise and the surface's
    assert 0.08 < model.sigma < 0.14
    assert not model.used[::40].any() and model.used.sum() > 650


def test_heights_between_nodes_are_bilinear_and_go_on_level_beyond_the_border():
    # h = 5 + 2 r - 3 c + r c at node (r, c): bilinear as it is; rows go north from 20 m, 10 m apart
    row, column = np.indices((4, 6)).astype(float)
    height = 5.0 + 2.0 * row - 3.0 * column + row * column
    model = GroundModel(100.0, 20.0, 10.0, height, 0.1, np.ones(3, dtype=bool))
    rng = np.random.default_rng(9)
    x, y = rng.uniform(70.0, 180.0, (8, 50)), rng.uniform(-10.0, 80.0, (8, 50))
    # the four corners, the border and both sides of nodes too
    x[0, :8], y[0, :8] = [100, 150, 100, 150, 150, 125, 110, 129.9], [20, 20, 50, 50, 33, 50, 30, 49.9]
    c, r = np.clip((x - 100.0) / 10.0, 0.0, 5.0), np.clip((y - 20.0) / 10.0, 0.0, 3.0)
    assert model.at(x, y) == pytest.approx(5.0 + 2.0 * r - 3.0 * c + r * c, abs=1e-9)


def test_a_surface_in_blocks_has_no_steps():
    flat = np.random.default_rng(1).uniform(0.0, 1.0, (1200, 2)) * [300.0, 8.0]
    model = fit_ground(np.column_stack([flat, np.sin(flat[:, 0] / 9.0)]), posting=1.0)
    assert model.heights.shape[1] > 200
    x = np.linspace(3.0, 297.0, 3000)
    assert np.abs(model.at(x, np.full(3000, 4.0)) - np.sin(x / 9.0)).max() < 0.05


def test_points_stand_out_that_leave_their_ten_neighbours_by_nine_of_their_sigmas():
    """A tenth of the points raised by 8 to 14 sigmas of the others, the ten nearest of each written out."""
    rng = np.random.default_rng(14)
    places = np.column_stack([rng.uniform(0.0, [40.0, 25.0], (1200, 2)), rng.standard_normal(1200)])
    places[::10, 2] += rng.uniform(8.0, 14.0, 120)
    apart = np.hypot(*(places[:, None, :2] - places[None, :, :2]).transpose(2, 0, 1))
    off = places[np.argsort(apart, axis=1)[:, 1:11], 2] - places[:, 2:]
    middle = np.median(off, axis=1)
    # the median size of normal numbers is 0.67449 of their sigma
    spread = np.median(np.abs(off - middle[:, None]), axis=1) / 0.6744898
    wanted = np.abs(middle) > 9.0 * np.maximum(spread, np.median(np.abs(middle)) / 0.6744898)
    assert 20 < wanted.sum() < 100
    np.testing.assert_array_equal(ground_model._standing_out(places), wanted)


def test_each_block_of_a_surface_gives_the_nodes_that_are_its_own(monkeypatch):
    """Any function of the place in place of what is solved: it comes back at all nodes, block after block."""
    parts = []

    def true(x, y):
        return 0.3 * x - 0.7 * y + 0.01 * x * y

    def solved(places, weight, part, stiffness):
        west, south, step, shape = part
        y, x = np.indices(shape)
        parts.append(shape)
        return true(west + step * x, south + step * y), np.zeros(len(places))

    monkeypatch.setattr(ground_model, "_solve", solved)
    rng, shape = np.random.default_rng(2), (301, 130)
    places = np.column_stack(
        [*rng.uniform([-5.0, 40.0], [-5.0 + 129 * 0.5, 40.0 + 300 * 0.5], (4000, 2)).T, np.zeros(4000)]
    )
    heights, inlier = ground_model._solve_blocks(places, np.ones(4000), (-5.0, 40.0, 0.5, shape), 1.0)
    y, x = np.indices(shape)
    assert heights == pytest.approx(true(-5.0 + 0.5 * x, 40.0 + 0.5 * y), abs=1e-9) and inlier.all()
    # blocks of 96 nodes, the last with what is left, and 24 beside each where there are as many
    rows, columns = (120, 144, 133, 37), (120, 58)
    assert sorted(parts) == sorted((r, c) for r in rows for c in columns)


def test_too_few_points_are_no_surface():
    with pytest.raises(EstimationError, match="5 points do not make a surface"):
        fit_ground(np.vstack([np.random.default_rng(0).uniform(size=(5, 3)), np.full((9, 3), np.nan)]))


@pytest.mark.parametrize(
    ("lon", "lat", "system"),
    [
        (11.3, 47.2, "EPSG:32632"),
        (-70.0, -33.0, "EPSG:32719"),
        (0.0, 88.0, "EPSG:5041"),
        (9.0, -85.0, "EPSG:5042"),
    ],
)
def test_maps_of_the_earth(lon, lat, system):
    point = from_geodetic(np.append(np.radians([lon, lat]), 100.0)[None])
    assert map_system(point[0], WGS84) == system
    axes = MapSystem(system)
    there = axes.places(point)
    assert axes.world(there) == pytest.approx(point, abs=1e-6)
    assert there[0, 2] == pytest.approx(100.0, abs=1e-6)


def test_maps_of_another_body_lie_about_the_flight():
    radii = (3396190.0, 3376200.0)
    point = from_geodetic(np.array([[2.4, 0.3, -2000.0]]), radii)
    axes = MapSystem(map_system(point[0], radii), radii)
    places = axes.places(point)
    assert places[0] == pytest.approx([0.0, 0.0, -2000.0], abs=0.1)
    assert axes.world(places) == pytest.approx(point, abs=1e-5)


def test_pixels_of_a_map_and_back():
    grid = CubeGrid(MapSystem(), 100.0, 50.0, 0.5, (20, 30))
    assert grid.extent == (100.0, 40.0, 115.0, 50.0)
    places = grid.centres(np.array([0.0, 3.5]), np.array([0.0, 7.0]))
    assert places.tolist() == [[100.25, 49.75], [103.75, 48.0]]
    assert grid.pixels(places).tolist() == [[0.0, 0.0], [3.5, 7.0]]
    with pytest.raises(InputError, match="both positive"):
        CubeGrid(MapSystem(), 0.0, 0.0, 1.0, (0, 4))


def test_pairs_near_and_far_and_where_they_disagree():
    assert pairs_of(np.array([500.0, 450.0])) == [(1, 0)]
    pairs = pairs_of(np.arange(60.0))
    assert (0, 1) in pairs and (0, 59) in pairs and len(pairs) < 25
    rng = np.random.default_rng(2)
    # smooth enough that a shift of half a pixel can be matched
    spectrum = np.fft.rfft2(rng.standard_normal((180, 260)))
    fy, fx = np.fft.fftfreq(180)[:, None], np.fft.rfftfreq(260)[None]
    spectrum *= np.exp(-((fx**2 + fy**2) / 0.15**2))
    a = np.fft.irfft2(spectrum, (180, 260))
    b = np.fft.irfft2(spectrum * np.exp(-2j * np.pi * fx * 0.4), (180, 260))
    fits = fit_pairs([ArrayImage(100.0 + 9.0 * a), ArrayImage(100.0 + 9.0 * b)], np.array([500.0, 510.0]))
    # 0.4 px along one of two axes; 3 px are beyond a search of 1
    far = [ArrayImage(100.0 + 9.0 * a), ArrayImage(100.0 + 9.0 * np.roll(a, 3, axis=1))]
    near = fit_pairs(far, np.array([500.0, 510.0]), search_px=(1, 1))[0]
    assert near.windows < 0.1 * fit_pairs(far, np.array([500.0, 510.0]))[0].windows
    assert fits[0].rms_px == pytest.approx(0.4 / np.sqrt(2.0), abs=0.03)
    chart = error_map(fits, (180, 260))
    assert np.nanmedian(chart) == pytest.approx(0.4 / np.sqrt(2.0), abs=0.03)


def test_lines_are_as_bright_as_their_filter_makes_them():
    rng = np.random.default_rng(3)
    level = np.linspace(1.0, 3.0, 24)
    frames = [ArrayImage(level[:, None] * (1.0 + 0.1 * rng.standard_normal((24, 40)))) for _ in range(30)]
    # 1200 pixels of 10 % contrast each
    assert line_gain([[None, *frames]], 24)[0] == pytest.approx(level, rel=0.012)
    assert line_gain([[None, None]], 24).tolist() == [[1.0] * 24]


def filled(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """One band of a plain image at pixels (N, 2)."""
    out = np.full((1, len(pixels)), np.nan, dtype=np.float32)
    fill_bands(
        np.arange(len(pixels), dtype=np.int32), pixels,
        *cells_by_phase(image, np.zeros(image.shape, dtype=bool), (1, 1)), np.zeros(2),
        np.array([1, 1]), np.array([0, 1]), np.array([0]), np.zeros((1, 2), dtype=int),
        np.ones(1, dtype=np.float32), place_weights(), 0.02, out,
    )  # fmt: skip
    return out[0]


def test_every_pixel_is_its_own_value_up_to_all_borders():
    image = np.random.default_rng(6).uniform(0.0, 1000.0, (24, 30)).astype(np.float32)
    pixels = np.stack(np.indices(image.shape), axis=-1).reshape(-1, 2).astype(float)
    # the last place stands a thousandth of a 256th of a pixel before its own weights, which change over the
    # whole of it by some 3 / 256 of the contrast on each axis: 0.02; twice that for 32 bits besides
    assert filled(image, pixels) == pytest.approx(image.ravel(), abs=0.04)


def test_between_pixels_a_plane_goes_on_up_to_all_borders():
    line, column = np.indices((24, 30)).astype(np.float32)
    image = np.asarray(1e3 + 40.0 * line - 25.0 * column, dtype=np.float32)
    pixels = np.random.default_rng(7).uniform(0.0, [23.0, 29.0], (300, 2))
    pixels = np.concatenate([pixels, [[22.999, 28.999], [0.001, 0.001], [22.9, 0.2], [0.3, 28.8]]])
    found, wanted = filled(image, pixels), 1e3 + 40.0 * pixels[:, 0] - 25.0 * pixels[:, 1]
    # weights of taps on one side are as true as can be without more noise: a wave is a tenth off at worst
    assert found == pytest.approx(wanted, abs=0.1 * (40.0 + 25.0))
    # with seven taps on the shorter side it is the plane, in 32 bits
    middle = ((pixels > 7.0) & (pixels < [15.0, 21.0])).all(axis=1)
    assert middle.sum() > 20
    assert found[middle] == pytest.approx(wanted[middle], abs=0.05)


@pytest.mark.parametrize("period", [(2, 3), (3, 1), (1, 1)])
@pytest.mark.parametrize("masked", [True, False])
def test_cells_of_a_phase_lie_by_themselves(period, masked):
    image = np.arange(7 * 8, dtype=np.float32).reshape(7, 8)
    bad = image % 5.0 == 2.0 if masked else np.zeros((0, 0), dtype=bool)
    cells, spoiled, sizes = cells_by_phase(image, bad, period)
    assert len(cells) == len(sizes) == period[0] * period[1]
    for k, (rows, columns) in enumerate(sizes):
        i, j = divmod(k, period[1])
        own = [(y, x) for y in range(i, 7, period[0]) for x in range(j, 8, period[1])]
        assert rows * columns == len(own)
        assert cells[k, :rows, :columns].ravel().tolist() == [image[at] for at in own]
        if masked:
            assert spoiled[k, :rows, :columns].ravel().tolist() == [bad[at] for at in own]


def test_each_cell_of_a_mosaic_is_read_where_it_lies():
    # bands of six cells, each on a plane of its own: resampling a plane is exact, a cell taken for its
    # neighbour shows as the slope times a pixel
    def plane(band, line, column):
        return 1000.0 * band + 7.0 * line + 3.0 * column

    phase = np.array([[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]])
    line, column = np.meshgrid(np.arange(100.0), np.arange(150.0), indexing="ij")
    image = np.empty((100, 150), dtype=np.float32)
    for band, (down, right) in enumerate(phase):
        cells = (slice(down, None, 2), slice(right, None, 3))
        image[cells] = plane(band, line[cells], column[cells])
    bad = np.zeros(image.shape, dtype=bool)
    bad[41, 74] = True  # of the last band, beside the second place
    corner = np.array([10.0, 21.0])
    pixels = corner + np.array([[49.3, 71.0], [40.0, 73.6], [57.75, 64.2]])
    out = np.full((6, 3), np.nan, dtype=np.float32)
    fill_bands(
        np.arange(3, dtype=np.int32), pixels, *cells_by_phase(image, bad, (2, 3)), corner, np.array([2, 3]),
        np.array([0, 6]), np.arange(6), phase, np.ones(6, dtype=np.float32), place_weights(), 0.02, out,
    )  # fmt: skip
    found = np.array([plane(band, *(pixels - corner).T) for band in range(6)])
    spoiled = np.zeros((6, 3), dtype=bool)
    spoiled[5, 1] = True
    np.testing.assert_array_equal(np.isnan(out), spoiled)
    # weights of 16 taps in 32 bits, over values of some thousands
    assert out[~spoiled] == pytest.approx(found[~spoiled], abs=0.05)


def test_a_rolling_shutter_sees_a_place_by_the_pose_of_its_own_line():
    rng = np.random.default_rng(3)
    turns = Rotation.from_rotvec(np.array([[0.0, 0.0, 0.0], [0.02, -0.01, 0.03], [0.05, -0.03, 0.02]]))
    matrices = np.ascontiguousarray((turns * Rotation.from_rotvec([np.pi, 0.0, 0.0])).as_matrix())
    positions = np.array([[0.0, 0.0, 100.0], [3.0, 1.0, 100.5], [7.0, 1.5, 101.5]])
    lines, focal, principal = 200, 400.0, (99.5, 149.5)
    lens = np.array([focal, *principal])
    world = np.column_stack([rng.uniform(-15.0, 15.0, (20, 2)), rng.uniform(-2.0, 2.0, 20)])

    def miss(line, point):
        # parabola through the first, middle and last pose, as a matrix of Vandermonde has it
        weight = np.linalg.solve(
            np.vander([0.0, 0.5, 1.0], 3).T, [(line / (lines - 1)) ** 2, line / (lines - 1), 1]
        )
        ray = np.tensordot(weight, matrices, 1) @ (point - weight @ positions)
        seen = np.array(principal) + focal * ray[[1, 0]] / ray[2]
        return seen[0] - line, seen

    pixels = np.empty((20, 2))
    read = only_read(world, matrices, positions, lens, np.zeros(5))
    places = np.arange(20, dtype=np.int32)
    see_places(read[0], places, *read[1:], 10.0, (lines, 300), pixels)
    for point, found in zip(world, pixels, strict=True):
        line = brentq(lambda x, point=point: miss(x, point)[0], -200.0, 400.0)
        assert found == pytest.approx(miss(line, point)[1], abs=0.01)
    # and it matters: by the pose of the middle line alone they would lie pixels away
    still = np.empty((20, 2))
    middle = only_read(matrices[1:2], positions[1:2], lens, np.zeros(5))
    see_places(read[0], places, *middle, 10.0, (lines, 300), still)
    assert np.abs(still - pixels).max() > 2.0


def test_frames_are_outlined_where_the_rims_of_their_pixels_meet_the_ground():
    """Level frames 50 m over z = 0, 100 px to the radian: lines go down along -y, columns along x."""
    detector = AreaDetector("frame", (40, 60), 100.0, (19.0, 31.0))
    nadir = np.diag([1.0, -1.0, -1.0])
    # the first frame's shutter reads line 20 and the last line 10 and 20 m further along x
    position = np.array([[[5.0 + 10.0 * k, 8.0, 50.0] for k in range(3)], [[-300.0, 0.0, 50.0]] * 3])
    views = FrameViews(detector, position, np.tile(nadir, (2, 3, 1, 1)), np.zeros(2, int), np.zeros(2))

    def flat(origin, direction):
        return origin - origin[:, 2:] / direction[:, 2:] * direction

    (moved_x, moved_y), (x, y) = map_outlines(views, flat).transpose(0, 2, 1)
    left, right = 0.5 * (-0.5 - 31.0), 0.5 * (59.5 - 31.0)
    top, bottom = -0.5 * (-0.5 - 19.0), -0.5 * (39.5 - 19.0)
    assert [x.min(), x.max()] == pytest.approx([left - 300.0, right - 300.0])
    assert [y.min(), y.max()] == pytest.approx([bottom, top])
    assert [moved_y.min(), moved_y.max()] == pytest.approx([bottom + 8.0, top + 8.0])
    for row, shift in ((top, 5.0), (bottom, 25.0)):
        there = moved_x[np.abs(moved_y - 8.0 - row) < 1e-9]
        assert [there.min(), there.max()] == pytest.approx([left + shift, right + shift])


def test_the_picture_is_the_mean_of_tiles_and_its_window_where_all_its_bands_meet():
    shape = (2500, 1300)
    factor = picture_factor(shape)
    assert factor == 3 and picture_factor((1200, 900)) == 1
    picture = CubePicture(CubeGrid(MapSystem(), 0.0, 0.0, 1.0, shape), 3)
    nothing = np.zeros((1, 0, 0))
    assert picture.window() == (slice(None), slice(None))
    # bands 4, 0 and 2 of five over rows and columns (from, to) of their own, in two tiles side by side
    extents = {4: ((30, 300), (60, 900)), 0: ((90, 600), (0, 600)), 2: ((0, 240), (150, 720))}
    row, column = np.indices(shape)
    value = {4: 1.0 * row, 0: 2.0 * column, 2: 7.0 + 0.0 * row}
    for first, last in ((0, 500), (500, 1300)):
        values = np.full((5, shape[0], last - first), np.nan, dtype=np.float32)
        for band, ((top, end), (left, right)) in extents.items():
            rows, columns = slice(top, end), slice(max(left, first), min(right, last))
            values[band, rows, columns.start - first : max(columns.stop, first) - first] = value[band][
                rows, columns
            ]
        tile = MapTile(0, first, shape[0], last - first)
        picture.add(FilledTile(tile, values, nothing, nothing, nothing), (4, 0, 2))
    # in pixels of the picture: rows 90 to 240, columns 150 to 600 of the map
    assert picture.window() == (slice(30, 80), slice(50, 200))
    limits = np.array([[0.0, 2540.0], [0.0, 2540.0], [0.0, 14.0]])
    image, used = picture.image(limits)
    assert image.shape == (834, 434, 3) and (used == limits).all()
    # pixel (40, 60): rows 120 to 122, columns 180 to 182 of the map, in steps of a 254th
    assert image[40, 60].tolist() == [1 + 12, 1 + 36, 1 + 127]
    assert not image[500].any()
    # limits of one's own: a hundredth of the pixels of each band lie beyond each
    own = picture.image()[1]
    assert own[0] == pytest.approx([31.0 + 0.01 * 267.0, 31.0 + 0.99 * 267.0], abs=3.0)


@pytest.mark.parametrize("run", [1, 4])
def test_places_are_shown_by_the_frame_that_sees_them_best_line_after_line(run):
    """Pinholes and the choice written out: two frames, five groups of bands in turn, lines that stand in."""
    lines, columns, period, focal, principal = 24, 41, (2, 3), 60.0, (10.5, 21.0)
    # entries of each line: (group, middle of the group, its half height, whether the line stands in)
    of_line = [k // run % 5 for k in range(lines)]
    entries = [[(g, 6.0 + 3.0 * g, 7.5 - 0.5 * g, False)] for g in of_line]
    for k in (13, 14):
        entries[k].append((0, 6.0, 7.5, True))
    offset = np.concatenate([[0], np.cumsum([len(one) for one in entries])])
    flat = [entry for one in entries for entry in one]
    group, centre, half, spare = (np.array(part) for part in zip(*flat, strict=True))
    # 7 by 9 places, heights unlike, on the ground under the frames; the box leaves some out
    rng = np.random.default_rng(12)
    north, east = np.meshgrid(np.linspace(9.0, -9.0, 7), np.linspace(-14.0, 15.0, 9), indexing="ij")
    world = np.stack([east, north, rng.uniform(-2.0, 2.0, north.shape)], axis=-1)
    box = np.array([1, 7, 0, 8])
    cost, view = np.full((5, 7, 9), np.inf, np.float32), np.full((5, 7, 9), -1, np.int32)
    beyond, passed, last = np.zeros((5, 7, 9), bool), np.zeros((5, 7, 9), bool), np.full((7, 9), np.nan)
    written = {"cost": cost, "view": view, "beyond": beyond, "passed": passed, "last": last}
    wanted = {name: one.copy() for name, one in written.items()}
    frames = [([0.05, 0.02, -0.03], [1.0, 3.0, 50.0], 0.0), ([0.02, 0.04, 0.06], [0.5, 1.5, 51.0], 0.3)]
    for number, (turn, place, penalty) in enumerate(frames):
        matrix = (Rotation.from_rotvec(turn) * Rotation.from_rotvec([np.pi, 0.0, 0.0])).as_matrix()
        pinhole = matrix[None], np.array([place]), np.array([focal, *principal]), np.zeros(5)
        choose_views(
            *only_read(world), box, *only_read(*pinhole), 10.0, (lines, columns), period, offset, group,
            *only_read(centre, half), spare, penalty, number, cost, view, beyond, last, passed,
        )  # fmt: skip
        for at in np.ndindex(7, 9):
            if not (box[0] <= at[0] < box[1] and box[2] <= at[1] < box[3]):
                continue
            ray = matrix @ (world[at] - place)
            line, column = principal[0] + focal * ray[1] / ray[2], principal[1] + focal * ray[0] / ray[2]
            # a pixel of every cell of the filter, of 2 by 3, on all sides
            if not (1.0 <= line <= lines - 2.0 and 2.0 <= column <= columns - 3.0):
                wanted["last"][at] = np.nan
                continue
            aside = (column - 20.0) / 20.5
            nearest, before = round(line), wanted["last"][at]
            for g, middle, reach, stands_in in entries[nearest]:
                worth = ((line - middle) / reach) ** 2 + aside**2 + penalty
                if worth < wanted["cost"][g][at]:
                    for name, value in (("cost", worth), ("view", number), ("beyond", stands_in)):
                        wanted[name][g][at] = value
            other = nearest if np.isnan(before) else round(before)
            for k in range(min(nearest, other), max(nearest, other) + 1):
                for g, _, _, stands_in in entries[k]:
                    wanted["passed"][g][at] |= not stands_in
            wanted["last"][at] = line
    # float64 places of 50 m, costs in single precision
    np.testing.assert_allclose(last, wanted["last"], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(cost, wanted["cost"], rtol=1e-5)
    for found, name in ((view, "view"), (beyond, "beyond"), (passed, "passed")):
        np.testing.assert_array_equal(found, wanted[name])
    assert {-1, 0, 1} == set(view.ravel()) and 0 < beyond.sum() and not passed.all()
