"""What an ACQUISITION.toml may hold: keys, types, defaults and allowed values.

The contract of ``docs/formats.md`` as pydantic models. Every key has a description; the
JSON Schema of ``sightline schema acquisition`` is generated from here.

Not here: reading the file (``io/config.py``), opening what it names (``load.py``).
"""

from __future__ import annotations

import posixpath
from datetime import datetime
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from sightline.errors import FormatError
from sightline.geometry.apparent import APPARENT
from sightline.geometry.camera import MOST_STAGES
from sightline.io.formats.instants import parse_utc
from sightline.io.quantities import (
    Altitude,
    AngleSigma,
    AngleSigmaAbove0,
    BandNumber,
    Coordinate,
    CorrelationTime,
    Direction,
    Distortion,
    Factor,
    FileName,
    FocalLengthPx,
    FocalSigmaPx,
    FrameShape,
    Frequency,
    Height,
    Latitude,
    LengthSigma,
    LengthSigmaAbove0,
    LinePeriod,
    LineRotation,
    Longitude,
    LookAngle,
    Name,
    PixelPlace,
    Pixels,
    PixelSigma,
    PixelSigmaAbove0,
    PixelTangent,
    Place,
    Radius,
    RateSigma,
    Readout,
    Scale,
    Seconds,
    Speed,
    SpinRate,
    TimeSigma,
    Title,
    UnitQuaternion,
    Within,
    WorldRate,
    shown,
)

Estimate = Literal["estimate"]

#: Bands of one acquisition: imaging spectrometers 500. Frames: Juno 80 a pass, aerial cameras some thousand.
MOST_BANDS, MOST_FRAMES = 4096, 100_000
#: Points, sensors and tones that a file lists itself; more are given by tables.
MOST_LISTED = 10_000


class SchemaSection(BaseModel):
    """A table of the file; a key that is not listed is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class FilesSection(SchemaSection):
    """``[files]``: what the files that are named may refer to."""

    allow: list[FileName] = Field(
        default=[],
        max_length=MOST_LISTED,
        description="Folders, beside those of this file and of each raster, to which rasters may refer",
    )


class InputFile(SchemaSection):
    """What every one of the TOML files may say."""

    files: FilesSection = Field(
        default=FilesSection(), description="What the files that are named here may refer to"
    )


class DatedSection(SchemaSection):
    """What every data set may say of itself: when t = 0 was."""

    epoch: Title | None = Field(default=None, description="UTC instant of t = 0, ISO 8601")

    @field_validator("epoch", mode="before")
    @classmethod
    def _epoch_as_text(cls, value: object) -> object:
        """TOML's own date-times are taken as well as quoted ones."""
        return value.isoformat() if isinstance(value, datetime) else value

    @field_validator("epoch")
    @classmethod
    def _epoch_is_an_instant(cls, value: str | None) -> str | None:
        """What CCSDS files would refuse at the very end is refused at once."""
        if value is not None:
            try:
                parse_utc(value, "epoch")
            except FormatError as error:
                raise ValueError(str(error).removeprefix("epoch: ")) from None
        return value


class HeaderSection(DatedSection):
    """``[acquisition]``: what this data set is called and when t = 0 was."""

    name: Title = Field(default="acquisition", description="Title of the report")
    epoch: Title | None = Field(
        default=None,
        description="UTC instant of t = 0, ISO 8601; needed by axes of the stars, EXIF times, CCSDS files "
        "and `export` --to csm, isd, aem, oem, ck, isis, stac",
    )
    control_points: FileName | None = Field(
        default=None, description="CSV file x,y,z,sigma,image,line,column of ground control points"
    )
    control_sigma_px: PixelSigmaAbove0 = Field(
        default=0.1, description="1-sigma of where control points were seen, px"
    )


class KnownAttitude(SchemaSection):
    """How well the reference attitude of ``[platform]`` is known."""

    attitude_sigma: AngleSigmaAbove0 | None = Field(
        default=None,
        description="How far constant angles may be from the reference attitude, rad; by default 0.01, "
        "that of yaw as much more as its motion goes",
    )
    rate_sigma: RateSigma | None = Field(
        default=None,
        description="How far even rates may be from those of the reference attitude, rad/s; by default "
        "0.001, that of yaw as much more as its motion goes",
    )


