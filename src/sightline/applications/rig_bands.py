"""Bands of one capture of a rig, laid on its first camera.

Not here: maps of a flight (``frame_cube.py``), the offsets (``photogrammetry/flight/rig_solver.py``), files.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from sightline.applications.sequence_poses import SequencePoses
from sightline.errors import InputError
from sightline.geometry.conjugate import predict_match
from sightline.imaging.source import ImageSource
from sightline.matching.on_geometry import resampled
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rig import given_offsets
from sightline.photogrammetry.flight.rig_matches import rig_cameras
from sightline.photogrammetry.sightings import Images


@dataclass(frozen=True, eq=False)
class LaidBand:
    """A band of one capture in the geometry of the first camera.

    Attributes
    ----------
    name : str
    wavelength_nm : float
        NaN: all light.
    source : ImageSource
        Resampled where it is read; NaN where the camera does not see.
    """

    name: str
    wavelength_nm: float
    source: ImageSource


def registered_bands(
    problem: SequenceProblem, found: SequencePoses, capture: int = 0, *, refined: bool = True
) -> tuple[LaidBand, ...]:
    """All bands of a capture on its first camera, over the surface given.

    Parameters
    ----------
    problem : SequenceProblem
        With a rig.
    found : SequencePoses
    capture : int
    refined : bool
        By the offsets found; False: by those given.
    """
    if not problem.rig or found.rig is None:
        raise InputError(
            "bands are laid on one another for the cameras of a rig; this sequence has one camera"
        )
    offsets = found.rig.offsets if refined else given_offsets(problem.rig)
    images = Images(
        problem.images.camera, problem.images.shot, problem.images.t, found.poses.position,
        found.poses.world_from_body,
    )  # fmt: skip
    cameras = rig_cameras(images, problem.rig, offsets, capture)
    out = []
    for c, camera in enumerate(problem.rig):
        if not camera.usable[capture]:
            continue
        channels = list(zip(camera.channel_nm, camera.channels, strict=True))
        for nm, sources in channels or [(camera.wavelength_nm, camera.sources)]:
            source = sources[capture]
            if c:
                geometry = partial(predict_match, cameras[0], cameras[c], problem.surface)
                source = resampled(source, geometry, cameras[0].shape)
            name = f"{camera.name} {nm:g} nm" if len(channels) > 1 else camera.name
            out.append(LaidBand(name, float(nm), source))
    return tuple(out)
