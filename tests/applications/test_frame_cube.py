"""Cubes of small rendered flights: each pixel against the truth of its band at its place; what goes wrong."""

from __future__ import annotations

from dataclasses import replace
from threading import Barrier

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cube_flights import flight, problem_of, true_poses
from sightline.applications.frame_cube import CubeSummary, assemble_cube, found_views
from sightline.applications.sequence_poses import SequencePoses
from sightline.errors import FormatError, InputError
from sightline.execution import threads_limited
from sightline.geometry.earth import WGS84, from_geodetic, local_axes
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.products.cube_ground import choose_ground
from sightline.products.cube_plan import CubePlan, map_of
from sightline.products.cube_store import MemoryStore
from sightline.products.frame_cube import CubeMaker
from sightline.simulate.sequence import SequenceScenario

QUICK = CubePlan(picture=False, fit=False)


def made(
    problem: SequenceProblem, found: SequencePoses, plan: CubePlan = QUICK
) -> tuple[CubeSummary, np.ndarray]:
    store = MemoryStore()
    return assemble_cube(problem, found, plan, store), store.values


def error_of_noise(
    scenario: SequenceScenario, summary: CubeSummary, values: np.ndarray
) -> tuple[float, float]:
    """Rms error of all bands in the middle of the map over the noise of a pixel, and over the contrast."""
    grid = summary.grid
    rows, columns = np.arange(0, grid.shape[0], 3.0), np.arange(0, grid.shape[1], 3.0)
    places = grid.centres(rows[:, None], columns[None, :])
    truth = scenario.band_signal(places[..., 0], places[..., 1], summary.wavelength_nm)
    seen = np.moveaxis(values[:, ::3, ::3], 0, 2)
    there = np.isfinite(seen)
    difference = (seen - truth)[there]
    radiometry = scenario.radiometry
    noise = radiometry.mean_dn / radiometry.snr
    return float(np.sqrt((difference**2).mean())) / noise, float(difference.std() / truth[there].std())


@pytest.fixture(scope="module")
def lvf() -> tuple[SequenceScenario, SequenceProblem]:
    scenario = flight(bands=12)
    return scenario, problem_of(scenario)


def test_pixels_of_a_line_filter_are_what_their_band_sees_at_their_place(lvf):
    scenario, problem = lvf
    summary, values = made(problem, true_poses(scenario))
    assert summary.wavelength_nm == pytest.approx(np.unique(scenario.filter.given_nm))
    # lines of a band differ by 35 nm from its first to its last (true wavelengths run on under given steps):
    # its brightness departs by some noise; shifted by half a pixel the ground itself departs five times more
    noise, contrast = error_of_noise(scenario, summary, values)
    assert contrast < 0.1
    moved, _ = error_of_noise(scenario, summary, np.roll(values, 1, axis=1))
    assert moved > 1.5 * noise
    assert summary.coverage.min() == 1.0
    # steps of 4.8 px, jitter and bands of 8 lines leave few gaps
    assert summary.passed.min() > 0.9


def test_two_threads_work_at_once_and_make_the_same_bits(lvf, monkeypatch):
    scenario, problem = lvf
    found = true_poses(scenario)
    monkeypatch.setattr("sightline.products.frame_cube._TILE_SIDES", (64, 64))
    with threads_limited(1):
        _, alone = made(problem, found)
    together, filled, left = Barrier(2, timeout=60.0), CubeMaker._filled, iter(range(2))

    def met(*arguments):
        if next(left, None) is not None:  # the first two tiles wait for one another
            together.wait()
        return filled(*arguments)

    monkeypatch.setattr(CubeMaker, "_filled", met)
    with threads_limited(2):
        _, both = made(problem, found)
    assert next(left, None) is None
    np.testing.assert_array_equal(both, alone)


def test_noise_is_all_that_is_wrong_where_filters_have_steps():
    scenario = flight(filter="stepwise", bands=6)
    summary, values = made(problem_of(scenario), true_poses(scenario))
    noise, contrast = error_of_noise(scenario, summary, values)
    # the kernel keeps 0.8 of the noise; shot noise of bright ground is more than that of the mean; strips of
    # neighbouring wavelengths reach into the kernel
    assert noise < 2.0 and contrast < 0.12