#: Axes that a table without words of its own may be in.
GivenAxes = Literal["ITRF", "GCRF", "EME2000", "MOD", "TOD", "TEME", "CIRS", "TIRS"]
EARTH_ORIENTATION = "IERS finals2000A or C04 (default: the table of astropy-iers-data), for axes of the stars"


class LevelFlight(KnownAttitude):
    """``[platform]`` kind level-flight: straight and level over a flat Earth, flying north."""

    kind: Literal["level-flight"]
    altitude: Altitude = Field(description="m above height 0")
    ground_speed: Speed = Field(description="m/s")


class EphemerisPlatform(KnownAttitude):
    """``[platform]`` kind ephemeris: positions and attitudes from tables."""

    kind: Literal["ephemeris"]
    positions: FileName = Field(description="CSV t,x,y,z, CCSDS OEM or OMM, two-line elements (TLE), or SBET")
    attitudes: FileName = Field(
        default="along-track",
        description="CSV t,qx,qy,qz,qw (world_from_body), CCSDS AEM, APM, SBET, or "
        '"along-track" (z down, x ahead)',
    )
    position_axes: GivenAxes | None = Field(
        default=None, description="Axes of a CSV table of positions that is not in those of [world]"
    )
    attitude_axes: GivenAxes | None = Field(
        default=None, description="Axes of a CSV table of attitudes that is not in those of [world]"
    )
    earth_orientation: FileName | None = Field(default=None, description=EARTH_ORIENTATION)
    aberration: bool = Field(
        default=False,
        description="Whether aberration of light is to be applied: the attitudes do not hold it already",
    )
    light_time: bool = Field(
        default=False, description="Whether the Earth's turn while light is under way is to be applied"
    )
    refraction: bool = Field(
        default=False, description="Whether refraction by the Earth's air is to be applied"
    )

    @model_validator(mode="after")
    def _axes_are_of_a_table(self) -> EphemerisPlatform:
        if self.attitude_axes is not None and self.attitudes == "along-track":
            raise ValueError(
                f'attitude_axes = "{self.attitude_axes}" is of a table of attitudes, and attitudes = '
                '"along-track" takes them from the positions; give attitudes = FILE, or remove attitude_axes'
            )
        return self


class CameraModelPlatform(KnownAttitude):
    """``[platform]`` kind camera-model: geometry from a sensor-model file."""

    kind: Literal["camera-model"]
    model: FileName | None = Field(
        default=None,
        description="USGS CSM line-scan ISD or model state (JSON), or the metadata of a product (XML, IMD); "
        "or one `model` per [[band]] or [[frame]]",
    )
    aberration: bool | None = Field(
        default=None, description="As of kind ephemeris; default: what the attitudes of the model need"
    )
    light_time: bool | None = Field(
        default=None, description="As of kind ephemeris; default: what the attitudes of the model need"
    )
    refraction: bool | None = Field(
        default=None, description="As of kind ephemeris; default: what the attitudes of the model need"
    )


class SpinPlatform(SchemaSection):
    """``[platform]`` kind spin: a body that turns evenly about an axis of its own."""

    kind: Literal["spin"]
    positions: FileName | None = Field(default=None, description="CSV t,x,y,z or CCSDS OEM")
    earth_orientation: FileName | None = Field(default=None, description=EARTH_ORIENTATION)
    position: Place | None = Field(
        default=None, description="The same place at all times, axes of [world]; with neither: the origin"
    )
    attitude: UnitQuaternion = Field(description="world_from_body at t = 0, [x, y, z, w]")
    attitude_sigma: AngleSigma = Field(
        default=0.1, description="How well that is known, rad about each axis (frames only)"
    )
    attitude_turn_sigma: AngleSigma | None = Field(
        default=None,
        description="The same about the line to the origin of [world] (the centre of the body), where it is "
        "known less well: it is hardly observable from the outline of a body",
    )
    axis: Direction = Field(description="Axis of the spin in body axes, of any length")
    axis_sigma: AngleSigma = Field(
        default=0.0, description="How well its direction is known, rad, each way across it; 0 = exactly"
    )
    rate: SpinRate = Field(description="rad/s about the axis, right-handed, relative to the stars")
    rate_sigma: RateSigma = Field(default=0.0, description="How well the rate is known, rad/s; 0 = exactly")
    world_rate: WorldRate | None = Field(
        default=None,
        description="rad/s at which the axes of [world] turn about their z relative to the stars; default: "
        "the Earth's; 0 for local axes without an origin and where [surface] is infinity or has radii",
    )

    @model_validator(mode="after")
    def _turns(self) -> SpinPlatform:
        if self.positions is not None and self.position is not None:
            raise ValueError("positions and position are both given; keep one of them")
        if self.rate == 0.0:
            raise ValueError(
                'rate = 0 is no spin; a body that does not turn is kind = "ephemeris" with attitudes'
            )
        return self


