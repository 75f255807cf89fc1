"""The page of a georeferenced sequence: what it says, odd flights, thousands of frames, a cube's slider."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
from sightline.errors import InputError
from sightline.geometry.earth import WGS84, from_geodetic, local_axes
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.flight.poses import FramePoses, RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.subset import Subset
from sightline.photogrammetry.flight.warnings import bow_warnings
from sightline.photogrammetry.sightings import Images, Tracks
from sightline.report import sequence_cube, sequence_page, sequence_words
from sightline.report.sequence_cube import CubeView
from sightline.report.sequence_figures import departure_figure, pose_sigma_figure, time_axis
from sightline.report.sequence_overlap_figure import NODES, shared_points
from sightline.report.sequence_trajectory_figure import trajectory_figure
from sightline.report.sequence_view import control_places, sequence_view
from sightline.simulate.sequence import sequence_case

SUMMARY = {"name": "flight <1>", "version": "0.4", "inputs": {"SEQUENCE.toml": "ab" * 32}}
HEIGHT, STEP, RATE = 80.0, 0.8, 25.0
#: px of focal length, m: what a pixel spans on the ground.
FOCAL = 250.0
GSD = HEIGHT / FOCAL


def flown(count, *, lines=1, idle=(), every=10, radii=None, sigma=None, per_frame=3, position_given=True):
    """A flight northwards at even speed on `lines` lines 40 m and 60 s apart, as if it had been solved.

    Each point lies under a frame and is seen by the 9 after it too, 0.1 px away from where it should.
    """
    each = count // lines
    line, place = np.arange(count) // each, np.arange(count) % each
    t = place / RATE + line * (each / RATE + 60.0)
    wave = 0.01 * np.stack([np.sin(t), np.cos(1.3 * t), np.sin(0.7 * t)], axis=1)
    position = np.stack([40.0 * line, STEP * place, np.full(count, HEIGHT)], axis=1) + wave
    attitude = Rotation.from_euler("z", 90.0, degrees=True) * Rotation.from_euler("x", 180.0, degrees=True)
    attitude = attitude * Rotation.from_rotvec(wave)
    rng = np.random.default_rng(0)
    given = position + np.array([0.0, 0.0, 2.0]) + rng.normal(size=(count, 3))
    points = np.repeat(position * [1.0, 1.0, 0.0], per_frame, axis=0)
    first = np.repeat(np.arange(count), per_frame)
    image = (first[:, None] + np.arange(10)).ravel()
    point = np.repeat(np.arange(len(points)), 10)
    kept = (image < count) & (line[np.minimum(image, count - 1)] == line[first[point]])
    kept &= ~np.isin(image, idle)
    image, point = image[kept], point[kept]
    if radii is not None:
        axes = local_axes(0.2, 0.9)
        origin = from_geodetic([[0.2, 0.9, 0.0]], radii)
        position, given, points = (origin + axes.apply(p) for p in (position, given, points))
        attitude = axes * attitude
    problem = SequenceProblem(
        frames=tuple(f"{k:05d}" for k in range(count)), t=t,
        sources=tuple(ArrayImage(np.zeros((2, 2))) for _ in range(count)),
        detector=AreaDetector("frame", (160, 200), FOCAL, (79.5, 99.5)), mount=NADIR_MOUNT,
        images=Images(np.zeros(count), np.arange(count), t, given, attitude),
        known=RoughPoses(
            np.full((count, 3), 1.0 if position_given else np.inf), np.full((count, 3), 0.01), 2.0, 0.02
        ),
        surface=Plane(0.0), height_sigma=1.0, readout_time=0.0, overlap=0.8, excluded=("",) * count,
        radii=radii,
    )  # fmt: skip
    sigma = [0.5, 0.5, 0.2, 1e-3, 1e-3, 2e-3] if sigma is None else sigma
    with np.errstate(invalid="ignore"):
        covariance = np.broadcast_to(np.diag(np.square(sigma)), (count, 6, 6)).copy()
    covariance[list(idle)] *= 9.0
    chosen = np.array([k for k in range(0, count, every) if k not in idle])
    poses = FramePoses(
        position, attitude, covariance, np.array([0.3, 0.1, 2.0, 1e-3, 2e-3, 0.0]),
        np.diag(np.square([1.99, 1.5, 0.2, 1e-3, 1e-3, 2e-3])), points, np.full((len(image), 2), 0.1),
        np.zeros(len(image), dtype=bool), np.bincount(image, minlength=count), np.ones(6), 1.0,
        np.full((lines, 3), 1e-4), 0.01, np.zeros((count - 1, 6, 6)), None,
    )  # fmt: skip
    followed = Followed(
        image, point, np.zeros((len(image), 2)), np.full(len(image), 0.1),
        np.where(place > 0, np.arange(count) - 1, -1), np.zeros((count, 4)), poses.sightings, np.ones(count),
        np.ones(count), ("",) * count,
    )  # fmt: skip
    marks = ["solved" if k in set(chosen.tolist()) else "estimated" for k in range(count)]
    reason = [""] * count
    for k in idle:
        marks[k], reason[k] = "interpolated", "looks like none of the frames before it"
    found = SequencePoses(
        poses, tuple(marks), tuple(reason),
        Subset(
            chosen, np.full(len(chosen), 0.8), np.full(len(chosen), 0.1), ("80% overlap",) * len(chosen)
        ),
        followed, Tracks(image, point, np.zeros((len(image), 2)), np.full(len(image), 0.1)), line,
        {"750 displacement and yaw": 2.0, "760 all poses": 6.0}, ("mind <this>",),
    )  # fmt: skip
    return problem, found


@pytest.fixture(scope="module")
def cube():
    """Three bands of noise, those before 2 px apart; a corner without values."""
    rng = np.random.default_rng(1)
    ground = rng.normal(size=(600, 700))
    after = np.stack([ground] * 3, axis=2)
    after[:50, :70] = np.nan
    before = np.stack([np.roll(ground, 2 * k, axis=1) for k in range(3)], axis=2)
    return CubeView(
        np.linspace(450.0, 900.0, 20), np.linspace(0.99, 1.0, 20), after, np.array([660.0, 560.0, 470.0]),
        0.1, before=before, error_px=np.full((60, 70), 0.2), pair_nm=np.linspace(20.0, 450.0, 40),
        pair_rms_px=np.full(40, 0.2), pair_before_px=np.full(40, 3.0),
    )  # fmt: skip


def said(text):
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))


def test_a_rendered_flight_is_described_in_words_that_are_its_numbers(tmp_path, open_page, cube):
    scenario = sequence_case("small", 3, frames=8)
    t, _, _ = scenario.poses
    options, count = scenario.options, 8
    known = RoughPoses(
        np.full((count, 3), options.position_sigma), np.full((count, 3), options.attitude_sigma),
        options.position_bias_sigma, options.attitude_bias_sigma,
    )  # fmt: skip
    problem = SequenceProblem(
        tuple(map(str, range(count))), t, tuple(ArrayImage(scenario.image(k)[0]) for k in range(count)),
        scenario.detector, NADIR_MOUNT,
        Images(np.zeros(count), np.arange(count), t, scenario.given_positions, scenario.given_attitudes),
        known,
        Plane(0.0), 1.0, 0.0, 0.8, ("",) * 3 + ("file cut short",) + ("",) * 4,
    )  # fmt: skip
    found = georeference_sequence(problem)
    path = tmp_path / "report.html"
    sequence_page.sequence_page(problem, found, SUMMARY, cube=cube).write(path)
    words = said(path.read_text(encoding="utf-8"))
    assert "8 frames over 0.28 s" in words and "1 interpolated" in words and "file cut short" in words
    view = sequence_view(problem, found)
    # the flight is 80 m over level ground of 3 % relief, and that wrong by the tables' noise
    assert view.depth == pytest.approx(80.0, rel=0.06)
    opened, problems = open_page(path)
    opened.wait_for_timeout(300)
    assert problems == []
    figures = opened.locator("svg.drawn")
    assert figures.count() == 8
    for k in range(figures.count()):
        box = figures.nth(k).bounding_box()
        assert box["width"] > 600 and box["height"] > 200
    assert opened.evaluate("document.documentElement.scrollWidth") <= 1280
    # the handle moves what is seen of the picture before
    cut = "getComputedStyle(document.querySelector('.slider .top')).clipPath"
    before = opened.evaluate(cut)
    opened.locator(".slider input").first.fill("80")
    assert opened.evaluate(cut) != before


def test_the_page_holds_all_it_needs_and_shows_names_as_text(cube):
    rest = sequence_page.sequence_page(*flown(60, idle=(20, 21)), SUMMARY, cube=cube).html
    addresses = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)["']""", rest)
    assert addresses and all(address.startswith(("#", "data:")) for address in addresses)
    assert not re.search(r"@import|url\((?!#)|fetch\(|https?://", rest)
    assert "flight &lt;1&gt;" in rest and "mind &lt;this&gt;" in rest