@pytest.mark.parametrize("kind", ["mosaic", "rgb", "pan"])
def test_filters_that_show_all_bands_at_once(kind):
    scenario = flight(filter=kind, pattern=2)
    summary, values = made(problem_of(scenario), true_poses(scenario))
    bands = {"mosaic": 4, "rgb": 3, "pan": 1}[kind]
    assert values.shape[0] == len(summary.names) == bands
    gsd = scenario.options.gsd * (2 if kind == "mosaic" else 1)
    assert summary.gsd == pytest.approx(gsd, rel=0.1)
    _, contrast = error_of_noise(scenario, summary, values)
    # cells of a mosaic alias what is finer than they are
    assert contrast < (0.25 if kind == "mosaic" else 0.08)
    assert summary.coverage.min() == 1.0


def test_a_rolling_shutter_is_followed():
    scenario = flight(filter="pan", readout_time=0.03, jitter=0.012)
    problem, found = problem_of(scenario), true_poses(scenario)
    _, rolling = error_of_noise(scenario, *made(problem, found))
    _, still = error_of_noise(scenario, *made(replace(problem, readout_time=0.0), found))
    assert rolling < 0.1 and still > 2.0 * rolling


def test_a_map_on_the_earth_is_projected(lvf):
    scenario, problem = lvf
    origin = from_geodetic(np.array([[np.radians(11.3), np.radians(47.2), 500.0]]))[0]
    turn = local_axes(np.radians(11.3), np.radians(47.2))
    flat = replace(problem, surface=Plane(0.0))
    found = true_poses(scenario)
    moved = replace(
        found.poses,
        position=origin + turn.apply(np.array(found.poses.position)),
        world_from_body=turn * found.poses.world_from_body,
    )
    images = replace(problem.images, position=moved.position, world_from_body=moved.world_from_body)
    earth = replace(
        problem, surface=Ellipsoid(*WGS84, 500.0), images=images, radii=WGS84, sources=problem.sources
    )
    local, here = made(flat, found, replace(QUICK, surface="given"))
    world, there = made(earth, replace(found, poses=moved), replace(QUICK, surface="given", gsd=local.gsd))
    assert world.grid.system.crs == "EPSG:32632"
    # the same ground, turned by the convergence of meridians (1.7 degrees): the same values at its places
    places = np.stack(np.meshgrid(np.linspace(-3.0, 3.0, 9), np.linspace(8.0, 14.0, 9)), axis=-1).reshape(
        -1, 2
    )
    level = np.column_stack([places, np.zeros(len(places))])
    at_local = local.grid.pixels(level).round().astype(int)
    exact = local.grid.centres(at_local[:, 0].astype(float), at_local[:, 1].astype(float))
    world_points = origin + turn.apply(np.column_stack([exact, np.zeros(len(exact))]))
    at_world = world.grid.pixels(world.grid.system.places(world_points)).round().astype(int)
    a, b = here[:, at_local[:, 0], at_local[:, 1]], there[:, at_world[:, 0], at_world[:, 1]]
    good = np.isfinite(a) & np.isfinite(b)
    assert good.mean() > 0.5
    assert np.corrcoef(a[good], b[good])[0, 1] > 0.97


def _departure(one: CubeSummary, a: np.ndarray, two: CubeSummary, b: np.ndarray) -> float:
    """Rms difference of two cubes over the ground between the points."""
    places = np.stack(np.meshgrid(np.arange(-5.0, 5.0, 0.4), np.arange(2.0, 14.0, 0.4)), axis=-1).reshape(
        -1, 2
    )
    rows = [g.pixels(places).round().astype(int) for g in (one.grid, two.grid)]
    # corners of both maps are at whole pixels
    first, second = (v[:, r[:, 0], r[:, 1]] for v, r in zip((a, b), rows, strict=True))
    return float(np.sqrt(np.nanmean((first - second) ** 2)))