PlatformSection = Annotated[
    LevelFlight | EphemerisPlatform | SpinPlatform | CameraModelPlatform, Field(discriminator="kind")
]


#: rad; a mirror whose normal is nearer to its axis hardly scans.
LEAST_TILT = 1e-3


class FixedPointing(SchemaSection):
    """``[pointing]`` kind fixed: the camera is bolted to the body."""

    kind: Literal["fixed"]


class ScanMirrorPointing(SchemaSection):
    """``[pointing]`` kind scan-mirror: the camera looks through a plane mirror that turns."""

    kind: Literal["scan-mirror"]
    axis: Direction = Field(description="Axis the mirror turns about, body axes, of any length")
    normal: Direction = Field(description="Normal of the mirror at angle 0, body axes, of any length")
    angles: FileName = Field(description="CSV t,angle: s, rad of the mirror about its axis")

    @model_validator(mode="after")
    def _scans(self) -> ScanMirrorPointing:
        axis, normal = (np.array(v) / max(map(abs, v)) for v in (self.axis, self.normal))
        if np.linalg.norm(np.cross(axis, normal)) < LEAST_TILT * np.linalg.norm(axis) * np.linalg.norm(
            normal
        ):
            raise ValueError(
                f"normal = {list(self.normal)} is parallel to axis = {list(self.axis)}: such a mirror scans "
                f"nothing; allowed is a normal at least {LEAST_TILT} rad from the axis"
            )
        return self


PointingSection = Annotated[FixedPointing | ScanMirrorPointing, Field(discriminator="kind")]


class LineGeometry(SchemaSection):
    """Keys that `[instrument]` gives for all bands and a `[[band]]` may give for itself."""

    ifov: PixelTangent | None = Field(
        default=None, description="Tangent of the angle of one pixel: pixel pitch / focal length"
    )
    columns: Pixels | None = Field(default=None, description="Pixels of the detector line")
    line_period: LinePeriod | None = Field(default=None, description="s between image lines")
    directions: FileName | None = Field(
        default=None, description="CSV column,x,y,z of viewing directions in camera axes"
    )


#: Of an image that another was cut from.
FirstPixel = Annotated[int, Within(0, 10_000_000)]
#: CCDs of a detector line, and columns at which one begins.
PieceCount = Annotated[int, Within(2, 1000)]
PieceColumn = Annotated[int, Within(1, 1_000_000)]


