"""The focal length as an unknown beside the poses of frames: derivatives, honesty, what tells it, blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.photogrammetry.flight.test_poses import FOCAL, SHAPE, SIGMA_PX, Flight

from consistency import assert_consistent, assert_possible
from sightline.applications import sequence_poses
from sightline.applications.frame_cube import found_views
from sightline.applications.sequence_poses import SequencePoses, poses_of_windows
from sightline.errors import EstimationError, InputError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.descent import BlockSums, State
from sightline.photogrammetry.block.point_priors import HeightPrior, PointPriors
from sightline.photogrammetry.flight import blocks as sequence_blocks
from sightline.photogrammetry.flight import poses as frame_poses
from sightline.photogrammetry.flight import solver as sequence_solver
from sightline.photogrammetry.flight.focal import FocalStretch
from sightline.photogrammetry.flight.poses import FramePoses, adjust_frames, frame_unknowns
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.subset import Subset
from sightline.photogrammetry.flight.warnings import focal_verdict, focal_warnings, refuse_unobservable_focal
from sightline.photogrammetry.sightings import (
    Images,
    Tracks,
    as_index,
    sight_frames,
    stretched_sightings,
)
from sightline.products.cube_plan import frame_views

MIDDLE = ((SHAPE[0] - 1) / 2.0, (SHAPE[1] - 1) / 2.0)
#: Lens of the third test: at the corner of a frame it moves points by 6 px.
DISTORTION = -0.25


def camera(focal: float, distortion: tuple[float, ...] = ()) -> AreaDetector:
    return AreaDetector("frame", SHAPE, focal, MIDDLE, distortion)


def solved(flight: Flight, given: float, sigma: float, **changed) -> FramePoses:
    """Poses by a given focal length, of the relative sigma given with it."""
    known = replace(flight.known, focal_length=sigma, **changed)
    sightings = sight_frames(flight.images, [camera(given)], [NADIR_MOUNT], flight.tracks)
    # heights are drawn over +-3 m: 1.7 m rms
    heights = PointPriors(HeightPrior(Plane(0.0), 1.75, None))
    return adjust_frames(flight.images, sightings, known, priors=heights)


def test_sightings_change_with_the_focal_length_as_pixels_of_a_pinhole_do():
    flight = Flight(0, count=3)
    known = replace(flight.known, focal_length=0.02)
    unknowns = frame_unknowns(flight.images, known, np.ones(6))
    assert unknowns.names[-1] == "stretch_1" and unknowns.width == 7
    rng = np.random.default_rng(0)
    stretch, own = 0.013, 0.1 * rng.standard_normal((3, 6))
    common = np.append(np.zeros(6), stretch)
    sightings = sight_frames(flight.images, [camera(FOCAL)], [NADIR_MOUNT], flight.tracks)
    block = BlockSums(sightings, unknowns, None)
    ground = rng.uniform([-20.0, -20.0, -40.0], [20.0, 20.0, 0.0], (sightings.points, 3))
    x = unknowns.departures(own, common)

    def pixels(focal: float) -> np.ndarray:
        # written out once more: forward, right, down of the body; lines forward, columns to the left
        out = []
        for k, n in zip(flight.tracks.image, flight.tracks.point, strict=True):
            body = flight.images.world_from_body[k] * Rotation.from_rotvec(x[k, :3])
            away = ground[n] - flight.images.position[k] - x[k, 3:6]
            forward, right, down = body.inv().apply(away)
            out.append(np.array(MIDDLE) + focal * np.array([forward, -right]) / down)
        return np.array(out)

    state = State(common, own, ground - block.origin)
    weight = np.ones(len(sightings))
    curvature, residual = block.curvature(state, weight)
    expected = (flight.tracks.pixels - pixels(FOCAL * (1.0 + stretch))) / SIGMA_PX
    assert residual == pytest.approx(expected, abs=1e-6)
    step = 1e-5
    slope = pixels(FOCAL * (1.0 + stretch + step)) - pixels(FOCAL * (1.0 + stretch - step))
    slope /= 2.0 * step * SIGMA_PX
    # linear in the focal length: differences err by rounding alone, 1e-16 of 1e3 px over the step
    assert curvature.rows[:, :, 6] == pytest.approx(slope, rel=1e-6, abs=1e-4)


def test_the_lens_is_undone_by_the_focal_length_found():
    rng = np.random.default_rng(1)
    tangents = rng.uniform(-0.3, 0.3, (50, 2))
    true, stretch = 1.03 * FOCAL, 0.03
    bent = tangents * (1.0 + DISTORTION * (tangents**2).sum(axis=1, keepdims=True))
    seen = np.array(MIDDLE) + true * bent[:, ::-1]  # lines with y, columns with x of the camera
    one = Images(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros((1, 3)), Rotation.identity(1))
    tracks = Tracks(np.zeros(50), np.arange(50), seen, np.array(1.0))
    found = sight_frames(one, [camera(true, (DISTORTION,))], [NADIR_MOUNT], tracks)
    again = stretched_sightings(found, stretch)
    # what a stretch of so much predicts of the same rays
    assert again.tangents == pytest.approx((1.0 + stretch) * found.tangents)
    assert np.abs(found.tangents) == pytest.approx(np.abs(tangents), abs=1e-9)
    plain = sight_frames(one, [camera(true / (1.0 + stretch), (DISTORTION,))], [NADIR_MOUNT], tracks)
    # at the corner the given lens undoes 0.25 * 3 * 0.18 of the stretch too much: 0.5 px
    assert np.abs(plain.tangents - again.tangents).max() * FOCAL > 0.2


def test_a_wrong_given_focal_length_is_corrected_and_all_sigmas_hold():
    # given wrong by a draw of 1 %; the middle frame gives all of a flight's datum. Forty draws of one number
    # reject no factor of sigma: validation/sequence_focal.py pools 300
    nees, focal, sigma = [], [], []
    for seed in range(40):
        flight = Flight(seed, bias=(0.1, 0.01))
        given = FOCAL * (1.0 + 0.01 * np.random.default_rng(1000 + seed).standard_normal())
        found = solved(flight, given, 0.01)
        error = flight.errors(found)[15]
        nees.append(error @ np.linalg.solve(found.covariance[15], error))
        assert found.focal is not None
        sigma.append(found.focal.sigma)
        focal.append((found.detector(camera(given)).focal_length_px - FOCAL) / given / found.focal.sigma)
    assert_consistent(nees, 6)
    assert_possible(np.sum(np.square(focal)), len(focal), chance=1e-3)
    # positions above level ground: 0.3 m of noise and 0.1 m of bias of 100 m
    assert np.median(sigma) < 0.006


def test_what_is_not_known_of_the_focal_length_is_in_the_heights_of_all_frames():
    flight = Flight(3)
    kept, found = (solved(flight, FOCAL, sigma) for sigma in (0.0, 0.01))
    assert kept.focal is None and found.focal is not None
    more = np.sqrt(found.covariance[:, 2, 2] - kept.covariance[:, 2, 2])
    # ground sizes are known from positions: the flying height goes with the focal length, as far as
    # positions' own bias of 1 m lets it
    assert (more > 0.1).all() and found.focal.sigma < 0.01
    assert found.focal.with_bias[2] != 0.0


def test_without_given_heights_it_is_hardly_observable():
    flight = Flight(4)
    position = np.array(flight.known.position)
    position[:, 2] = np.inf
    found = solved(flight, 1.01 * FOCAL, 0.01, position=position, position_bias=0.0)
    # perspective alone, of attitudes that are given to 3 mrad
    assert found.focal is not None and found.focal.sigma > 0.7 * 0.01
    assert abs(found.focal.stretch + 0.0099) < 4.0 * found.focal.sigma
    assert focal_verdict(found.focal) == "hardly observable"
    problem = small_problem(flight, 1.01 * FOCAL, 0.01)
    (words,) = focal_warnings(problem, found)
    assert "hardly observable" in words and "beforehand to 1 %" in words


def test_a_focal_length_of_which_nothing_was_said_is_found_where_heights_tell_it():
    flight = Flight(5, bias=(0.05, 0.01))
    found = solved(flight, 1.08 * FOCAL, np.inf)
    assert found.focal is not None and found.focal.prior == np.inf
    px = found.detector(camera(1.08 * FOCAL)).focal_length_px
    assert abs(px - FOCAL) < 4.0 * 1.08 * FOCAL * found.focal.sigma < 0.05 * FOCAL
    assert focal_verdict(found.focal) == "observable"


def test_one_that_rests_on_perspective_alone_is_refused():
    loose = FocalStretch(-0.05, 0.04, np.inf, np.zeros(6))
    poses = solved(Flight(0, count=3), FOCAL, 0.0)
    with pytest.raises(EstimationError, match=r"known to 4 % at best.*focal_length_sigma_px"):
        refuse_unobservable_focal(replace(poses, focal=loose))
    with pytest.raises(EstimationError, match="-97 % from the one given"):
        refuse_unobservable_focal(replace(poses, focal=replace(loose, stretch=-0.97, sigma=0.01)))
    for given in (None, replace(loose, sigma=0.02), replace(loose, prior=0.05)):
        refuse_unobservable_focal(replace(poses, focal=given))


def test_one_far_from_what_was_given_is_reported():
    far = FocalStretch(-0.05, 0.002, 0.01, np.zeros(6))
    flight = Flight(0, count=3)
    problem = small_problem(flight, FOCAL, 0.01)
    poses = replace(solved(flight, FOCAL, 0.01), focal=far)
    (words,) = focal_warnings(problem, poses)
    assert "380 px" in words and "5.0 of its sigmas" in words


def test_where_no_solution_is_found_with_it_that_is_said(monkeypatch):
    plain = frame_poses.descend

    def only_kept(block, *given, **more):
        if block.unknowns.width == 7:
            raise EstimationError("no")
        return plain(block, *given, **more)

    monkeypatch.setattr(frame_poses, "descend", only_kept)
    with pytest.raises(EstimationError, match="give a smaller focal_length_sigma_px"):
        solved(Flight(0, count=6), FOCAL, 0.01)


@pytest.mark.parametrize("sigma", [-0.01, np.nan])
def test_a_sigma_that_is_none_is_refused(sigma):
    with pytest.raises(InputError, match="focal_length"):
        replace(Flight(0, count=3).known, focal_length=sigma)


def small_problem(flight: Flight, given: float, sigma: float) -> SequenceProblem:
    count = len(flight.t)
    blank = ArrayImage(np.zeros(SHAPE))
    return SequenceProblem(
        tuple(map(str, range(count))), flight.t, (blank,) * count, camera(given), NADIR_MOUNT, flight.images,
        flight.known, Plane(0.0), 1.75, 0.0, 0.8, ("",) * count, focal_length_sigma_px=sigma * given,
    )  # fmt: skip


def followed_of(flight: Flight) -> Followed:
    """Its sightings, each point's in order, points numbered as they are first seen."""
    tracks, count = flight.tracks, len(flight.t)
    names, first = np.unique(tracks.point, return_index=True)
    # rows are in the order of images
    rank = np.argsort(np.argsort(first))
    point = rank[np.searchsorted(names, tracks.point)]
    order = np.lexsort((tracks.image, point))
    nothing = np.full(count, np.nan)
    return Followed(
        as_index(tracks.image[order], "image"), as_index(point[order], "point"), tracks.pixels[order],
        tracks.sigma_px[order], np.arange(count) - 1, np.full((count, 4), np.nan),
        np.bincount(tracks.image, minlength=count), nothing, nothing, ("",) * count,
    )  # fmt: skip