def test_points_found_make_the_ground_where_the_surface_given_is_worse(lvf):
    scenario, problem = lvf
    dem, rng = problem.surface, np.random.default_rng(1)
    low, high = [-7.0, -2.0], [7.0, 18.0]
    flat = rng.uniform(low, high, (400, 2))
    points = np.column_stack([flat, dem.height_at(np.column_stack([flat, np.zeros(400)]))])
    points[::50, 2] += 5.0
    found = true_poses(scenario, points)
    rough = replace(problem, surface=Plane(0.0), height_sigma=1.0)
    kept, exact = made(problem, found)
    assert kept.surface.startswith("the surface given, which points meet")
    summary, by_points = made(rough, found, replace(QUICK, gsd=kept.gsd))
    assert "points found" in summary.surface
    given, by_plane = made(rough, found, replace(QUICK, surface="given", gsd=kept.gsd))
    assert given.surface.startswith("the surface given") and given.height_sigma > 5 * summary.height_sigma
    # maps of other heights begin elsewhere: compared over what they share
    assert _departure(kept, exact, summary, by_points) < 0.4 * _departure(kept, exact, given, by_plane)
    with pytest.raises(Exception, match="points do not make a surface"):
        made(rough, true_poses(scenario), replace(QUICK, surface="model"))


def test_ground_that_is_not_given_is_that_of_the_points(lvf):
    scenario, problem = lvf
    dem, rng = problem.surface, np.random.default_rng(1)
    # too few for a surface through them
    flat = rng.uniform([-7.0, -2.0], [7.0, 18.0], (11, 2))
    points = np.column_stack([flat, dem.height_at(np.column_stack([flat, np.zeros(11)]))])
    flying = float(np.median(scenario.poses[1][:, 2] - np.median(points[:, 2])))
    # as if the flight began from a hill four times as high as it flies above it
    below = replace(problem, surface=Plane(float(np.median(points[:, 2])) - 4.0 * flying), height_sigma=0.0)
    stages = []
    summary = assemble_cube(
        below,
        true_poses(scenario, points),
        progress=lambda stage, done, total: stages.append((stage, done, total)),
    )
    assert summary.surface.startswith("level ground at")
    # the relief is a few percent of the flying height; pixels of the given ground are five times as large
    good = assemble_cube(problem, true_poses(scenario, points), QUICK)
    assert summary.gsd == pytest.approx(good.gsd, rel=0.1)
    last = {stage: (done, total) for stage, done, total in stages}
    assert list(last) == [
        "cube: ground", "cube: lines made alike", "cube", "cube: picture by the rough poses",
        "cube: bands matched",
    ]  # fmt: skip
    assert all(last[name][0] == last[name][1] for name in list(last)[2:])


def test_frames_that_cannot_be_used_are_replaced_by_their_neighbours(lvf):
    scenario, problem = lvf

    class Broken:
        shape = scenario.options.shape

        def read(self, lines, columns):
            raise FormatError("frame 7 is truncated")

        def mask(self, lines, columns):
            return None

    sources = list(problem.sources)
    sources[7] = Broken()
    found = true_poses(scenario)
    summary, _ = made(replace(problem, sources=tuple(sources)), found)
    assert summary.unread == ("7: frame 7 is truncated",) and "could not be read" in summary.warnings[0]
    # frames 7 and the excluded 8 leave a gap of three steps, 14 px, which bands of 8 lines cannot close
    excluded = tuple("blurred" if k == 8 else "" for k in range(len(problem)))
    worse, _ = made(replace(problem, sources=tuple(sources), excluded=excluded), found)
    assert worse.frames_used == summary.frames_used - 1 < len(problem)
    assert worse.passed.min() < 0.95 and any("fewer bands" in w for w in worse.warnings)
    # lines next to the band's own close gaps when they may
    filled, _ = made(
        replace(problem, sources=tuple(sources), excluded=excluded), found, replace(QUICK, fill_nm=60.0)
    )
    assert filled.passed.min() > worse.passed.min() + 0.02 and filled.beyond.max() > 0.0
    interpolated = replace(found, source=tuple("interpolated" if k == 9 else "solved" for k in range(20)))
    assert made(problem, interpolated)[0].frames_used == 20
    # one that may lie a hundred metres away would stretch the map by as much
    sure = np.tile(np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3]) ** 2, (20, 1, 1))
    sure[9, :3, :3] *= 1e4
    place = np.array(found.poses.position)
    place[9] += [500.0, 0.0, 0.0]
    poses = replace(found.poses, covariance=sure, position=place)
    strayed, _ = made(problem, replace(interpolated, poses=poses))
    assert strayed.frames_used == 19 and strayed.grid.shape == made(problem, found)[0].grid.shape
    assert any("1 frame is not used" in words for words in strayed.warnings)
    far = replace(interpolated, poses=poses)
    assert np.isinf(found_views(problem, far).penalty).tolist() == [k == 9 for k in range(20)]
    assert np.isfinite(found_views(problem, far, CubePlan(adrift=1e3)).penalty).all()
    # a frame whose image tells nothing of its pose stays in use only where no other saw the band