class BandSection(LineGeometry):
    """``[[band]]``: one detector line and its image."""

    name: Name
    image: FileName = Field(description="Any GDAL raster, or .npy (lines, columns)")
    image_band: BandNumber = Field(default=1, description="Which band of the raster")
    look_ahead: LookAngle = Field(default=0.0, description="Along-track viewing angle, rad, forward positive")
    offset_px: tuple[PixelPlace, PixelPlace] = Field(
        default=(0.0, 0.0),
        description="The line looks this many pixels further (forward, toward larger columns) than nominal",
    )
    offset_sigma_px: Annotated[float, Within(1e-7, 1e5, "px", zero=True)] = Field(
        default=1.0, description="How well the offset is known, px; 0 = exactly"
    )
    rotation: LineRotation = Field(
        default=0.0, description="rad; positive looks further forward at larger columns"
    )
    rotation_sigma: AngleSigma = Field(
        default=3e-4, description="How well the rotation is known, rad; 0 = exactly"
    )
    scale_sigma: Scale = Field(
        default=1e-3,
        description="How well its magnification beside the first band's is known, relative; 0 = exactly",
    )
    shape: Literal["line", "polynomial", "pieces"] | None = Field(
        default=None,
        description="How the detector line departs from its directions: not, in smooth bends, or in steps "
        "between its CCDs; default: a line, unless the images show something else",
    )
    shape_sigma_px: Annotated[float, Within(1e-7, 100.0, "px", zero=True)] = Field(
        default=0.5, description="Size of each bend at the ends of the line, of each step, px; 0 = none"
    )
    pieces: PieceCount | Annotated[list[PieceColumn], Field(min_length=1, max_length=1000)] | None = Field(
        default=None,
        description='Of shape "pieces": how many equal CCDs, or the first column of each after the first',
    )
    first_line_time: Seconds | None = Field(
        default=None, description="s, centre of the exposure of line 0 (default 0)"
    )
    line_times: FileName | None = Field(
        default=None, description="CSV line,t for uneven lines, in place of first_line_time"
    )
    stages: Annotated[int, Within(1, MOST_STAGES)] | FileName | None = Field(
        default=None,
        description="TDI stages of its pixels: one number, or a file: CSV column,stages; tags.bin of `tdi "
        "--signals` (line by line); choice.csv of `tdi`, with stages_signal",
    )
    stages_signal: Annotated[float, Within(1e-3, 1e9, "electrons")] | None = Field(
        default=None, description="Electrons per head line: whose rows of a choice.csv are its stages"
    )
    time_reference: Literal["centre", "first-stage", "last-stage"] | None = Field(
        default=None,
        description="Which of a pixel's stages look_ahead and first_line_time are of (default centre; needed "
        "where stages differ)",
    )
    mask: FileName | None = Field(default=None, description="Raster of the same size; non-zero: do not use")
    quality: FileName | None = Field(
        default=None,
        description="CSV column,mtf_x,mtf_y,snr (choice.csv of `tdi` will do): predicted, for [matching] "
        'weighting = "predicted"',
    )
    model: FileName | None = Field(
        default=None, description="Sensor-model file of this band, [platform] kind camera-model"
    )
    first_pixel: tuple[FirstPixel, FirstPixel] | None = Field(
        default=None,
        description="[line, column] of the model's image at which that of this band begins, where it is a "
        "part of it, [platform] kind camera-model",
    )

    @model_validator(mode="after")
    def _pieces_follow(self) -> BandSection:
        if self.pieces is None:
            return self
        if self.shape != "pieces":
            raise ValueError(
                f"pieces = {self.pieces} says where CCDs begin; shape is {self.shape or 'not given'}; write "
                'shape = "pieces", or leave pieces out'
            )
        if isinstance(self.pieces, list) and any(b <= a for a, b in pairwise(self.pieces)):
            raise ValueError(f"pieces = {self.pieces} must rise: columns are counted from 0 at the first CCD")
        return self


class FrameSection(SchemaSection):
    """``[[frame]]``: one exposure of an area detector."""

    image: FileName = Field(description="Any GDAL raster (JPEG included), or .npy (lines, columns)")
    name: Name | None = Field(default=None, description="Default: the file name without ending")
    image_band: BandNumber | Literal["luminance"] = Field(
        default="luminance", description='Which band of the raster, or "luminance": their mean'
    )
    time: Seconds | Name | None = Field(
        default=None,
        description='s from the epoch, an ISO 8601 UTC instant, or "exif"; needed unless `model` brings it',
    )
    model: FileName | None = Field(
        default=None, description="USGS CSM frame ISD (JSON) of this exposure, [platform] kind camera-model"
    )
    time_sigma: TimeSigma = Field(
        default=0.0, description="How well the time is known, s (0.29 for 1-s stamps)"
    )
    mask: FileName | None = Field(default=None, description="Raster of the same size; non-zero: do not use")

    @field_validator("time", mode="before")
    @classmethod
    def _time_as_text(cls, value: object) -> object:
        return value.isoformat() if isinstance(value, datetime) else value


class StripSection(SchemaSection):
    """``[[camera.strip]]``: lines of a frame that lie behind one filter."""

    name: Name
    first_line: Annotated[int, Within(0, 1_000_000)] = Field(
        description="Of the frame's image, where the strip begins"
    )
    lines: Annotated[int, Within(1, 1_000_000)] = Field(description="How many")
    axis_line: PixelPlace | None = Field(
        default=None,
        description="Line of the optical axis counted from the strip's first line (outside the strip as a "
        "rule); default: as if the frame's image were the chip",
    )
    axis_line_sigma_px: PixelSigma = Field(
        default=0.0, description="px; how well the strip's place on the chip is known; 0 = exactly"
    )
    scale_sigma: Scale = Field(
        default=0.0, description="How well its focal length is known relative to the others'; 0 = exactly"
    )
    height_sigma: LengthSigma = Field(
        default=0.0,
        description="m; how well the height of the layer that it sees is known (colours see different depths "
        "of clouds); 0 = the surface itself",
    )


