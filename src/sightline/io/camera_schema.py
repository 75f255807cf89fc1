"""What STEREO.toml and SEQUENCE.toml may say of the camera of a frame, alike in both.

Not here: the camera of an ACQUISITION.toml (``io/acquisition/schema.py``), whose lens may be estimated in
parts.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.rotations import NADIR_MOUNT
from sightline.io.acquisition.schema import SchemaSection
from sightline.io.quantities import (
    Distortion,
    FocalSigmaPx,
    PixelPlace,
    UnitQuaternion,
)

#: By how many times no lens stretches the frame.
_MOST_STRETCH = 3.0
#: Degrees; no lens that maps planes to planes sees more, while a focal length in mm taken for pixels does.
_WIDEST = 120.0


class FrameCameraSection(SchemaSection):
    """How a camera sits in the body, and its lens."""

    mount: Literal["nominal"] = Field(default="nominal", description="Lines forward, columns left")
    body_from_camera: UnitQuaternion | None = Field(
        default=None, description="[x, y, z, w] in place of the nominal mount"
    )
    focal_length_sigma_px: FocalSigmaPx = Field(
        default=0.0, description="How well it is known, to be refined; 0 = exactly"
    )
    focal_length: Literal["estimate"] | None = Field(
        default=None, description='"estimate": refine it freely, starting from focal_length_px'
    )
    principal_point_px: tuple[PixelPlace, PixelPlace] | None = Field(
        default=None, description="(line, column); default the centre of the frame"
    )
    distortion: Annotated[list[Distortion], Field(max_length=5)] = Field(
        default=[], description="k1, k2, p1, p2, k3 in normalised coordinates"
    )

    @model_validator(mode="after")
    def _said_once(self) -> FrameCameraSection:
        if self.body_from_camera is not None and "mount" in self.model_fields_set:
            raise ValueError("mount and body_from_camera are both given; keep one of them")
        if self.focal_length == "estimate" and self.focal_length_sigma_px > 0.0:
            raise ValueError(
                'focal_length = "estimate" takes no focal_length_sigma_px; keep one of them: a sigma, or none'
            )
        return self

    @property
    def mounting(self) -> Rotation:
        """body <- camera."""
        return NADIR_MOUNT if self.body_from_camera is None else Rotation.from_quat(self.body_from_camera)


def field_degrees(detector: AreaDetector) -> tuple[float, float]:
    """Degrees from the first line to the last (along), and across the columns, without distortion."""
    lines, columns = (
        2.0 * float(np.degrees(np.arctan(0.5 * size / detector.focal_length_px))) for size in detector.shape
    )
    return lines, columns


def refuse_folding(detector: AreaDetector, place: str) -> None:
    """FormatError where distortion folds the frame, or stretches it as no lens does.

    Judged on the circle about the middle of the frame that touches its longer sides: coefficients that are
    good there may fold the corners, which are left out then.

    Parameters
    ----------
    detector : AreaDetector
    place : str
        File and key of the distortion.
    """
    if not any(detector.distortion):
        return
    middle = 0.5 * (np.array(detector.shape) - 1.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 9)[:-1]
    pixels = middle + middle.min() * np.column_stack([np.sin(angle), np.cos(angle)])
    rays = detector.directions(pixels)
    seen = np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]
    plain = np.linalg.norm(pixels - np.array(detector.principal_point_px), axis=1) / detector.focal_length_px
    lost = ~np.isfinite(seen)
    if not lost.any() and not (plain > _MOST_STRETCH * seen).any():
        return
    what = (
        "folds the field of view within the frame"
        if lost.any()
        else f"stretches the frame {float(np.max(plain / seen)):.3g}-fold, which no lens does"
    )
    raise FormatError(
        f"{place} = {list(detector.distortion)} {what} (at a tangent of {float(plain.max()):.3g} from the "
        "axis); k1, k2, p1, p2, k3 in that order, of tangents (px / focal_length_px) and from the scene to "
        "the image, are expected"
    )


def wide_words(detector: AreaDetector) -> tuple[str, ...]:
    """A doubt of a focal length that makes the view wider than any lens but a fisheye has it; else none."""
    along, across = field_degrees(detector)
    if max(along, across) <= _WIDEST:
        return ()
    return (
        f"the field of view is {along:.0f} x {across:.0f} degrees by focal_length_px = "
        f"{detector.focal_length_px:g}: was it given in mm? Pixels are expected: mm / pixel pitch in mm",
    )
