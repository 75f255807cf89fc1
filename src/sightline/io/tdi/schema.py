"""What a TDI.toml may hold: keys, types, defaults and allowed values.

The contract of ``docs/formats.md`` as pydantic models; the JSON Schema of ``sightline schema tdi`` is
generated from here.

Not here: reading the file (``io/config.py``), what is made of it (``load.py``).
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from sightline.io.acquisition.schema import InputFile, SchemaSection
from sightline.io.quantities import FileName, Name, ShareBelow1, ShareOrNone, Title, Within, shown
from sightline.tdi.setting import MOST_RATIOS, MOST_STAGES, SLIP_LIMIT

#: More would not fit into memory, nor onto a focal plane.
MOST_COLUMNS, MOST_SIGNALS = 1_000_000, 10_000

#: Integration time over the line period; a line of 1e-4 s is not cut shorter than 1e-8 s.
Share = Annotated[float, Within(1e-4, 1.0, "of the line period")]
#: Detectors sum 8 to 256 lines.
Stages = Annotated[int, Within(1, MOST_STAGES, "stages", "a word of the table has 9 bits for them")]
Spatial = Annotated[float, Within(1e-4, 0.5, "cycles per pixel")]
Mtf = Annotated[float, Within(1e-6, 1.0)]
#: Of a line, where single photons are counted and where a well of a large thermal detector fills.
Electrons = Annotated[float, Within(1e-3, 4.29e9, "electrons", "32 bits count them")]
#: rms; the best sCMOS read 0.3, thermal detectors 1e4.
NoiseElectrons = Annotated[float, Within(1e-6, 1e9, "electrons", zero=True)]
#: Of gains: detectors are flat to 1e-4 at best, their variance to 1e-8.
RelativeVariance = Annotated[float, Within(1e-16, 100.0, "", zero=True)]
#: A list or a range in its place, distinguished before they are checked: messages are about what was meant.
_LIST, _RANGE = "as-list", "as-range"


def _shape(value: object) -> str:
    return _LIST if isinstance(value, list | tuple) else _RANGE


Well = Annotated[float, Within(1.0, 1e15, "electrons", infinite=True)]
#: Of a pixel and of what blurs it: beyond some pixels nothing of a half cycle is left.
Width = Annotated[float, Within(1e-6, 100.0, "px", zero=True)]


class StageRange(SchemaSection):
    """Stages from one number to another."""

    start: Stages = Field(alias="from", description="Fewest stages")
    stop: Stages = Field(alias="to", description="Most stages")
    step: Stages = Field(default=1, description="Distance between them")


class RatioRange(SchemaSection):
    """Integration ratios from one to another."""

    start: Share = Field(alias="from", description="Shortest")
    stop: Share = Field(alias="to", description="Longest")
    step: Share = Field(description="Distance between them")

    @property
    def count(self) -> int:
        """How many they are."""
        return int(np.floor((self.stop - self.start) / self.step + 1e-9)) + 1


class GridSection(SchemaSection):
    """``[grid]``: the settings that the detector offers, every number of stages with every ratio."""

    stages: Annotated[
        Annotated[list[Stages], Field(max_length=MOST_STAGES), Tag(_LIST)]
        | Annotated[StageRange, Tag(_RANGE)],
        Discriminator(_shape),
    ] = Field(description="Numbers of TDI stages, head included: a list, or { from, to, step }")
    integration_ratio: Annotated[
        Annotated[list[Share], Field(max_length=MOST_RATIOS), Tag(_LIST)]
        | Annotated[RatioRange, Tag(_RANGE)],
        Discriminator(_shape),
    ] = Field(
        description="Integration time over the line period, above 0 to 1: a list, or { from, to, step }"
    )

    @property
    def stage_list(self) -> list[int]:
        """All numbers of stages."""
        given = self.stages
        return (
            list(range(given.start, given.stop + 1, given.step)) if isinstance(given, StageRange) else given
        )

    @property
    def ratio_list(self) -> list[float]:
        """All integration ratios."""
        given = self.integration_ratio
        if not isinstance(given, RatioRange):
            return given
        # rounded, so that 0.05 x 20 is 1 and not a hair above
        return [float(np.round(given.start + k * given.step, 12)) for k in range(given.count)]

    @field_validator("stages", "integration_ratio", mode="before")
    @classmethod
    def _a_list_or_a_range(cls, value: object, info: ValidationInfo) -> object:
        if not isinstance(value, list | tuple | dict | StageRange | RatioRange):
            example = "[8, 16, 32]" if info.field_name == "stages" else "[0.5, 1.0]"
            words = f"a list is, as {example}, or a range {{ from, to, step }}"
            raise PydanticCustomError("bound", "{words}", {"words": words})
        return value

    @field_validator("stages", "integration_ratio")
    @classmethod
    def _rising(cls, value: object) -> object:
        if isinstance(value, list):
            if not value:
                raise ValueError("the list is empty; one value at least is needed")
            if sorted(set(value)) != value:
                raise ValueError(f"{shown(value)} must rise from value to value, none twice")
        elif isinstance(value, StageRange | RatioRange) and value.stop < value.start:
            raise ValueError(f"from = {value.start} lies above to = {value.stop}; exchange them")
        if isinstance(value, RatioRange) and value.count > MOST_RATIOS:
            raise ValueError(
                f"from {value.start:g} to {value.stop:g} by {value.step:g} are {value.count:,} integration "
                f"ratios; a word of the table has bits for {MOST_RATIOS}: a longer step is needed"
            )
        return value


class HeadSection(SchemaSection):
    """``[head]``: the first lines, which are always read alike and measure the signal."""

    stages: Annotated[int, Within(0, MOST_STAGES)] = Field(default=0, description="How many (N0); 0: none")
    integration_ratio: Annotated[float, Within(1e-4, 1.0, "of the line period", zero=True)] = Field(
        default=0.0, description="Their integration time over the line period (Kt0), above 0 with a head"
    )

    @model_validator(mode="after")
    def _a_head_has_a_ratio(self) -> HeadSection:
        if self.stages and self.integration_ratio == 0.0:
            raise ValueError("integration_ratio of the head is missing; add it, or set stages = 0")
        return self


class NoiseSection(SchemaSection):
    """``[noise]``: variance of one line of s electrons: gain s^2 + shot s + dark Kt + read^2."""

    gain: RelativeVariance = Field(
        default=0.0, description="A: relative variance of a line's gain, line to line (1)"
    )
    shot: Annotated[float, Within(1e-6, 1e6, "", zero=True)] = Field(
        default=1.0, description="B: variance per electron; 1 for photons"
    )
    read: NoiseElectrons = Field(default=0.0, description="C: electrons rms per line")
    dark: NoiseElectrons = Field(
        default=0.0, description="D: electrons per line at an integration ratio of 1"
    )
    output: NoiseElectrons = Field(default=0.0, description="C_out: electrons rms, once per sum")
    column_fixed: RelativeVariance = Field(
        default=0.0, description="A_col: relative variance of a column's pattern, common to all its lines (1)"
    )
    table: FileName | None = Field(
        default=None,
        description="CSV column and any of gain,shot,read,dark,output,full_well_line,full_well_sum,"
        "diffusion_sigma_px: those of each column, in place of the key for all",
    )

    @model_validator(mode="after")
    def _something_is_noisy(self) -> NoiseSection:
        given = (self.gain, self.shot, self.read, self.dark, self.output, self.column_fixed)
        if self.table is None and not any(given):
            raise ValueError(
                "no noise: every setting would have an infinite SNR; shot = 1 is that of photons"
            )
        return self


#: Of scan velocities and slip angles, in files and in tables.
VELOCITY_SIGMA = Within(1e-9, 1.0, "px per line period", zero=True)
SLIP_SIGMA = Within(1e-9, 1.5, "rad", zero=True)


class ColumnsSection(SchemaSection):
    """``[columns]``: how the scene moves past each column."""

    count: Annotated[int, Within(1, MOST_COLUMNS, "columns")] | None = Field(
        default=None, description="So many columns, in step with the clock (V = 1, g = 0)"
    )
    table: FileName | None = Field(
        default=None,
        description="CSV column,scan_velocity,slip[,optics_mtf_x,optics_mtf_y][,sigma_velocity,sigma_slip]: "
        "pixels per line period, rad; beside acquisition column,optics_mtf_x,optics_mtf_y",
    )
    acquisition: FileName | None = Field(
        default=None, description="An ACQUISITION.toml whose cameras give velocity and slip"
    )
    band: Name | None = Field(default=None, description="Its band (default: the first)")
    sigma_velocity: Annotated[float, VELOCITY_SIGMA] = Field(
        default=0.0, description="1-sigma of every velocity, px per line period"
    )
    sigma_slip: Annotated[float, SLIP_SIGMA] = Field(
        default=0.0, description="1-sigma of every slip angle, rad"
    )

    @model_validator(mode="after")
    def _one_source(self) -> ColumnsSection:
        given = [key for key in ("count", "table", "acquisition") if getattr(self, key) is not None]
        if len(given) != 1 and given != ["table", "acquisition"]:
            said = " and ".join(given) or "none of them"
            raise ValueError(
                "give one of count, table and acquisition, or an acquisition with a table of the MTF of its "
                f"optics; {said} is there"
            )
        if self.band is not None and self.acquisition is None:
            raise ValueError("band belongs to acquisition; remove it, or give acquisition")
        return self


class SignalsSection(SchemaSection):
    """``[signals]``: electrons of one head line (or of one line at `integration_ratio`, without a head)."""

    list_: list[Electrons] | None = Field(
        default=None, alias="list", max_length=MOST_SIGNALS, description="Rising list, electrons"
    )
    start: Electrons | None = Field(default=None, alias="from", description="Lowest signal, electrons")
    stop: Electrons | None = Field(default=None, alias="to", description="Highest signal, electrons")
    count: Annotated[int, Within(2, MOST_SIGNALS, "signals")] | None = Field(
        default=None, description="How many, spaced evenly in the logarithm (default 32)"
    )
    integration_ratio: Share | None = Field(
        default=None,
        description="Integration ratio that signals are given for, where no head lines measure them "
        "(default 1)",
    )
    sigma: ShareBelow1 = Field(
        default=0.0, description="Relative 1-sigma of the signals, for instance measured by another detector"
    )

    @model_validator(mode="after")
    def _list_or_range(self) -> SignalsSection:
        if self.list_ is not None:
            if any(value is not None for value in (self.start, self.stop, self.count)):
                raise ValueError("give either list, or from, to and count")
            if not self.list_ or sorted(set(self.list_)) != self.list_:
                raise ValueError(
                    f"list = {shown(self.list_)} must hold one value or more, rising, none twice"
                )
        elif self.start is None or self.stop is None:
            raise ValueError("give list, or from and to (electrons; count of them)")
        elif not self.start < self.stop:
            raise ValueError(f"from = {self.start:g} must lie below to = {self.stop:g}")
        return self

    @property
    def electrons(self) -> list[float]:
        """All signals."""
        if self.list_ is not None:
            return self.list_
        return [float(value) for value in np.geomspace(self.start or 1.0, self.stop or 1.0, self.count or 32)]


class MtfSection(SchemaSection):
    """``[mtf]``: where MTF is judged, and what blurs besides motion."""

    frequencies: tuple[Spatial, Spatial] = Field(
        default=(0.5, 0.5), description="Cycles per pixel across and along the column; one number: both"
    )
    aperture_x: Width = Field(default=1.0, description="Photosensitive width across, px")
    aperture_y: Width = Field(default=1.0, description="Photosensitive width along, px")
    diffusion_sigma_px: Width = Field(default=0.0, description="Gaussian diffusion of the charge, px")
    optics_mtf: Mtf | tuple[Mtf, Mtf] | None = Field(
        default=None,
        description="MTF of the optics at the frequencies: one for both, or [across, along]; default 1, or "
        "that of optics_cutoff",
    )
    optics_cutoff: Annotated[float, Within(1e-3, 1e6, "cycles per pixel")] | None = Field(
        default=None,
        description="In place of optics_mtf: cycles per pixel where diffraction ends, "
        "pixel / (wavelength x f-number)",
    )
    obscuration: Annotated[float, Within(0.0, 0.99)] = Field(
        default=0.0, description="Of the pupil, by diameter, with optics_cutoff"
    )
    wavefront: Annotated[float, Within(0.0, 0.18, "waves rms", below=True)] = Field(
        default=0.0, description="Waves rms of wavefront error, with optics_cutoff"
    )

    @field_validator("frequencies", mode="before")
    @classmethod
    def _both_alike(cls, value: object) -> object:
        return (value, value) if not isinstance(value, list | tuple) else value

    @model_validator(mode="after")
    def _one_optics(self) -> MtfSection:
        if self.optics_mtf is not None and self.optics_cutoff is not None:
            raise ValueError("give either optics_mtf or optics_cutoff")
        if self.optics_cutoff is None and (self.obscuration or self.wavefront):
            raise ValueError("obscuration and wavefront belong to optics_cutoff; add it or remove them")
        return self


class ChoiceSection(SchemaSection):
    """``[choice]``: what is best, and what is allowed."""

    model: Literal["exact", "patent"] = Field(
        default="exact", description='"patent": the form of EP2733929, for comparison'
    )
    merit: Literal["product", "geomean", "mean", "min", "x", "y"] = Field(
        default="product", description="How the MTFs across (x) and along (y) are put together, times SNR"
    )
    main_lobe_only: bool = Field(
        default=True, description="Refuse settings whose stages slip by more than a cycle in all"
    )
    align: Literal["centre", "start", "end"] = Field(
        default="centre", description="Where in the line period the exposures lie"
    )
    snr_min: Annotated[float, Within(0.0, 1e7)] = Field(default=0.0, description="Least SNR of the sum")
    mtf_min: ShareOrNone = Field(default=0.0, description="Least MTF, each axis")
    mtf_max: ShareOrNone = Field(default=1.0, description="Most MTF, each axis")
    full_well_line: Well = Field(default=np.inf, description="Electrons that a line can hold")
    full_well_sum: Well = Field(default=np.inf, description="Electrons that the sum can hold")
    slip_limit: (
        Annotated[float, Within(1e-6, 1.5, "rad", 'or "allow"; are these degrees?', below=True)]
        | Literal["allow"]
    ) = Field(
        default=SLIP_LIMIT,
        description='rad; columns that slip more are refused (default 5 degrees); "allow" takes any',
    )

    quantile: Annotated[float, Within(1e-4, 0.9999)] | None = Field(
        default=None,
        description="Where motion or signal is uncertain, judge a setting by this quantile of its merit "
        "(default: by its mean)",
    )
    hysteresis: ShareBelow1 = Field(
        default=0.0, description="Share of merit that a column may lose to keep its neighbour's setting"
    )
    max_step: Annotated[int, Within(1, MOST_STAGES)] | None = Field(
        default=None, description="Most change of stages from column to column, in steps of the grid"
    )


class TableSection(SchemaSection):
    """``[table]``: the table that is looked up at line rate."""

    max_loss: Annotated[float, Within(1e-6, 1.0, "", "a share of the merit", below=True)] = Field(
        default=0.005, description="Most relative merit that a cell may lose, certified"
    )


class MotionSection(SchemaSection):
    """``[motion]``: what the images of ``--motion`` were taken with."""

    stages: Stages = Field(default=1, description="TDI stages of the images that the motion came from")
    integration_ratio: Share = Field(default=1.0, description="Integration ratio of those images")


class TdiFile(InputFile):
    """A TDI.toml: a detector, its columns, its signals, and what is wanted of them."""

    name: Title = Field(default="TDI choice", description="Title of the report")
    grid: GridSection
    head: HeadSection = HeadSection()
    noise: NoiseSection = NoiseSection()
    columns: ColumnsSection
    signals: SignalsSection
    mtf: MtfSection = MtfSection()
    choice: ChoiceSection = ChoiceSection()
    table: TableSection = TableSection()
    motion: MotionSection = MotionSection()

    @model_validator(mode="after")
    def _parts_agree(self) -> TdiFile:
        fewest, head = self.grid.stage_list[0], self.head.stages
        if fewest < head:
            raise ValueError(
                f"grid.stages begins with {fewest}, but {head} head lines are always read; begin with {head} "
                "or more"
            )
        well, highest = self.choice.full_well_line, self.signals.electrons[-1]
        if head and well < highest:
            raise ValueError(
                f"choice.full_well_line = {well:g} electrons lies below the highest signal of a head line, "
                f"{highest:g}: it would saturate before anything can be chosen; lower [signals], shorten the "
                "head's integration_ratio, or correct the full well"
            )
        if head and self.signals.integration_ratio is not None:
            raise ValueError(
                "signals.integration_ratio is for signals that no head line measures; remove it, or the head"
            )
        if self.choice.mtf_min > self.choice.mtf_max:
            raise ValueError(
                f"choice.mtf_min = {self.choice.mtf_min:g} lies above mtf_max = {self.choice.mtf_max:g}"
            )
        return self