class CameraSection(SchemaSection):
    """``[camera]``: how the camera sits in the body and, for an area detector, its lens."""

    mount: Literal["nominal"] = Field(default="nominal", description="Lines forward, columns left")
    body_from_camera: UnitQuaternion | None = Field(
        default=None, description="[x, y, z, w] in place of the nominal mount"
    )
    shape: FrameShape | None = Field(default=None, description="(lines, columns) of a frame")
    focal_length_px: FocalLengthPx | Estimate | None = None
    focal_length_sigma_px: FocalSigmaPx = Field(default=0.0, description="0 = exactly")
    principal_point_px: tuple[PixelPlace, PixelPlace] | Estimate | None = Field(
        default=None, description="(line, column); default the centre of the frame"
    )
    principal_point_sigma_px: PixelSigma = Field(default=0.0, description="0 = exactly")
    distortion: Annotated[list[Distortion], Field(max_length=5)] | Estimate = Field(
        default=[], description="k1, k2, p1, p2, k3 in normalised coordinates"
    )
    distortion_sigma: Annotated[float, Within(1e-12, 1e18, zero=True)] = Field(
        default=0.0, description="Of k1 (k2, k3 likewise); 0 = exactly"
    )
    readout_time: Readout = Field(
        default=0.0, description="s from the first to the last line of a rolling shutter"
    )
    common_line_sigma_px: PixelSigma = Field(
        default=0.0,
        description="px; how well the line of the optical axis is known, common to all strips; 0 = exactly",
    )
    strip: list[StripSection] = Field(default=[], max_length=1000)

    @model_validator(mode="after")
    def _sigma_needs_a_number(self) -> CameraSection:
        if self.body_from_camera is not None and "mount" in self.model_fields_set:
            raise ValueError("mount and body_from_camera are both given; keep one of them")
        for key in ("focal_length", "principal_point"):
            if getattr(self, f"{key}_px") == "estimate" and getattr(self, f"{key}_sigma_px") > 0.0:
                raise ValueError(
                    f'{key}_px = "estimate" takes no {key}_sigma_px; give a number with its sigma, or '
                    f'"estimate" alone'
                )
        if self.distortion == "estimate" and self.distortion_sigma > 0.0:
            raise ValueError(
                'distortion = "estimate" takes no distortion_sigma; give numbers with their sigma, or '
                '"estimate" alone'
            )
        return self


class SurfaceSection(SchemaSection):
    """``[surface]``: what the lines of sight meet."""

    kind: Literal["infinity"] | None = Field(
        default=None, description="infinity: only directions matter (stars)"
    )
    height: Height = Field(
        default=0.0, description="m above the ellipsoid (above z = 0 for local axes); ignored with a dem"
    )
    dem: FileName | None = Field(default=None, description="Raster of heights in metres")
    datum: Literal["ellipsoid", "geoid"] = Field(
        default="ellipsoid", description="What the heights of the dem count from"
    )
    geoid: Annotated[float, Within(-1e5, 1e5, "m")] | FileName | None = Field(
        default=None, description="Height of the geoid above the ellipsoid: raster, or metres"
    )
    radii: tuple[Radius, Radius] | None = Field(
        default=None, description="[equatorial, polar] of another body, m"
    )
    height_sigma: Annotated[float, Within(1e-7, 3e4, "m", zero=True)] = Field(
        default=0.0, description="What is not known about the height, m"
    )
    parallax_sigma: RateSigma = Field(
        default=0.0,
        description="rad/s; speed of the platform over the distance of what it sees, where neither is known: "
        "directions may drift so fast (kind infinity and a spin only)",
    )

    @model_validator(mode="after")
    def _datum_is_complete(self) -> SurfaceSection:
        if self.kind == "infinity" and self.dem is not None:
            raise ValueError('kind = "infinity" takes no dem; remove one of the two')
        if self.kind != "infinity" and self.parallax_sigma > 0.0:
            raise ValueError(
                'parallax_sigma is for kind = "infinity", where distance and speed are unknown; remove it'
            )
        if self.datum == "geoid" and self.geoid is None:
            raise ValueError('datum = "geoid" needs geoid = a raster of geoid heights, or a number in metres')
        if self.datum == "ellipsoid" and self.geoid is not None:
            raise ValueError(
                'geoid is given but datum is "ellipsoid"; write datum = "geoid", or leave geoid out'
            )
        return self