def test_sentences_and_tables_are_the_numbers_of_the_result():
    problem, found = flown(60, idle=(20, 21, 40))
    view = sequence_view(problem, found)
    text = " ".join(sequence_words.sentences(problem, found, view))
    assert "60 frames over 2.36 s and 47.2 m of path in one stretch of the flight" in text
    # of frames 0, 10, ... 50 two were left out
    assert "4 solved (the subset), 53 estimated" in text and "3 interpolated" in text
    assert "up 0.2 m; roll 0.057 deg" in text
    assert "position up +2.00 ± 0.20 m" in text and "Hardly observable: position north" in text
    assert "The data do not show the constant error of position east" in text
    assert "0.1 px rms per coordinate" in text and "None of the sightings were rejected" in text
    rows = sequence_words.idle_rows(problem, found, view)
    assert [row[:2] for row in rows] == [["00020 to 00021", "2"], ["00040", "1"]]
    assert sequence_words.stage_rows(found)[-1] == ["all", "8.00", "100", "133.3"]
    assert sequence_words.bow_rows(problem, found, view)[0][-1] == "observable"


def test_sigma_on_the_ground_is_that_of_place_and_tilt_together():
    problem, found = flown(30)
    view = sequence_view(problem, found)
    # straight down, 80 m: 0.5 m of place and 1 mrad of tilt about each level axis, not correlated
    expected = np.hypot(0.5, 1e-3 * HEIGHT) / GSD
    np.testing.assert_allclose(view.ground_sigma_px, expected, rtol=1e-3)
    # a tilt that makes up for the place: moves forward by 1 m as it pitches up (about y, right) by 1 / 80
    covariance = np.array(found.poses.covariance)
    form = np.array([0.0, 1.0, 0.0, 0.0, -1.0 / HEIGHT, 0.0])
    covariance[:] = np.outer(form, form)
    moved = sequence_view(problem, replace(found, poses=replace(found.poses, covariance=covariance)))
    assert moved.ground_sigma_px.max() < 0.05 / GSD
    form[4] *= -1.0
    covariance[:] = np.outer(form, form)
    moved = sequence_view(problem, replace(found, poses=replace(found.poses, covariance=covariance)))
    np.testing.assert_allclose(moved.ground_sigma_px[:, 0], 2.0 / GSD, rtol=0.02)


