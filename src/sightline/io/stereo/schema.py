"""What a STEREO.toml may hold: keys, types, defaults and allowed values.

The contract of ``docs/formats.md`` as pydantic models; the JSON Schema of ``sightline schema stereo`` is
generated from here.

Not here: reading the file (``io/config.py``), what is made of it (``load.py``).
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from sightline.geometry.units import ARCSEC
from sightline.io.acquisition.schema import (
    DatedSection,
    InputFile,
    SchemaSection,
    SurfaceSection,
    WorldSection,
)
from sightline.io.camera_schema import FrameCameraSection
from sightline.io.quantities import (
    AngleSigma,
    Duration,
    Extent,
    FileName,
    FocalLengthPx,
    FrameShape,
    Inclination,
    Latitude,
    LengthSigma,
    LengthSigmaAbove0,
    Name,
    Offset,
    OrbitAltitude,
    PixelSigmaAbove0,
    Place,
    Title,
    Within,
)

#: rad; noise of attitudes beyond which nothing is linear, and which no sensor has: given in other units.
LARGEST_ATTITUDE_SIGMA = 0.05

#: Shots of a pass, spacecraft (constellations of 200 fly), points of a shot: each, with the others few.
MOST_SHOTS, MOST_CAMERAS, MOST_POINTS = 100_000, 1000, 1_000_000

#: One table for all cameras or a list of tables, distinguished before they are checked.
_ONE, _EACH = "as-table", "as-list"


def _form(value: object) -> str:
    return _EACH if isinstance(value, list | tuple) else _ONE


class StereoHeader(DatedSection):
    """``[stereo]``: what this data set is called and when t = 0 was."""

    name: Title = Field(default="stereo orientation", description="Title of the report")
    epoch: Title | None = Field(default=None, description="UTC instant of t = 0, ISO 8601; needed for an AEM")


class StereoCamera(FrameCameraSection):
    """``[camera]``, or one ``[[camera]]`` each: how it sits in the body, and its lens."""

    name: Name | None = Field(default=None, description="Of [[camera]]: which one, as in cameras.csv")
    shape: FrameShape = Field(description="(lines, columns) of a frame")
    focal_length_px: FocalLengthPx = Field(description="Focal length / pixel pitch")

    @field_validator("name", mode="before")
    @classmethod
    def _a_number_is_a_name(cls, value: object) -> object:
        return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class StereoNoise(SchemaSection):
    """``[noise]``: errors of points and of planned poses, 1-sigma."""

    sigma_px: PixelSigmaAbove0 | None = Field(
        default=None,
        description="Of each coordinate of a point, px; where the table of points gives none. With images: "
        "added in quadrature to what each match says of itself",
    )
    sigma_position: LengthSigma = Field(description="Of planned positions, m per axis, shot to shot")
    sigma_attitude: AngleSigma = Field(description="Of planned attitudes, rad per body axis, shot to shot")
    attitude_knowledge: Literal["independent", "from-position"] = Field(
        default="independent",
        description="independent: measured (star tracker); from-position: each camera looked at aim_point "
        "and attitudes were rebuilt from the noisy positions",
    )
    aim_point: Place | None = Field(
        default=None,
        description="With from-position: x, y, z, axes of [world]; default: nearest to all boresights",
    )

    @field_validator("sigma_attitude")
    @classmethod
    def _in_radians(cls, value: float) -> float:
        if value > LARGEST_ATTITUDE_SIGMA:
            raise ValueError(
                f"{value:g} rad is {math.degrees(value):.3g} degrees and is not allowed: radians up to "
                f"{LARGEST_ATTITUDE_SIGMA:g} are; {value:g} arcsec would be "
                f"{value * ARCSEC:.2g}, {value:g} degrees {math.radians(value):.2g}"
            )
        return value

    @model_validator(mode="after")
    def _aim_needs_its_model(self) -> StereoNoise:
        if self.aim_point is not None and self.attitude_knowledge != "from-position":
            raise ValueError(
                'aim_point belongs to attitude_knowledge = "from-position"; remove one of the two'
            )
        return self


class StereoStrip(SchemaSection):
    """``[[strip]]``: a push-broom image in place of the frames of a camera."""

    name: Name = Field(description="Camera of this strip, as in the column camera of observations")
    acquisition: FileName = Field(description="ACQUISITION.toml that has its camera")
    band: Name | None = Field(default=None, description="Which of its bands; default the first")


class PlanSection(SchemaSection):
    """``[plan]``: a pass that is not flown yet, for ``--predict``; in place of cameras and points."""

    altitude: OrbitAltitude = Field(
        default=500e3, description="m above the equatorial radius, circular orbits"
    )
    inclination_deg: Inclination = Field(default=97.4, description="Of the orbits, degrees")
    latitude_deg: Latitude = Field(default=0.0, description="Geocentric, of the aim point, degrees")
    separation: Duration = Field(description="s between the first spacecraft and the last on their orbit")
    window: Duration = Field(description="s in which the shots are taken")
    shots: Annotated[int, Within(1, MOST_SHOTS)] = Field(description="How many")
    offset: Offset = Field(default=0.0, description="s from the middle of the pass to that of the window")
    cross_track: Annotated[float, Within(-1e8, 1e8, "m")] = Field(
        default=0.0, description="m of the aim point beside the track, to the left of the flight"
    )
    cameras: Annotated[int, Within(2, MOST_CAMERAS)] = Field(default=2, description="How many spacecraft")
    points: Annotated[int, Within(1, MOST_POINTS)] = Field(
        default=300, description="Conjugate points in every shot"
    )
    scene_size: Extent | None = Field(
        default=None, description="m, side of the square they cover; default 0.9 of a frame from nearest"
    )


class StereoFile(InputFile):
    """A STEREO.toml: cameras that image one scene together, points found in the images, what is known."""

    stereo: StereoHeader = StereoHeader()
    cameras: FileName | None = Field(
        default=None,
        description="CSV camera,shot,t,x,y,z,qx,qy,qz,qw: planned poses, world_from_body, scalar last",
    )
    matches: FileName | None = Field(
        default=None,
        description="CSV shot,point,line_1,column_1,line_2,column_2[,sigma_px], two cameras",
    )
    observations: FileName | None = Field(
        default=None, description="CSV camera,shot,point,line,column[,sigma_px], any number of cameras"
    )
    images: FileName | None = Field(
        default=None, description="CSV camera,shot,image[,mask]: points are found in the images"
    )
    dem: FileName | None = Field(default=None, description="Raster of heights on which all points lie")
    dem_sigma: LengthSigmaAbove0 | None = Field(default=None, description="How well it is known, m; with dem")
    control_points: FileName | None = Field(
        default=None,
        description="CSV x,y,z,sigma and point, or camera,shot,line,column, or image,line,column",
    )
    camera: (
        Annotated[
            Annotated[StereoCamera, Tag(_ONE)]
            | Annotated[list[StereoCamera], Field(max_length=MOST_CAMERAS), Tag(_EACH)],
            Discriminator(_form),
        ]
        | None
    ) = Field(default=None, description="All cameras alike, or [[camera]] with a name each")
    noise: StereoNoise
    surface: SurfaceSection = SurfaceSection()
    world: WorldSection = WorldSection()
    strip: list[StereoStrip] = Field(
        default=[], max_length=MOST_CAMERAS, description="Push-broom images in place of frames"
    )
    plan: PlanSection | None = Field(default=None, description="A pass not yet flown, for --predict")

    @property
    def sources(self) -> list[str]:
        """Which of the keys that bring points are given."""
        return [key for key in ("matches", "observations", "images") if getattr(self, key) is not None]

    @model_validator(mode="before")
    @classmethod
    def _one_source_of_points(cls, data: Any) -> Any:
        """Said before missing keys are: it is the commonest mistake."""
        given = [key for key in ("matches", "observations", "images") if key in data]
        if len(given) > 1:
            raise ValueError(
                f"{' and '.join(given)} are given; keep one of them: the points come from one table"
            )
        return data

    @model_validator(mode="after")
    def _parts_agree(self) -> StereoFile:
        if self.plan is not None:
            self._plan_stands_alone()
        elif self.strip:
            self._strips_stand_alone()
        else:
            if self.cameras is None:
                raise ValueError("key 'cameras' is missing: a CSV camera,shot,t,x,y,z,qx,qy,qz,qw; add it")
            if self.camera is None or self.camera == []:
                raise ValueError("[camera] is missing: shape, focal_length_px; add it")
        if isinstance(self.camera, list):
            self._cameras_have_names(self.camera)
        elif self.camera is not None and self.camera.name is not None:
            raise ValueError(
                "camera.name belongs to [[camera]]; one [camera] is for all cameras: remove name"
            )
        self._heights_are_said_once()
        return self

    def _plan_stands_alone(self) -> None:
        keys = ("cameras", "strip", "dem", "control_points", *self.sources)
        given = [key for key in keys if getattr(self, key)]
        if given:
            raise ValueError(f"[plan] lays out poses and points itself; remove {given[0]}, or [plan]")
        if self.camera is None or self.camera == []:
            raise ValueError("[camera] is missing: shape, focal_length_px; add it")
        if self.surface.dem is not None:
            raise ValueError("[plan] takes [surface] height and height_sigma, no dem; remove it")

    def _strips_stand_alone(self) -> None:
        given = [key for key in ("cameras", "camera") if getattr(self, key) is not None]
        if given:
            raise ValueError(f"[[strip]] brings its own camera; remove {given[0]}")
        if self.observations is None:
            raise ValueError("[[strip]] takes its points from observations = FILE (camera,point,line,column)")
        names = [strip.name for strip in self.strip]
        if len(names) < 2 or len(set(names)) < len(names):
            raise ValueError(f"[[strip]] needs two or more, each with a name of its own; given: {names}")
        if self.noise.attitude_knowledge != "independent":
            raise ValueError(
                'attitude_knowledge = "from-position" is for frames; [[strip]] takes "independent"'
            )

    @staticmethod
    def _cameras_have_names(cameras: list[StereoCamera]) -> None:
        names = [camera.name for camera in cameras]
        if None in names:
            raise ValueError(
                f"[[camera]] number {names.index(None) + 1} has no name; add name = as in cameras.csv"
            )
        repeated = sorted({str(name) for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(f"two [[camera]] are called {repeated[0]!r}; each needs a name of its own")

    def _heights_are_said_once(self) -> None:
        given = self.surface.model_fields_set
        if self.surface.kind is not None:
            raise ValueError("surface.kind is for stars; points to be oriented by lie near: remove it")
        if self.dem is None:
            if self.dem_sigma is not None:
                raise ValueError(
                    "dem_sigma is given without dem; add dem = FILE, or use [surface] height_sigma"
                )
        else:
            twice = sorted(given & {"dem", "height", "height_sigma"})
            if twice:
                raise ValueError(f"dem and [surface] {twice[0]} are both given; keep one of them")
            if self.dem_sigma is None:
                raise ValueError("dem is given without dem_sigma (m): say how well its heights are known")
        if "height_sigma" in given and self.surface.height_sigma == 0.0:
            raise ValueError(
                "surface.height_sigma = 0 is not allowed: no ground is known exactly; give metres, or "
                "leave it "
                "out to use heights as a start only"
            )
        if self.surface.dem is not None and "height_sigma" not in given:
            raise ValueError(
                "surface.dem is given without height_sigma (m): say how well its heights are known"
            )