class WorldSection(SchemaSection):
    """``[world]``: axes of every table of positions."""

    frame: Literal["earth-fixed", "local", "lonlat"] = Field(
        default="earth-fixed", description="lonlat: x, y, z hold longitude (deg), latitude (deg), height (m)"
    )
    origin: tuple[Longitude, Latitude, Height] | None = Field(
        default=None,
        description="[longitude (deg), latitude (deg), height (m)] of the origin of the local axes (east, "
        "north, up)",
    )


class SensorSection(SchemaSection):
    """``[[attitude_sensor]]``: angles measured by something else than the camera."""

    kind: Literal["star-tracker", "gyro"]
    table: FileName = Field(
        description="CSV t,roll,pitch,yaw,sigma (gyro: t_start,t_end,roll,pitch,yaw,sigma)"
    )
    name: Name | None = None
    alignment_sigma: AngleSigma = Field(
        default=0.0, description="Constant error of its axes against the camera's, rad, 1-sigma"
    )
    bias_sigma: AngleSigma = Field(
        default=0.0, description="star tracker: constant, rad; gyro: drift, rad/s; 1-sigma"
    )
    correlation_time: CorrelationTime = Field(
        default=0.0, description="s over which its errors stay alike; 0 = independent"
    )


class ControlPointSection(SchemaSection):
    """``[[control_point]]``: a ground point of known coordinates, seen in one image."""

    x: Coordinate
    y: Coordinate
    z: Coordinate
    sigma: LengthSigmaAbove0
    image: Name = Field(description="Name of the band or frame")
    line: PixelPlace
    column: PixelPlace


class KnownMotionSection(SchemaSection):
    """``[known_motion]``: what is known of the motion's frequencies beforehand."""

    tones: list[Frequency] = Field(
        default=[],
        max_length=1000,
        description="Hz; tones of wheels, coolers, ... that are there, of whatever size",
    )
    psd: FileName | None = Field(
        default=None,
        description="CSV f,roll,pitch,yaw: one-sided spectrum, rad^2/Hz; taken as it is, nothing is fitted",
    )

    @model_validator(mode="after")
    def _one_of_both(self) -> KnownMotionSection:
        if self.tones and self.psd is not None:
            raise ValueError("tones and psd are both given; a psd is the whole spectrum: keep one of them")
        return self


#: Keys of ``[camera]`` that a frame's model brings.
LENS = frozenset(("shape", "focal_length_px", "principal_point_px", "distortion"))
#: Keys of ``[matching]`` that say nothing about frames.
BANDS_ONLY = frozenset(
    {"hybridise", "pairs", "select", "strength", "points", "features", "similarity", "weighting"}
)
#: px; windows of more than some hundred see the motion change under them.
_Lines = Annotated[int, Within(3, 4096, "px")]
_Columns = Annotated[int, Within(8, 4096, "px")]
_Reach = Annotated[int, Within(0, 4096, "px")]
WindowSize = tuple[_Lines, _Columns]