def test_an_earth_fixed_flight_is_shown_east_north_up():
    flat, round_ = (sequence_view(*flown(40, radii=radii)) for radii in (None, WGS84))
    np.testing.assert_allclose(np.ptp(round_.place, axis=0), np.ptp(flat.place, axis=0), atol=0.01)
    np.testing.assert_allclose(round_.departure, flat.departure, atol=1e-3)
    assert round_.origin == pytest.approx(np.degrees([0.2, 0.9]), abs=0.01)


def test_bow_that_nothing_tells_and_poses_that_nothing_ties_are_called_so():
    problem, found = flown(40, sigma=[np.inf, np.inf, np.inf, 1e-3, 1e-3, 1e-3], position_given=False)
    found = replace(found, poses=replace(found.poses, bow=np.array([[1e-4, np.inf, 1e-4]])))
    view = sequence_view(problem, found)
    text = " ".join(sequence_words.sentences(problem, found, view))
    assert "east not known" in text and "nothing ties east, north and up" in text
    assert "no table gives positions" in text and "The bow is not observable about pitch in stretch 1" in text
    assert sequence_words.bow_rows(problem, found, view)[0][-1] == "not observable about pitch"
    assert "positions are not tied" in trajectory_figure(view, np.zeros((0, 3)))[0, 0].title
    assert "not known: nothing ties it" in pose_sigma_figure(view, None).html("figure-a")


