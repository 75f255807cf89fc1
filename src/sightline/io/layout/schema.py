"""What an INSTRUMENT.toml may hold: the instrument that ``sightline layout`` finds places for.

The contract of ``docs/formats.md`` as pydantic models; the JSON Schema of ``sightline schema instrument`` is
generated from here.

Not here: reading the file (``io/config.py``), what is made of it (``load.py``).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sightline.geometry.camera import MOST_STAGES
from sightline.io.acquisition.schema import InputFile, SchemaSection
from sightline.io.quantities import (
    Duration,
    FocalLengthPx,
    Frequency,
    LinePeriod,
    Name,
    PixelPlace,
    PixelSigmaAbove0,
    Seconds,
    Title,
    Within,
    shown,
)

#: Lines of a focal plane: multispectral scanners place ten or twenty, imaging spectrometers a whole matrix.
Detectors = Annotated[int, Within(2, 64)]
#: Of a detector to choose lines of: matrices of 10,000 lines.
MOST_LINES = 100_000
#: Lines of a row of windows, and from one to the next.
Lines = Annotated[float, Within(1.0, 1e6, "lines")]
#: Detectors sum 8 to 256 lines.
Stages = Annotated[int, Within(1, MOST_STAGES, "stages")]
#: On a focal plane: stereo cameras look 25 degrees ahead and back, 300,000 px apart; mosaics end at 1e6.
Separation = Annotated[float, Within(1e-3, 1e7, "px")]
#: px a second: microscopes 1, satellites 1e3 to 1e4, the fastest line cameras 3e5.
GroundRate = Annotated[float, Within(1e-4, 1e8, "px/s")]


class PriorSection(SchemaSection):
    """``[[prior]]``: one part of the motion that is expected."""

    kind: Literal["matern", "tone"] = Field(
        default="matern", description='"matern": drift or broadband jitter; "tone": a narrow line'
    )
    sigma_px: PixelSigmaAbove0 = Field(description="Its standard deviation, px")
    timescale: Duration | None = Field(default=None, description="s, of a matern; or corner")
    corner: Frequency | None = Field(
        default=None, description="Hz, of a matern: its spectrum is flat below and falls above"
    )
    order: Literal["3/2", "5/2", "9/2", "17/2"] | None = Field(
        default=None, description='Smoothness of a matern (default "3/2"); a drift is "5/2"'
    )
    frequency: Frequency | None = Field(default=None, description="Hz, of a tone")
    bandwidth: Frequency | None = Field(
        default=None, description="Hz, full width at half maximum of a tone (default 1 % of its frequency)"
    )

    @model_validator(mode="after")
    def _keys_belong_to_its_kind(self) -> PriorSection:
        other = ("frequency", "bandwidth") if self.kind == "matern" else ("timescale", "corner", "order")
        foreign = [key for key in other if getattr(self, key) is not None]
        if foreign:
            raise ValueError(f'kind = "{self.kind}" takes no {foreign[0]}; remove it')
        if self.kind == "matern" and (self.timescale is None) == (self.corner is None):
            raise ValueError('kind = "matern" takes either timescale (s) or corner (Hz); give one of them')
        if self.kind == "tone" and self.frequency is None:
            raise ValueError('kind = "tone" needs frequency (Hz); add it')
        return self


class LayoutSection(SchemaSection):
    """``[[layout]]``: a layout of one's own to compare with."""

    name: Name = Field(default="yours")
    positions_px: list[PixelPlace] | None = Field(
        default=None, max_length=64, description="px along the track, two or more"
    )
    positions_s: list[Seconds] | None = Field(
        default=None,
        max_length=64,
        description="s; when each detector sees the ground, in place of positions_px",
    )

    @model_validator(mode="after")
    def _positions_are_a_layout(self) -> LayoutSection:
        given = [p for p in (self.positions_px, self.positions_s) if p is not None]
        if len(given) != 1:
            raise ValueError("a [[layout]] takes either positions_px or positions_s; give one of them")
        if len(given[0]) < 2:
            raise ValueError(f"a [[layout]] needs two or more positions, got {len(given[0])}")
        if len(set(given[0])) < len(given[0]):
            raise ValueError(
                f"two detectors stand at the same place: {shown(given[0])}; positions must differ"
            )
        return self


