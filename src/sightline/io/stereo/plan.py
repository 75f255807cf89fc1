"""``[plan]`` of a STEREO.toml: a pass that is not flown yet, as a StereoPlan.

Not here: its bound (``applications/stereo_prediction.py``), what it is simulated with (``simulate/``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sightline.applications.expected_cost import prediction_cost
from sightline.errors import FormatError, SightlineError
from sightline.geometry.earth import WGS84
from sightline.geometry.orbit_pair import OrbitPair
from sightline.geometry.surface import Ellipsoid
from sightline.io.acquisition.acquired import input_files, sha256
from sightline.io.stereo.load import camera_sections, read_stereo_file, stereo_detector
from sightline.io.stereo.schema import StereoFile
from sightline.photogrammetry.block.point_priors import HeightPrior
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.settings import SIGMA_PX, StereoPlan
from sightline.result import set_source


@dataclass(frozen=True, eq=False)
class PlannedPass:
    """A ``[plan]`` with what only its page needs.

    Attributes
    ----------
    path : Path
    name : str
        Title of the report.
    plan : StereoPlan
    """

    path: Path
    name: str
    plan: StereoPlan

    def input_hashes(self) -> dict[str, str]:
        """SHA-256 of the file by its name."""
        return {self.path.name: sha256(self.path)}


def has_plan(path: Path) -> bool:
    """Whether a STEREO.toml plans a pass instead of naming poses."""
    return read_stereo_file(path).plan is not None


def read_plan(path: Path) -> PlannedPass:
    """The planned pass of a STEREO.toml.

    Parameters
    ----------
    path : Path

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed.
    """
    file = read_stereo_file(path)
    with input_files(path, file):
        planned = _plan(path, file)
    set_source(planned.plan, planned)
    return planned


def _plan(path: Path, file: StereoFile) -> PlannedPass:
    """The pass of the file."""
    if file.plan is None or file.camera is None:
        raise FormatError(f"{path}: has no [plan]; add it, with [camera] and [noise]")
    plan, radii = file.plan, file.surface.radii or WGS84
    try:
        prediction_cost(plan.cameras, plan.shots, plan.points).check()
        pair = OrbitPair(
            altitude=plan.altitude,
            inclination=float(np.radians(plan.inclination_deg)),
            latitude=float(np.radians(plan.latitude_deg)),
            separation=plan.separation,
            cameras=plan.cameras,
            cross_track=plan.cross_track,
            radii=radii,
            aim_height=file.surface.height,
        )
        t = pair.shot_times(plan.window, plan.shots, plan.offset)
        pair.positions(t)
    except SightlineError as problem:
        raise FormatError(f"{path}: [plan]: {problem}") from None
    names = tuple(str(k + 1) for k in range(plan.cameras))
    cameras = camera_sections(file.camera, names, path)
    aimed = file.noise.attitude_knowledge == "from-position"
    if aimed and plan.cameras != 2:
        raise FormatError(
            f'{path}: attitude_knowledge = "from-position" is for two cameras, [plan] has {plan.cameras}; '
            'say "independent"'
        )
    sigma = file.surface.height_sigma
    return PlannedPass(
        path,
        file.stereo.name,
        StereoPlan(
            pair=pair,
            detectors=tuple(stereo_detector(name, s) for name, s in zip(names, cameras, strict=True)),
            mounts=tuple(section.mounting for section in cameras),
            noise=PoseNoise(
                file.noise.sigma_position, file.noise.sigma_attitude, pair.aim_point if aimed else None
            ),
            sigma_px=file.noise.sigma_px or SIGMA_PX,
            window=plan.window,
            shots=plan.shots,
            offset=plan.offset,
            points=plan.points,
            scene_size=plan.scene_size,
            heights=HeightPrior(Ellipsoid(*radii, file.surface.height), sigma, radii)
            if sigma > 0.0
            else None,
            cameras=names,
        ),
    )


def describe_plan(planned: PlannedPass) -> dict[str, object]:
    """A plan in words: ``understood``, ``missing``, ``observable``, lists of sentences."""
    plan, pair = planned.plan, planned.plan.pair
    t = pair.shot_times(plan.window, plan.shots, plan.offset)
    place = pair.positions(t)
    apart = float(np.linalg.norm(place[0] - place[-1], axis=1).mean())
    convergence = np.degrees(pair.convergence(t))
    understood = [
        f"{planned.name}: a plan of {pair.cameras} spacecraft at {pair.altitude / 1e3:g} km, {plan.shots} "
        f"shots in {plan.window:g} s",
        f"the first and the last are {apart / 1e3:.4g} km apart; their axes converge at "
        f"{convergence.min():.3g} to {convergence.max():.3g} degrees",
        f"{plan.points} points, found to {plan.sigma_px:g} px",
    ]
    return {
        "understood": understood,
        "missing": [],
        "observable": ["run `sightline orient --predict` for the bounds of every angle"],
    }