class MatchingSection(SchemaSection):
    """``[matching]``: where the default choice is not wanted (names as in ``RecoverOptions``)."""

    first_window: WindowSize | None = Field(
        default=None, description="(lines, columns) of the windows of the first, searching pass"
    )
    window: WindowSize | None = Field(
        default=None, description="(lines, columns) of the windows of the passes compensated by motion"
    )
    step: Annotated[int, Within(1, 1_000_000, "lines")] | None = Field(
        default=None, description="Lines between rows of windows in the compensated passes"
    )
    search_px: tuple[_Reach, _Reach] | None = Field(
        default=None, description="Half-range (lines, columns) of the first search about the prediction"
    )
    passes: Annotated[int, Within(1, 50)] | None = Field(
        default=None, description="At most so many compensated passes"
    )
    hybridise: Literal["global", "iterative"] | None = Field(
        default=None, description="Pairs of bands all at once, or one after the other, best correlated first"
    )
    select: Literal["all", "textured", "spread", "listed"] | None = Field(
        default=None,
        description="Which windows are matched: all; those with texture in two directions; the strongest, "
        "well spread; those that hold a listed feature",
    )
    strength: Factor | None = Field(
        default=None,
        description="select = textured: least texture, in units of the image's median (default 1)",
    )
    points: Annotated[int, Within(1, 10_000_000)] | None = Field(
        default=None, description="select = spread: at most so many windows of an image (default 2000)"
    )
    features: FileName | None = Field(default=None, description="select = listed: CSV image,line,column")
    similarity: Literal["whitened", "radiometric", "gradient"] | None = Field(
        default=None, description="What is compared: whitened images, images as they are, or their edges"
    )
    weighting: Literal["covariance", "predicted", "none"] | None = Field(
        default=None,
        description="Whether a match counts for what it knows, for what MTF and SNR of its columns let "
        "expect ([[band]] quality), or all alike (for comparison)",
    )
    pairs: Annotated[tuple[tuple[Name, Name], ...], Field(min_length=1, max_length=MOST_LISTED)] | None = (
        Field(
            default=None,
            description="[[a, b], ...], names of the pairs of bands that are matched; default: all",
        )
    )

    @model_validator(mode="after")
    def _choices_fit(self) -> MatchingSection:
        for key, way in (("strength", "textured"), ("points", "spread"), ("features", "listed")):
            if getattr(self, key) is not None and self.select != way:
                raise ValueError(f'{key} is for select = "{way}"; add it, or remove {key}')
        if self.select == "listed" and self.features is None:
            raise ValueError('select = "listed" needs features = a CSV file image,line,column')
        return self


