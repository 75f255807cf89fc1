"""What the choice is made from: the grid of settings, the detector, its columns, and the rules.

Not here: what a setting makes of the image (``merit.py``), the choice (``choose.py``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure

Array = NDArray[np.float64]
Index = NDArray[np.intp]

MERITS = ("product", "geomean", "mean", "min", "x", "y")
MODELS = ("exact", "patent")
#: Bits of a word of the table, from the lowest: stages, number of the integration ratio; flags follow.
STAGE_BITS, RATIO_BITS = 9, 5
MOST_STAGES, MOST_RATIOS = (1 << STAGE_BITS) - 1, 1 << RATIO_BITS
#: rad; beyond this slip angle the scene leaves the column within a few stages (EP2733929: 5 degrees).
SLIP_LIMIT = float(np.radians(5.0))


@dataclass(frozen=True, eq=False)
class TdiGrid:
    """Settings that the detector offers: every number of stages with every integration ratio.

    Attributes
    ----------
    stages : (n,) int
        Rising.
    ratios : (k,)
        Integration time over line period, rising, above 0 to 1.

    Raises
    ------
    InputError
        An empty or impossible grid.
    """

    stages: Index
    ratios: Array

    def __post_init__(self) -> None:
        stages, ratios = np.asarray(self.stages), np.asarray(self.ratios, dtype=np.float64)
        if stages.ndim != 1 or len(stages) == 0 or (stages < 1).any() or (np.diff(stages) <= 0).any():
            raise InputError(
                f"grid `stages` is {stages.tolist()}; whole numbers from 1 up, rising, are allowed"
            )
        if not np.issubdtype(stages.dtype, np.integer):
            raise InputError(f"grid `stages` is {stages.tolist()}; a number of stages is a whole number")
        if ratios.ndim != 1 or len(ratios) == 0 or not (np.diff(ratios) > 0).all():
            raise InputError(f"grid `integration_ratio` is {ratios.tolist()}; a rising list is allowed")
        if not (ratios[0] > 0.0 and ratios[-1] <= 1.0):
            raise InputError(
                f"grid `integration_ratio` is {ratios.tolist()}; shares of the line period, above 0 up to 1, "
                "are allowed"
            )
        object.__setattr__(self, "stages", stages.astype(np.intp))
        object.__setattr__(self, "ratios", ratios)

    def __len__(self) -> int:
        """Number of settings."""
        return len(self.stages) * len(self.ratios)

    @property
    def settings(self) -> tuple[Index, Array]:
        """Stages and ratio (n k,) of every setting: fewer stages first, then the shorter integration."""
        return np.repeat(self.stages, len(self.ratios)), np.tile(self.ratios, len(self.stages))

    def stages_of(self, setting: Index) -> Index:
        """Number of stages of settings by their number."""
        return np.asarray(self.stages[np.asarray(setting) // len(self.ratios)])

    def ratio_of(self, setting: Index) -> Array:
        """Integration ratio of settings by their number."""
        return np.asarray(self.ratios[np.asarray(setting) % len(self.ratios)])


@dataclass(frozen=True, eq=False)
class TdiDetector:
    """Head, noise and wells of the detector.

    Attributes
    ----------
    exposure : Exposure
        Head lines and where in the line period the exposures lie.
    noise : NoiseLaw
    reference : float or None
        Integration ratio that signals are given for; the head's by default, 1 without a head.
    full_well_line, full_well_sum : float
        Electrons that one line, and the sum of all, can hold.
    kinds : tuple of TdiDetector
        Where columns are unlike in noise or wells: one for each kind of column, alike in all else;
        `ScanColumns.kind` says which column is of which. Empty: all columns are like this.
    """

    exposure: Exposure = field(default_factory=Exposure)
    noise: NoiseLaw = field(default_factory=NoiseLaw)
    reference: float | None = None
    full_well_line: float = np.inf
    full_well_sum: float = np.inf
    kinds: tuple[TdiDetector, ...] = ()

    def __post_init__(self) -> None:
        for name in ("full_well_line", "full_well_sum"):
            value = getattr(self, name)
            if not value > 0.0:
                raise InputError(f"`{name}` is {value:g} electrons; a full well is above 0")

    @property
    def signal_ratio(self) -> float:
        """Integration ratio that signals are given for."""
        if self.reference is not None:
            return self.reference
        return self.exposure.head_ratio if self.exposure.head_stages else 1.0

    @property
    def without_wells(self) -> bool:
        """Whether nothing is too bright."""
        return bool(np.isinf(self.full_well_line) and np.isinf(self.full_well_sum))

    def of_column(self, columns: ScanColumns, place: int) -> TdiDetector:
        """What the column at a place of `columns` is like."""
        return self if columns.kind is None else self.kinds[int(columns.kind[place])]

    def by_kind(self, columns: ScanColumns) -> Iterator[tuple[TdiDetector, Index]]:
        """Each kind of column that there is among `columns`, and the places (c,) of its columns, rising."""
        if columns.kind is None:
            yield self, np.arange(len(columns))
            return
        order = np.argsort(columns.kind, kind="stable")
        number, first = np.unique(columns.kind[order], return_index=True)
        for k, places in zip(number, np.split(order, first[1:]), strict=True):
            yield self.kinds[int(k)], places


@dataclass(frozen=True, eq=False)
class ScanColumns:
    """How the scene moves past each column, and what blurs it besides.

    Attributes
    ----------
    column : (C,)
        Number in the detector line.
    velocity : (C,)
        Pixels per line period along the column; 1 = in step with the clock.
    slip : (C,)
        rad; angle of the movement to the column, positive towards increasing columns.
    static_mtf : (C, 2)
        MTF of optics, pixel and diffusion across and along, at the two frequencies of the rules.
    covariance : (C, 2, 2) or None
        Of velocity and slip; None where they are exact.
    kind : (C,) int or None
        Number of the column's kind among `TdiDetector.kinds`; None where all are alike.
    """

    column: Array
    velocity: Array
    slip: Array
    static_mtf: Array
    covariance: Array | None = None
    kind: Index | None = None

    def __len__(self) -> int:
        """Number of columns."""
        return len(self.column)

    def __post_init__(self) -> None:
        count = len(self.column)
        for name, shape in (("velocity", (count,)), ("slip", (count,)), ("static_mtf", (count, 2))):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(
                    f"columns: `{name}` has shape {value.shape} for {count} columns; finite values of shape "
                    f"{shape} are needed"
                )
            object.__setattr__(self, name, value)
        if self.covariance is not None and np.shape(self.covariance) != (count, 2, 2):
            raise InputError(
                f"columns: `covariance` has shape {np.shape(self.covariance)}; ({count}, 2, 2) is needed"
            )
        if self.kind is not None and np.shape(self.kind) != (count,):
            raise InputError(f"columns: `kind` has shape {np.shape(self.kind)}; ({count},) is needed")

    def part(self, which: slice | Index) -> ScanColumns:
        """Some of the columns."""
        covariance = None if self.covariance is None else self.covariance[which]
        kind = None if self.kind is None else self.kind[which]
        return ScanColumns(
            self.column[which],
            self.velocity[which],
            self.slip[which],
            self.static_mtf[which],
            covariance,
            kind,
        )


@dataclass(frozen=True)
class ChoiceRules:
    """What is best, and what is allowed.

    Attributes
    ----------
    model : str
        ``"exact"``, or ``"patent"``: the form of EP2733929, for comparison.
    merit : str
        ``"product"``: MTF across times MTF along times SNR; ``"geomean"``, ``"mean"`` or ``"min"`` of the two
        MTFs times SNR; ``"x"`` or ``"y"``: one of them times SNR.
    frequencies : (float, float)
        Cycles per pixel across and along at which the MTFs are judged, each on its own axis.
    main_lobe_only : bool
        No setting whose stages slip by a whole cycle or more against one another: beyond it contrast returns
        reversed and weak, and some merits would choose it.
    snr_min : float
    mtf_min, mtf_max : float
        Of each of the two MTFs.
    slip_limit : float
        rad; columns that slip more are refused.
    quantile : float or None
        Where velocity, slip or signal are uncertain: None judges a setting by its mean merit, 0 to 1 by that
        quantile of its merit. Where both motion and signal are uncertain, it is the product of the quantiles
        of their two factors: for low ones, below the quantile of the product.
    signal_sigma : float
        Relative 1-sigma of the signals.
    """

    model: str = "exact"
    merit: str = "product"
    frequencies: tuple[float, float] = (0.5, 0.5)
    main_lobe_only: bool = True
    snr_min: float = 0.0
    mtf_min: float = 0.0
    mtf_max: float = 1.0
    slip_limit: float = SLIP_LIMIT
    quantile: float | None = None
    signal_sigma: float = 0.0

    def __post_init__(self) -> None:
        for name, value, allowed in (("model", self.model, MODELS), ("merit", self.merit, MERITS)):
            if value not in allowed:
                raise InputError(f"`{name}` is {value!r}; allowed are {', '.join(allowed)}")
        if not 0.0 <= self.mtf_min <= self.mtf_max:
            raise InputError(
                f"`mtf_min` is {self.mtf_min:g} and `mtf_max` {self.mtf_max:g}; 0 <= mtf_min <= mtf_max is "
                "allowed"
            )
        if self.quantile is not None and not 0.0 < self.quantile < 1.0:
            raise InputError(f"`quantile` is {self.quantile:g}; it lies between 0 and 1")
        if not 0.0 <= self.signal_sigma < 1.0:
            raise InputError(f"`signal_sigma` is {self.signal_sigma:g}; a relative sigma from 0 up to 1")
