"""Small rendered flights of filter cameras with everything known of them, for tests of the cube."""

from __future__ import annotations

import numpy as np

from sightline.applications.sequence_poses import SequencePoses
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.geometry.surface import Dem
from sightline.imaging.source import ArrayImage
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.poses import FramePoses, RoughPoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.subset import Subset
from sightline.photogrammetry.sightings import Images, Tracks
from sightline.simulate.sequence import SequenceScenario, sequence_case

SMALL = {"frames": 20, "shape": (96, 112), "focal_length_px": 150.0, "overlap": 0.95, "spectra": "law"}


def flight(**overrides: object) -> SequenceScenario:
    return sequence_case("small", 3, **{**SMALL, **overrides})


def problem_of(scenario: SequenceScenario) -> SequenceProblem:
    """The flight with what is rough about it, over its true ground."""
    (t, _, _), count = scenario.poses, len(scenario.poses[0])
    pictures = [scenario.image(k) for k in range(count)]
    relief, options = scenario.ground.relief, scenario.options
    colour = options.filter == "rgb"
    return SequenceProblem(
        tuple(map(str, range(count))), t, tuple(ArrayImage(p.mean(axis=0)) for p in pictures),
        scenario.detector, NADIR_MOUNT,
        Images(np.zeros(count), np.arange(count), t, scenario.given_positions, scenario.given_attitudes),
        RoughPoses(np.ones((count, 3)), np.ones((count, 3))), Dem(relief.heights, relief.transform), 0.0,
        options.readout_time, 0.8, ("",) * count,
        mosaic_nm=scenario.filter.given_nm[0] if options.filter == "mosaic" else None,
        channel_nm=tuple(scenario.filter.given_nm[:, 0, 0]) if colour else (),
        channels=tuple(tuple(ArrayImage(c) for c in p) for p in pictures) if colour else (),
    )  # fmt: skip


def true_poses(scenario: SequenceScenario, points: np.ndarray | None = None) -> SequencePoses:
    """What is found when everything is: true poses, and points on the ground each seen in two frames."""
    t, position, attitude = scenario.poses
    count = len(t)
    points = np.full((1, 3), np.nan) if points is None else points
    n = len(points)
    tracks = Tracks(
        np.repeat([0, 5], n),
        np.tile(np.arange(n), 2),
        np.repeat([[60.0, 50.0], [30.0, 50.0]], n, axis=0),
        0.1,
    )
    none = np.zeros(count, dtype=np.intp)
    poses = FramePoses(
        position=position, world_from_body=attitude, covariance=np.zeros((count, 6, 6)), bias=np.zeros(6),
        bias_covariance=np.zeros((6, 6)), points=points, residual_px=np.zeros((2 * n, 2)),
        rejected=np.zeros(2 * n, np.bool_), sightings=none + 9, roughness=np.ones(6), scale=1.0,
        bow=np.zeros((1, 3)), scale_sigma=0.01, next_covariance=np.zeros((count - 1, 6, 6)),
        pair_covariance=None,
    )  # fmt: skip
    followed = Followed(
        tracks.image, tracks.point, tracks.pixels, tracks.sigma_px, none, np.zeros((count, 4)), none,
        np.ones(count), np.ones(count), ("",) * count,
    )  # fmt: skip
    subset = Subset(np.arange(2), np.zeros(2), np.zeros(2), ("", ""))
    return SequencePoses(poses, ("solved",) * count, ("",) * count, subset, followed, tracks, none)
