"""The map and the bands that a cube will come to, by rough poses, before anything is solved.

Not here: making it (``frame_cube.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.applications.cube_ground import UsedGround, frame_outlines, given_heights
from sightline.applications.frame_cube import CubePlan, choose_bands, frame_views, map_of, pixel_size
from sightline.photogrammetry.flight.outlook import overlap_of
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.products.cube_bands import BandLayout
from sightline.products.cube_grid import CubeGrid
from sightline.products.frame_cube import covering_grid


def expected_cube(problem: SequenceProblem, plan: CubePlan) -> tuple[CubeGrid, BandLayout]:
    """The map and the bands that a plan would come to by the rough poses.

    Parameters
    ----------
    problem : SequenceProblem
    plan : CubePlan

    Raises
    ------
    InputError
        If the plan asks for what the camera does not see, or no frame looks at the ground.
    """
    views, system = frame_views(problem), map_of(problem)
    ground = UsedGround(given_heights(problem.surface, system), "", 0.0)
    outline, _ = frame_outlines(problem, system, ground, views)
    gsd = plan.gsd or pixel_size(problem, views, outline)
    overlap = overlap_of(problem)
    step = None if overlap is None else overlap.step / gsd
    layout = choose_bands(problem, plan, outline, gsd, step)
    return covering_grid(outline[np.isfinite(views.penalty)].reshape(-1, 2), system, gsd), layout