def test_bow_that_only_the_tables_hold_is_called_so():
    problem, found = flown(40)
    by_table = 0.01 / np.sqrt(40.0)
    found = replace(found, poses=replace(found.poses, bow=np.array([[1e-4, by_table, 1e-4]])))
    verdict = sequence_words.bow_rows(problem, found, sequence_view(problem, found))[0][-1]
    assert verdict == "observable; held by the given attitudes alone about pitch"


@pytest.mark.parametrize(
    ("count", "lines", "idle"), [(2, 1, ()), (3, 1, (1,)), (9, 1, tuple(range(9))), (80, 40, ())]
)
def test_odd_flights_have_every_figure(count, lines, idle):
    problem, found = flown(count, lines=lines, idle=idle, every=2)
    view = sequence_view(problem, found)
    drawn = sequence_page.sections(problem, found, view)
    assert [s.name for s in drawn] == ["trajectory", "residuals", "parameters", "sigma", "overlap"]
    for section in drawn:
        assert section.title and section.parts[0].endswith(".")
        # infinite or missing numbers are left out of the drawing, not written as text that no browser reads
        assert not re.search(r'"[^"]*\b(nan|inf)\b[^"]*"', section.figure.html("figure-a"))
    assert sequence_words.sentences(problem, found, view)


def test_every_axis_has_a_unit_and_points_of_control_are_drawn():
    problem, found = flown(60, lines=2)
    control = ControlPoints(np.arange(2), np.array([[0.0, 5.0, 0.0], [20.0, 9.0, 1.0]]), np.full(2, 0.1))
    problem = replace(problem, control=control)
    view = sequence_view(problem, found)
    np.testing.assert_allclose(control_places(problem, found), control.position)
    for section in sequence_page.sections(problem, found, view):
        titles = [axis.title for panel in section.figure.panels for axis in (panel.x, panel.y)]
        units = ("(m)", "(no.)", "(s)", "px", "deg", "m", "%", "number", "shortened")
        assert all(title and title.endswith((*units, "(logarithmic)")) for title in titles), titles
    assert any(mark.name == "control points" for mark in trajectory_figure(view, control.position).marks)


def test_pauses_are_shortened_and_times_stay_true():
    problem, found = flown(60, lines=2)
    view = sequence_view(problem, found)
    axis = time_axis(view, None)
    assert np.ptp(axis.x) < 0.1 * np.ptp(view.t)
    np.testing.assert_allclose(np.interp(axis.ticks, axis.x, view.t), [float(s) for s in axis.labels])
    assert "pauses" in axis.title and view.t[29] < 2.0 < view.t[30]
    # no line is drawn across the pause
    line = departure_figure(view, None)[0, 0].named("found")
    assert np.isnan(line.y).sum() == 1


def test_shared_points_are_counted_between_groups():
    problem, found = flown(60, idle=(25,))
    shared = shared_points(sequence_view(problem, found), found)
    # groups about frames 0, 10, ...; each point is seen in the 10 frames from its own on
    assert shared.frames.tolist() == [0, 10, 20, 30, 40, 50] and shared.size.sum() == 60
    image, point = found.tracks.image, found.tracks.point
    group = np.abs(np.arange(60)[:, None] - shared.frames).argmin(axis=1)[image]
    first, second = (set(point[group == k].tolist()) for k in (1, 2))
    assert shared.points[1, 2] == shared.points[2, 1] == len(first & second) > 0
    assert shared.points[1, 1] == len(first) and shared.points[0, 3] == 0


def test_thousands_of_frames_make_a_small_page(cube):
    problem, found = flown(6000, lines=3, idle=(17, 4000), every=20)
    text = sequence_page.sequence_page(problem, found, SUMMARY, cube=cube).html
    assert len(text) < 1e6
    view = sequence_view(problem, found)
    assert len(shared_points(view, found).frames) <= NODES
    # a spike of one frame is still in a curve thinned out
    covariance = np.array(found.poses.covariance)
    covariance[5777] *= 1e4
    view = sequence_view(problem, replace(found, poses=replace(found.poses, covariance=covariance)))
    figure = pose_sigma_figure(view, None)
    assert np.nanmax(figure[0].named("up").y) == pytest.approx(20.0)