class InstrumentFile(InputFile):
    """An INSTRUMENT.toml: what is known of an instrument before its detectors have places."""

    name: Title = Field(default="instrument", description="Title of the report")
    focal_length_px: FocalLengthPx = Field(description="Focal length / pixel pitch")
    line_period: LinePeriod = Field(description="s between image lines")
    ground_rate_px: GroundRate | None = Field(
        default=None,
        description="Pixels per second at which the ground crosses the focal plane (default 1 / line_period)",
    )
    match_sigma_px: PixelSigmaAbove0 | None = Field(
        default=None,
        description="1-sigma of a match between two images, px, per row of windows (all columns together)",
    )
    image_sigma_px: list[PixelSigmaAbove0] | None = Field(
        default=None,
        max_length=64,
        description="In its place, the error of each image: a match has the variances of both",
    )
    window_lines: Lines = Field(default=1.0, description="Lines that a row of windows spans")
    step_lines: Lines = Field(default=1.0, description="Lines from one row of windows to the next")
    detectors: Detectors | None = Field(
        default=None, description="How many to place, or lines of one to choose"
    )
    stages: Stages | Annotated[list[Stages], Field(max_length=64)] | None = Field(
        default=None,
        description="TDI stages of every image, or one number per detector: each averages the motion over as "
        "many line periods",
    )
    span_px: Separation | None = Field(
        default=None, description="Most distance between the first and the last detector, px"
    )
    span_s: Duration | None = Field(default=None, description="The same in s")
    min_spacing_px: Separation = Field(default=1.0, description="Least distance between neighbours, px")
    step_px: Separation | None = Field(
        default=None, description="Places are multiples of it, px; without it any place will do"
    )
    lines: (
        Annotated[int, Within(2, MOST_LINES)]
        | Annotated[list[PixelPlace], Field(max_length=MOST_LINES)]
        | None
    ) = Field(
        default=None,
        description="In place of span and step: lines of one detector, their number or their places in px",
    )
    duration: Duration | None = Field(
        default=None, description="s, of a strip (default 20 periods of the lower end, 2 s at least)"
    )
    prior: list[PriorSection] = Field(
        default=[], max_length=64, description="Parts of the motion that is expected"
    )
    layout: list[LayoutSection] = Field(
        default=[], max_length=64, description="Layouts of one's own to compare with"
    )

    @model_validator(mode="after")
    def _one_of_each(self) -> InstrumentFile:
        self._check_noise()
        if self.lines is None:
            if (self.span_px is None) == (self.span_s is None):
                raise ValueError("give either span_px or span_s, or lines of one detector to choose from")
            return self
        for key in ("span_px", "span_s", "step_px"):
            if getattr(self, key) is not None:
                raise ValueError(
                    f"lines says where the lines are, {key} is then not taken; remove one of them"
                )
        if isinstance(self.lines, list) and len(set(self.lines)) < len(self.lines):
            raise ValueError("lines holds a place twice; every line needs a place of its own")
        return self

    def _check_noise(self) -> None:
        if (self.match_sigma_px is None) == (self.image_sigma_px is None):
            raise ValueError("give either match_sigma_px, or image_sigma_px with one value per detector")
        count = None if self.image_sigma_px is None else len(self.image_sigma_px)
        if self.detectors is None and count is None:
            raise ValueError("key 'detectors' is missing: how many have to be placed; add it")
        if count is not None and (count < 2 or self.detectors not in (None, count)):
            wanted = "two or more" if self.detectors is None else f"detectors = {self.detectors}"
            raise ValueError(
                f"image_sigma_px holds {count} values, but there are {wanted}; give one for each"
            )
        count = self.detectors if count is None else count
        if isinstance(self.stages, list) and len(self.stages) != count:
            raise ValueError(
                f"stages holds {len(self.stages)} values, but there are detectors = {count}; give one for "
                "each, or one number for all"
            )
