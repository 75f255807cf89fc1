"""What a SEQUENCE.toml may hold: keys, types, defaults and allowed values.

The contract of ``docs/formats.md`` as pydantic models; the JSON Schema of ``sightline schema sequence`` is
generated from here.

Not here: reading the file (``io/config.py``), what is made of it (``load.py``).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from sightline.io.acquisition.schema import (
    MOST_LISTED,
    ControlPointSection,
    DatedSection,
    InputFile,
    SchemaSection,
    SurfaceSection,
    WorldSection,
)
from sightline.io.camera_schema import FrameCameraSection
from sightline.io.quantities import (
    AngleSigma,
    AngleSigmaAbove0,
    FileName,
    FocalLengthPx,
    FrameShape,
    GroundSample,
    Height,
    LengthSigma,
    LengthSigmaAbove0,
    Name,
    PixelSigmaAbove0,
    ReadoutForward,
    TimeSigma,
    Title,
    WavelengthReach,
    Within,
    shown,
)

#: m, rad; 1-sigma of positions and angles for which nothing is said: GPS of a camera, angles of a gimbal.
POSITION_SIGMA, ATTITUDE_SIGMA = 5.0, 0.035

#: nm; no camera sees shorter waves, while 0.45 is a wavelength in micrometres.
LEAST_NM = 100.0


def _in_nm(value: float) -> float:
    if value < LEAST_NM:
        raise ValueError(
            f"{value:g} nm is no light that a camera sees; nanometres are expected: is {1e3 * value:g} meant "
            "(micrometres given)?"
        )
    return value


#: Far infrared is 1e5 nm; what is given in micrometres is found out afterwards.
Wavelength = Annotated[float, Within(1e-3, 1e6, "nm"), AfterValidator(_in_nm)]
#: Lines of a frame, and bands of its maps (imaging spectrometers have 500).
MOST_LINES, MOST_BANDS = 100_000, 4096
#: Ways of giving the wavelengths of a filter along the lines, distinguished before they are checked.
_LIST, _RANGE, _HEADER = "as-list", "as-range", "as-header"


class WavelengthRange(SchemaSection):
    """Wavelengths that change evenly from the first line to the last."""

    first: Wavelength = Field(alias="from", description="nm, of line 0")
    last: Wavelength = Field(alias="to", description="nm, of the last line; less than `from` if they fall")


def _a_way(value: object) -> object:
    if not isinstance(value, list | dict | str | WavelengthRange):
        raise ValueError(
            f"{shown(value)} is not allowed: a list with one wavelength (nm) per line, "
            "{ from = 450, to = 900 }, or the name of an ENVI header are; of a camera without a filter along "
            "its lines remove it, or give channel_nm"
        )
    return value


def _way(value: object) -> str:
    return _HEADER if isinstance(value, str) else _LIST if isinstance(value, list) else _RANGE


Wavelengths = Annotated[
    Annotated[list[Wavelength], Field(max_length=MOST_LINES), Tag(_LIST)]
    | Annotated[WavelengthRange, Tag(_RANGE)]
    | Annotated[FileName, Tag(_HEADER)],
    Discriminator(_way),
]


class SequenceHeader(DatedSection):
    """``[sequence]``: what this data set is called and when t = 0 was."""

    name: Title = Field(default="frame sequence", description="Title of the report")
    epoch: Title | None = Field(
        default=None, description="UTC instant of t = 0, ISO 8601; default for photographs: the first one"
    )


_Lever = Annotated[float, Within(-1e3, 1e3, "m", "are these mm?")]


class SequenceCamera(FrameCameraSection):
    """``[camera]``: of all frames; its lens, how it sits in the body, what each pixel sees."""

    shape: FrameShape | None = Field(
        default=None, description="(lines, columns) of a frame; default that of most frames"
    )
    focal_length_px: FocalLengthPx | None = Field(
        default=None, description="Focal length / pixel pitch; default what EXIF or XMP of photographs say"
    )
    wavelength_nm: Annotated[Wavelengths, BeforeValidator(_a_way)] | None = Field(
        default=None, description="One per line, { from, to } of lines 0 and last, or an ENVI header"
    )
    mosaic_nm: list[Annotated[list[Wavelength], Field(max_length=64)]] | None = Field(
        default=None, max_length=64, description="Rows of a pattern that repeats from pixel (0, 0)"
    )
    channel_nm: list[Wavelength] | None = Field(
        default=None, max_length=MOST_BANDS, description="One per band of the image"
    )
    readout_time: ReadoutForward = Field(
        default=0.0, description="s from the exposure of line 0 to that of the last line (rolling shutter)"
    )
    readout_time_sigma: TimeSigma = Field(
        default=0.0, description="s, 1-sigma of readout_time, then found with the poses; 0: it is kept"
    )
    lever_arm: tuple[_Lever, _Lever, _Lever] = Field(
        default=(0.0, 0.0, 0.0),
        description="m, body axes: from the camera to the point that positions are of, such as an antenna",
    )

    @field_validator("mosaic_nm")
    @classmethod
    def _rows_alike(cls, value: list[list[float]] | None) -> list[list[float]] | None:
        if value is not None and (not value or not value[0] or len({len(row) for row in value}) > 1):
            raise ValueError("rows of equal length are expected, such as [[450.0, 500.0], [550.0, 600.0]]")
        return value

    @model_validator(mode="after")
    def _filter_said_once(self) -> SequenceCamera:
        filters = [k for k in ("wavelength_nm", "mosaic_nm", "channel_nm") if getattr(self, k) is not None]
        if len(filters) > 1:
            raise ValueError(
                f"{' and '.join(filters)} are given; keep one of them: a filter is given per line, as a "
                "mosaic, or per band of the image"
            )
        self._filter_fits()
        return self

    def _filter_fits(self) -> None:
        given = self.wavelength_nm
        if isinstance(given, list) and self.shape is not None and len(given) != self.shape[0]:
            raise ValueError(
                f"wavelength_nm has {len(given)} values, shape {self.shape[0]} lines; one per line is "
                "expected, from line 0 on, or { from = ..., to = ... } where they change evenly"
            )
        if given == []:
            raise ValueError(
                "wavelength_nm is empty; one per line is expected, { from = ..., to = ... }, or no key"
            )
        if self.channel_nm == []:
            raise ValueError("channel_nm is empty; one per band of the image is expected")


#: rad, m: 1-sigma of how a camera of a rig is turned, and of where it lies, for which nothing is said.
RIG_ANGLE_SIGMA, RIG_PLACE_SIGMA = 0.035, 0.05
_OffsetAngle = Annotated[float, Within(-6.3, 6.3, "rad", "are these degrees?")]
_OffsetLength = Annotated[float, Within(-1e3, 1e3, "m", "are these mm?")]


class RigCameraSection(FrameCameraSection):
    """One ``[[camera]]`` of several that are exposed together: its lens, and how it sits beside the first."""

    name: Name = Field(description="Of the camera, such as its band")
    images: FileName | None = Field(
        default=None,
        description='Which files of the folder `frames` are its images, such as "IMG_*_1.tif": what the * '
        "stands for names the capture; default by the tags of the files",
    )
    shape: FrameShape | None = Field(
        default=None, description="(lines, columns) of a frame; default that of most frames"
    )
    focal_length_px: FocalLengthPx | None = Field(
        default=None, description="Focal length / pixel pitch; default what EXIF or XMP of its images say"
    )
    wavelength_nm: Annotated[float, Within(1e-3, 1e6, "nm"), AfterValidator(_in_nm)] | None = Field(
        default=None, description="nm, of its band; default what XMP says"
    )
    channel_nm: list[Wavelength] | None = Field(
        default=None,
        min_length=1,
        max_length=MOST_BANDS,
        description="One per band of its images, of a colour camera",
    )
    orientation_offset: tuple[_OffsetAngle, _OffsetAngle, _OffsetAngle] | None = Field(
        default=None,
        description="rad; rotation vector (roll, pitch, yaw) about body axes by which it is turned from the "
        "first camera; default by XMP, else none",
    )
    orientation_offset_sigma: AngleSigma | None = Field(
        default=None, description="rad per axis; 0 = exactly; default 0.0087 by XMP, else 0.035"
    )
    position_offset: tuple[_OffsetLength, _OffsetLength, _OffsetLength] = Field(
        default=(0.0, 0.0, 0.0),
        description="m; of its lens from that of the first camera along body axes (forward, right, down)",
    )
    position_offset_sigma: LengthSigma = Field(default=RIG_PLACE_SIGMA, description="m per axis; 0 = exactly")

    @model_validator(mode="after")
    def _band_said_once(self) -> RigCameraSection:
        if self.wavelength_nm is not None and self.channel_nm is not None:
            raise ValueError("wavelength_nm and channel_nm are both given; keep one of them")
        return self

    def as_camera(self) -> SequenceCamera:
        """What it says of the camera alone."""
        own = {"shape", "focal_length_px", "channel_nm", *FrameCameraSection.model_fields}
        given = {key: getattr(self, key) for key in own & self.model_fields_set}
        return SequenceCamera.model_validate(given)


def _a_camera(value: object) -> object:
    if not isinstance(value, dict | list | SequenceCamera):
        raise ValueError(
            f"{shown(value)} is not allowed: a table [camera] is, or a [[camera]] for each of a rig"
        )
    if isinstance(value, list) and len(value) < 2:
        raise ValueError("a rig has two [[camera]] or more; of one camera write [camera]")
    return value


_ONE, _RIG = "as-table", "as-list"
Cameras = Annotated[
    Annotated[SequenceCamera, Tag(_ONE)]
    | Annotated[list[RigCameraSection], Field(max_length=MOST_LISTED), Tag(_RIG)],
    Discriminator(lambda value: _RIG if isinstance(value, list) else _ONE),
]


class SubsetSection(SchemaSection):
    """``[subset]``: frames that photogrammetry is done on."""

    overlap: Annotated[float, Within(0.3, 0.999, "", "a share of the frame: 0.8 for 80 %")] = Field(
        default=0.8, description="Wanted along the flight, share of the frame"
    )


class CubeSection(SchemaSection):
    """``[cube]``: maps of every band; ``make = false``: none."""

    make: bool = Field(default=True, description="Make the maps")
    gsd: GroundSample | None = Field(
        default=None, description="m, side of a pixel; default that of the frames on the ground"
    )
    bands: (
        Annotated[int, Within(1, MOST_BANDS)]
        | Annotated[list[Wavelength], Field(max_length=MOST_BANDS)]
        | None
    ) = Field(
        default=None,
        description="How many, or their wavelengths (nm); default each step of a filter that has steps, else "
        "as many as leave each enough lines for the steps flown",
    )
    surface: Literal["auto", "model", "given"] = Field(
        default="auto",
        description="Heights: of the points found (model), of [surface] (given), or whichever is better",
    )
    fill_nm: WavelengthReach | None = Field(
        default=None,
        description="How far beyond a band's own wavelengths lines may stand in where a step between frames "
        "was too long; default less than half the band's width",
    )
    flatten: bool = Field(
        default=True, description="Make the lines of a filter alike before they are resampled"
    )
    picture_nm: list[Wavelength] | None = Field(
        default=None,
        max_length=3,
        description="nm; red, green and blue of the pictures, each the band nearest to it; default 650, 550, "
        "470 where the bands reach them",
    )
    formats: list[Literal["tif", "zarr", "netcdf", "envi"]] = Field(
        default=["tif"], max_length=4, description='Files; "zarr" and "netcdf" need the extra cube'
    )
    one_file: bool = Field(default=False, description="One GeoTIFF of all bands in place of one for each")

    @field_validator("bands")
    @classmethod
    def _bands_differ(cls, value: int | list[float] | None) -> int | list[float] | None:
        if isinstance(value, list) and len(set(value)) < max(len(value), 1):
            raise ValueError("wavelengths (nm) are expected, one or more, each once; or how many bands")
        return value

    @field_validator("picture_nm", mode="before")
    @classmethod
    def _red_green_blue(cls, value: object) -> object:
        if isinstance(value, list) and len(value) != 3:
            raise ValueError("three wavelengths (nm) are expected: [red, green, blue]")
        return value

    @field_validator("formats")
    @classmethod
    def _some_format(cls, value: list[str]) -> list[str]:
        if not value or len(set(value)) < len(value):
            raise ValueError('one or more of "tif", "zarr", "netcdf", "envi" are expected, each once')
        return value


class SequenceFile(InputFile):
    """A SEQUENCE.toml: overlapping frames of a camera or of a rig, and what is known of their poses."""

    sequence: SequenceHeader = SequenceHeader()
    frames: FileName = Field(
        description="Folder of images (times by EXIF), or CSV frame,t,image; of a rig capture,camera,t,image"
    )
    events: FileName | None = Field(
        default=None,
        description="CSV t, or frame,t: when frames were exposed, by the marks of a receiver; in their order "
        "without names",
    )
    positions: FileName | None = Field(
        default=None,
        description="CSV frame,t,x,y,z,sigma_x,sigma_y,sigma_z, axes of [world]; or a SBET",
    )
    attitudes: FileName | None = Field(
        default=None,
        description="CSV frame,t,qx,qy,qz,qw,sigma_roll,sigma_pitch,sigma_yaw: world_from_body; or a SBET",
    )
    geo: FileName | None = Field(default=None, description="geo.txt of OpenDroneMap in place of positions")
    poses: FileName | None = Field(
        default=None,
        description="Model of another program in place of positions and attitudes: folder of a COLMAP model, "
        "reconstruction.json of OpenSfM, or CSV frame,x,y,z,omega,phi,kappa or frame,x,y,z,yaw,pitch,roll",
    )
    position_bias_sigma: LengthSigma | None = Field(
        default=None,
        description="m per axis: constant error of all positions, to be estimated; 0 = none; default of a "
        "table none, of EXIF, geo.txt and poses as large as a position's own sigma",
    )
    attitude_bias_sigma: AngleSigma | None = Field(
        default=None,
        description="rad per body axis: constant error of all attitudes; 0 = none; default of a table none, "
        "of gimbals in XMP and of poses as large as attitude_sigma",
    )
    position_sigma: LengthSigmaAbove0 = Field(
        default=POSITION_SIGMA, description="m per axis, of EXIF, geo.txt and poses where they give none"
    )
    attitude_sigma: AngleSigmaAbove0 = Field(
        default=ATTITUDE_SIGMA, description="rad per axis, of angles of a gimbal in XMP, and of poses"
    )
    altitude: Height | None = Field(
        default=None, description="m above the ellipsoid, of photographs and geo.txt that give no height"
    )
    control_points: FileName | None = Field(
        default=None, description="CSV x,y,z,sigma,image,line,column of ground control points"
    )
    gcp_list: FileName | None = Field(default=None, description="gcp_list.txt of OpenDroneMap")
    gcp_sigma: LengthSigmaAbove0 = Field(default=0.05, description="m per axis, of the points of gcp_list")
    control_sigma_px: PixelSigmaAbove0 = Field(
        default=1.0, description="px, of where control points were seen"
    )
    camera: Annotated[Cameras, BeforeValidator(_a_camera)] = SequenceCamera()
    subset: SubsetSection = SubsetSection()
    surface: SurfaceSection = SurfaceSection()
    cube: CubeSection = CubeSection()
    world: WorldSection = WorldSection()
    control_point: list[ControlPointSection] = Field(
        default=[], max_length=MOST_LISTED, description="Control points one by one"
    )

    @property
    def first_camera(self) -> SequenceCamera:
        """The camera, of a rig the first, whose body is that of the rig."""
        return self.camera[0].as_camera() if isinstance(self.camera, list) else self.camera

    @model_validator(mode="after")
    def _cameras_differ(self) -> SequenceFile:
        if isinstance(self.camera, list):
            names = [camera.name for camera in self.camera]
            twice = next((name for name in names if names.count(name) > 1), None)
            if twice is not None:
                raise ValueError(f"two [[camera]] are called {twice!r}; give each a name of its own")
            for key in ("orientation_offset", "position_offset"):
                if any(getattr(self.camera[0], key) or ()):
                    raise ValueError(
                        f"{key} of the first [[camera]] must be zero: offsets are counted from it"
                    )
        return self

    @model_validator(mode="after")
    def _parts_agree(self) -> SequenceFile:
        if self.surface.kind is not None:
            raise ValueError("surface.kind is for stars; a sequence of frames looks at ground: remove it")
        if self.geo is not None and self.positions is not None:
            raise ValueError("positions and geo are both given; keep one of them")
        if self.poses is not None and self.attitudes is not None and (self.positions or self.geo):
            raise ValueError(
                "poses would add nothing beside attitudes and positions (or geo), which go before it; "
                "remove poses, or what goes before it"
            )
        ways = [k for k in ("control_point", "control_points", "gcp_list") if getattr(self, k)]
        if len(ways) > 1:
            raise ValueError(f"{' and '.join(ways)} are given; keep one of them")
        if (self.gcp_list or self.geo) and self.world.frame == "local" and self.world.origin is None:
            raise ValueError(
                'gcp_list and geo hold map coordinates: give [world] frame = "lonlat" or "earth-fixed", or '
                "local axes with an origin"
            )
        return self