def test_what_counts_as_blurred_and_as_good_ground_can_be_set(lvf):
    scenario, problem = lvf
    found = true_poses(scenario)
    blurred = replace(
        found, followed=replace(found.followed, sharpness=np.where(np.arange(20) == 4, 0.5, 1.0))
    )
    for plan, costs in ((None, True), (CubePlan(sharpness=0.4), False)):
        assert (found_views(problem, blurred, plan).penalty[4] > 0.0) == costs
    flat = np.random.default_rng(1).uniform([-7.0, -2.0], [7.0, 18.0], (400, 2))
    points = np.column_stack([flat, problem.surface.height_at(np.column_stack([flat, np.zeros(400)]))])
    found = true_poses(scenario, points)
    rough = replace(problem, surface=Plane(0.0), height_sigma=1.0)
    for margin, words in ((1.2, "heights of the"), (1e6, "the surface given")):
        ground = choose_ground(rough, found.poses, found.tracks, map_of(rough), "auto", margin)
        assert ground.words.startswith(words)


def test_fits_pictures_and_seams(lvf):
    scenario, problem = lvf
    summary, _ = made(problem, true_poses(scenario), CubePlan(bands=4, gsd=0.2))
    assert summary.pairs.shape[1] == 2 and len(summary.pair_rms_px) == len(summary.pairs) >= 6
    # pixels of the map are 0.4 of those of the frames: windows this small match to some tenths of them
    known = np.isfinite(summary.pair_rms_px)
    assert known.sum() >= 3
    assert np.nanmax(summary.pair_rms_px) * summary.gsd / scenario.options.gsd < 0.3
    assert summary.error_map.ndim == 2 and np.nanmax(summary.error_map) < 1.0
    assert summary.after.shape == summary.before.shape and summary.after.shape[2] == 3
    assert 0.0 < summary.seams.mean() < 0.5
    west, south, east, north = summary.extent
    assert east - west == pytest.approx(summary.gsd * summary.grid.shape[1]) and north > south


def test_what_cannot_be_made_is_refused(lvf):
    scenario, problem = lvf
    found = true_poses(scenario)
    for plan, words in (
        (replace(QUICK, bands=13), "from 1 to the 12 wavelengths"),
        (replace(QUICK, bands=(450.0, 1200.0)), "must be wavelengths from"),
        (replace(QUICK, bands=(500.0, 500.0)), "twice"),
    ):
        with pytest.raises(InputError, match=words):
            assemble_cube(problem, found, plan)
    with pytest.raises(InputError, match="must be one of auto, model, given"):
        CubePlan(surface="dem")
    with pytest.raises(InputError, match="positive number of metres"):
        CubePlan(gsd=-1.0)
    for wrong in (
        {"picture_nm": (650.0, 550.0)}, {"sharpness": -0.1}, {"adrift": np.nan}, {"surface_margin": 0.9},
        {"lines_per_step": 0.5}, {"fit_search_px": (0, 6)},
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"`{next(iter(wrong))}` must be"):
            CubePlan(**wrong)
    with pytest.raises(InputError, match="nothing to map"):
        assemble_cube(replace(problem, excluded=("dark",) * len(problem)), found, QUICK)
    up = replace(found.poses, world_from_body=found.poses.world_from_body * Rotation.from_euler("x", np.pi))
    with pytest.raises(InputError, match="nothing to map"):
        assemble_cube(problem, replace(found, poses=up), QUICK)
    mosaic = flight(filter="mosaic", pattern=2, frames=2)
    with pytest.raises(InputError, match="among the 4 wavelengths"):
        assemble_cube(problem_of(mosaic), true_poses(mosaic), replace(QUICK, bands=(470.0,)))