def test_blocks_joined_find_the_focal_length_of_the_whole(monkeypatch):
    # each is lost after 12 frames and found anew: blocks of 40 overlap by 12
    flight = Flight(6, count=120, life=12, bias=(0.1, 0.01))
    problem, followed = small_problem(flight, 1.01 * FOCAL, 0.01), followed_of(flight)
    monkeypatch.setattr(sequence_solver, "_NOISE_ROUNDS", 0)
    whole, _ = poses_of_windows(problem, followed)
    monkeypatch.setattr(sequence_poses, "BLOCK_FRAMES", 40)
    monkeypatch.setattr(sequence_blocks, "_LEAST_SIGHTINGS", 100)
    parts, _ = poses_of_windows(problem, followed)
    assert whole.focal is not None and parts.focal is not None
    # the roughness of the path is each block's own
    assert parts.focal.stretch == pytest.approx(whole.focal.stretch, abs=0.2 * whole.focal.sigma)
    assert parts.focal.sigma == pytest.approx(whole.focal.sigma, rel=0.1)
    sigma = np.sqrt(np.einsum("kii->ki", whole.covariance))
    turn = (whole.world_from_body.inv() * parts.world_from_body).as_rotvec()
    apart = np.concatenate([parts.position - whole.position, turn], axis=1)
    assert np.abs(apart / sigma).max() < 0.5


def test_the_cube_looks_through_the_camera_that_was_found():
    flight = Flight(0, count=6)
    problem = small_problem(flight, 1.01 * FOCAL, 0.01)
    poses = solved(flight, 1.01 * FOCAL, 0.01)
    found = SequencePoses(
        poses, ("estimated",) * 6, ("",) * 6, Subset(*([np.zeros(0)] * 3), ()), followed_of(flight),
        flight.tracks, np.zeros(6, dtype=np.intp),
    )  # fmt: skip
    assert poses.focal is not None
    px = 1.01 * FOCAL * (1.0 + poses.focal.stretch)
    assert found_views(problem, found).detector.focal_length_px == pytest.approx(px)
    # by the rough poses, the one given
    assert frame_views(problem).detector.focal_length_px == 1.01 * FOCAL
