"""What is said where frames could not be followed from one to the next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.io.sequence_files import flight

from sightline.io.sequence.load import load_sequence
from sightline.matching.follow import Followed
from sightline.photogrammetry.flight.start import begun


def linked(steps: np.ndarray) -> Followed:
    """Frames linked each to the one before by features, moved by steps (M, 4)."""
    count, none = len(steps), np.zeros(0, dtype=np.intp)
    before = np.arange(count) - 1
    return Followed(
        none, none, np.zeros((0, 2)), np.zeros(0), before, np.where(before[:, None] < 0, np.nan, steps),
        np.full(count, 100), np.ones(count), np.ones(count), ("",) * count, True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        # of 24 lines: 1 - 2.64 / 24, and 1 - 18 / 24
        (2.64, "share about 89%, but are 3 px and 0 degrees of turn apart, too much to be followed"),
        (18.0, "overlap too little to be followed (about 25%)"),
    ],
)
def test_a_long_step_is_not_called_little_overlap(tmp_path: Path, lines: float, said: str):
    problem = load_sequence(flight().write(tmp_path))
    # no attitudes: nothing is turned
    known = replace(problem.known, attitude=np.full_like(problem.known.attitude, np.inf))
    steps = np.tile([lines, 0.0, 0.0, 0.0], (len(problem), 1))
    words = begun(replace(problem, known=known), linked(steps)).warnings
    assert len(words) == 1 and said in words[0] and "found by features" in words[0]
