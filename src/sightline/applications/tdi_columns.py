"""The camera of one band as TDI sees it: of the reference attitude, with the statics that were recovered.

Not here: velocity and slip of its columns (``tdi/scan_columns.py``), the choice (``tdi/choose.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sightline.applications.registration import recovered_cameras
from sightline.errors import InputError
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.trajectory import Motion
from sightline.motion.band import Band


def band_camera(
    bands: Sequence[Band], name: str, statics: Mapping[str, float] | None = None
) -> PushbroomCamera:
    """Camera of a band without a motion, its offset and rotation as recovered where they are given.

    Parameters
    ----------
    bands : sequence of Band
        Of an acquisition.
    name : str
    statics : mapping, optional
        Name of a static parameter to its value.

    Raises
    ------
    InputError
        No band of that name; images that are not made line by line.
    """
    if not bands:
        raise InputError("the acquisition has frames, no bands: TDI needs a push-broom detector, a [[band]]")
    names = [band.name for band in bands]
    if name not in names:
        raise InputError(f"no band is called {name!r}: the bands are {', '.join(names)}; name one of them")
    band = bands[names.index(name)]
    still = Motion.zero(*band.camera.trajectory.span)
    return recovered_cameras([band], still, statics or {})[0]


def strip_span(camera: PushbroomCamera) -> tuple[float, float]:
    """s; when the first and the last line of a band are exposed."""
    first, last = camera.times([0.0, camera.lines - 1.0])
    return float(min(first, last)), float(max(first, last))
