"""Poses of few frames far apart, in rounds: what stands where the last rounds do not settle."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from sightline.errors import EstimationError
from sightline.photogrammetry.flight.start import approached
from sightline.photogrammetry.sightings import Tracks


def test_sightings_are_those_that_the_poses_are_of_where_a_round_fails():
    tracks = Tracks(np.arange(20) % 4, np.arange(20) // 4, np.zeros((20, 2)), np.array(0.5))
    given = []

    def solve(weighed, before):
        given.append(weighed)
        if len(given) == 2:
            raise EstimationError("too weak")
        return SimpleNamespace(rejected=np.arange(len(weighed)) < 7)

    counted, poses, words = approached(solve, tracks, 200)
    assert len(given[1]) == 13  # what was far from the first poses is left out of the second round
    assert len(counted) == len(poses.rejected) == 20 and counted is given[0]
    assert "geometry is weak" in words[0] and "6" in words[0]  # .03 of 200 px