def test_the_cube_is_shown_as_it_is(cube):
    overview, detail = sequence_cube.sliders(cube)
    assert (overview.width, overview.height) == (233, 200) and overview.before is not None
    assert (detail.width, detail.height) == (250, 150) and detail.after != detail.before
    text = " ".join(sequence_cube.cube_sentences(cube))
    assert "20 bands from 450 to 900 nm of 600 rows × 700 columns" in text and "99.0 to 100.0 %" in text
    assert (
        "to 0.2 to 0.2 px rms per axis in those 40 pairs" in text
        and "given poses all would have 3 px rms" in text
    )
    sections = sequence_page.cube_sections(cube)
    assert [s.name for s in sections] == ["band-error", "band-pairs", "coverage"]
    bare = replace(cube, before=None, error_px=None, pair_nm=np.zeros(0), pair_rms_px=np.zeros(0),
                   pair_before_px=None)  # fmt: skip
    assert [s.name for s in sequence_page.cube_sections(bare)] == ["coverage"]
    assert sequence_cube.sliders(bare)[0].before is None
    with pytest.raises(InputError, match="shape of `after`"):
        replace(cube, before=np.zeros((3, 3, 3)))


def test_tall_ground_is_laid_on_its_side(cube):
    tall = replace(cube, after=np.array(cube.after[:, :80]), before=None, error_px=np.full((60, 8), 0.2))
    overview = sequence_cube.sliders(tall)[0]
    assert (overview.width, overview.height) == (600, 80) and "first row is at the left" in overview.caption
    figure = sequence_cube.error_map_figure(tall)
    assert figure[0].x.title == "from the first row (m)"


def test_pixels_that_lack_a_band_are_grey_and_sizes_are_those_of_the_maps(cube):
    coded = np.full((4, 5, 3), 100, dtype=np.uint8)
    coded[0, 0], coded[1, 2, 0], coded[3, 4, 1:] = 0, 0, 0  # none, two, and one of the bands are there
    lacking = {(0, 0), (1, 2), (3, 4)}
    picture = sequence_cube._picture(coded)
    assert set(zip(*np.nonzero(np.isnan(picture).any(axis=2)), strict=True)) == lacking
    assert set(zip(*np.nonzero(np.isnan(picture).all(axis=2)), strict=True)) == lacking
    # a picture of 600 x 700 px of 0.1 m that shows a part of maps of 1500 x 1600 px of 0.05 m
    part = replace(cube, map_shape=(1500, 1600), gsd=0.05)
    caption = sequence_cube.sliders(part)[0].caption
    assert "60 m down × 70 m across, of the 75 m × 80 m of the maps" in caption
    figure = sequence_cube.error_map_figure(part)
    (shown,) = figure.marks
    assert 79.0 < shown.x[-1] < 80.0 and 74.0 < shown.y[-1] < 75.0
    apart = np.full((9, 9, 3), np.nan)
    apart[:5, :, 0], apart[5:, :, 1:] = 1.0, 1.0
    assert sequence_cube.sliders(replace(cube, after=apart, before=None)) == []


def test_a_bow_that_is_warned_of_is_not_called_observable():
    problem, found = flown(40)
    # an even trend of rms s ends at s times the root of 3: this one moves the ground there by 2 px
    sigma = 2.0 / np.sqrt(3.0) / FOCAL
    loose = replace(problem, known=replace(problem.known, attitude=np.full((40, 3), 1.0)))
    poses = replace(found.poses, bow=np.array([[1e-4, sigma, 1e-4]]))
    found = replace(found, poses=poses)
    view = sequence_view(loose, found)
    assert bow_warnings(loose, poses)
    assert sequence_words.bow_rows(loose, found, view)[0][-1] == "known to 2 px at the ends only"
    assert "so that the flight may be bent: 1 sigma" in " ".join(sequence_words.sentences(loose, found, view))