class AcquisitionFile(InputFile):
    """An ACQUISITION.toml: images of one strip (or frames), the instrument, the platform, the ground."""

    acquisition: HeaderSection = HeaderSection()
    platform: PlatformSection
    instrument: LineGeometry = LineGeometry()
    camera: CameraSection = CameraSection()
    pointing: PointingSection = FixedPointing(kind="fixed")
    band: list[BandSection] = Field(default=[], max_length=MOST_BANDS)
    frame: list[FrameSection] = Field(default=[], max_length=MOST_FRAMES)
    surface: SurfaceSection = SurfaceSection()
    world: WorldSection = WorldSection()
    attitude_sensor: list[SensorSection] = Field(default=[], max_length=100)
    control_point: list[ControlPointSection] = Field(default=[], max_length=MOST_LISTED)
    known_motion: KnownMotionSection = KnownMotionSection()
    matching: MatchingSection = MatchingSection()

    def _refuse_what_would_be_ignored(self) -> None:
        """Keys that belong to the other kind of instrument or world."""
        lens = sorted(self.camera.model_fields_set - {"mount", "body_from_camera"})
        if self.band and lens:
            raise ValueError(f"[camera] {lens[0]} describes frames, but [[band]] is given; remove it")
        ignored = sorted(self.matching.model_fields_set & BANDS_ONLY)
        if self.frame and ignored:
            raise ValueError(f"[matching] {ignored[0]} is for [[band]], but [[frame]] is given; remove it")
        if self.frame and self.known_motion.model_fields_set:
            raise ValueError("[known_motion] is of lines of a strip, but [[frame]] is given; remove it")
        line = sorted(self.instrument.model_fields_set)
        if self.frame and line:
            raise ValueError(
                f"[instrument] {line[0]} describes detector lines, but [[frame]] is given; remove it"
            )
        self._frames_have_a_time()
        if isinstance(self.platform, CameraModelPlatform) and self.pointing.kind != "fixed":
            raise ValueError(
                '[pointing] is given, but kind = "camera-model" brings its own; remove [pointing]'
            )
        if isinstance(self.platform, SpinPlatform):
            placed = self.platform.positions is not None or self.platform.position is not None
            if not placed and self.surface.kind != "infinity":
                raise ValueError(
                    '[platform] kind = "spin" has neither positions nor position; only [surface] kind = '
                    '"infinity" does without'
                )
        if isinstance(self.platform, LevelFlight) and (self.world.frame != "local" or self.world.origin):
            if self.world.model_fields_set:
                raise ValueError(
                    '[world] is given, but kind = "level-flight" has axes of its own; remove [world]'
                )

    def _frames_have_a_time(self) -> None:
        """Of its own, or that of its model, which brings lens and pose too."""
        modelled = isinstance(self.platform, CameraModelPlatform)
        for number, entry in enumerate(self.frame, 1):
            where = f"[[frame]] number {number}: "
            given = [key for key in ("time", "model") if getattr(entry, key) is not None]
            if modelled and given != ["model"]:
                what = (
                    "time is given, but model brings it; remove it"
                    if "model" in given
                    else "model is missing"
                )
                raise ValueError(f'{where}{what}; [platform] kind = "camera-model" takes model = ISD alone')
            if not modelled and given != ["time"]:
                what = (
                    'model needs [platform] kind = "camera-model"' if "model" in given else "time is missing"
                )
                raise ValueError(f'{where}{what}; give time = s from the epoch, a UTC instant, or "exif"')
        bent = [key for key in APPARENT if getattr(self.platform, key, None)]
        if modelled and self.frame and bent:
            raise ValueError(f"[platform] {bent[0]} is of detector lines, but [[frame]] is given; remove it")
        lens = sorted(self.camera.model_fields_set & LENS)
        if modelled and self.frame and lens:
            raise ValueError(f"[camera] {lens[0]} is given, but the model files bring it; remove it")

    def _strips_are_a_chip(self) -> None:
        """Strips have names of their own, and belong to a camera that spins."""
        names = [strip.name for strip in self.camera.strip]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(
                f"two strips are called {repeated[0]!r}; every [[camera.strip]] needs a name of its own"
            )
        spins = isinstance(self.platform, SpinPlatform)
        if names and not spins:
            raise ValueError(
                f'[[camera.strip]] needs [platform] kind = "spin", here it is {self.platform.kind!r}; leave '
                "the strips out: whole frames are matched"
            )
        if self.camera.common_line_sigma_px > 0.0 and not names:
            raise ValueError("common_line_sigma_px is given without a [[camera.strip]]; remove it")
        if self.surface.parallax_sigma > 0.0 and not (spins and self.frame):
            raise ValueError('parallax_sigma is for [[frame]] of a [platform] kind = "spin"; remove it')

    @model_validator(mode="after")
    def _pairs_name_bands(self) -> AcquisitionFile:
        names = [item.name for item in self.band]
        for a, b in self.matching.pairs or ():
            for name in (a, b):
                if name not in names:
                    raise ValueError(
                        f"[matching] pairs names {name!r}, which is no [[band]]; there are: "
                        f"{', '.join(names) or 'none'}"
                    )
            if a == b:
                raise ValueError(f"[matching] pairs: {a!r} with itself; a pair is two different bands")
        return self

    @model_validator(mode="after")
    def _images_are_enough(self) -> AcquisitionFile:
        if self.band and self.frame:
            raise ValueError(
                "both [[band]] and [[frame]] are given; line detectors take [[band]], area detectors "
                "[[frame]]"
            )
        count, table = (len(self.frame), "frame") if self.frame else (len(self.band), "band")
        # one band has a geometry, and can be tied to a reference; `recover` refuses it
        if count < (1 if table == "band" else 2):
            raise ValueError(
                f"{count} [[{table}]] given; motion is seen between two or more images of the same ground: "
                f"add a [[{table}]]"
            )
        self._refuse_what_would_be_ignored()
        self._strips_are_a_chip()
        names = [item.name for item in self.band]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(f"two bands are called {repeated[0]!r}; every [[band]] needs a name of its own")
        self._every_image_is_another()
        self._ground_is_below()
        return self

    def _every_image_is_another(self) -> None:
        """An image compared with itself matches perfectly, and says that the ground stands still."""
        met: dict[tuple[str, int | str], int] = {}
        table = "frame" if self.frame else "band"
        items: list[FrameSection | BandSection] = [*self.frame, *self.band]
        for number, item in enumerate(items, 1):
            first = met.setdefault((posixpath.normpath(item.image), item.image_band), number)
            if first != number:
                raise ValueError(
                    f"{table}[{first}].image and {table}[{number}].image are the same, {shown(item.image)}; "
                    "name the image of each, or by image_band which band of the file it is"
                )

    def _ground_is_below(self) -> None:
        height, flight = self.surface.height, self.platform
        if isinstance(flight, LevelFlight) and height is not None and height >= flight.altitude:
            raise ValueError(
                f"surface.height = {height:g} m is not below platform.altitude = {flight.altitude:g} m, from "
                "where the ground is seen; both are in m above the same height 0"
            )
