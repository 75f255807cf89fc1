"""What was set for each line and column group, and the image in one unit again.

Tags keep for every line and group the setting, what it was chosen from and what was expected of it. A sample
over its integration time is the signal, whatever the setting: seams between groups vanish.

Not here: the file of tags (``io/results/tdi_tags.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import FormatError, InputError
from sightline.imaging.tdi_noise import snr
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import CHUNK
from sightline.tdi.merit import ColumnMtf, filled
from sightline.tdi.setting import Array, Index, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.tag_kernels import decode_runs, encode_runs

#: Every field of a tag with the form in which it is kept, little-endian.
FIELDS: dict[str, str] = {
    "stages": "<u2", "ratio_index": "<u1", "saturated": "<u1", "table": "<u4",
    "velocity": "<f4", "slip": "<f4", "signal": "<f4",
    "mtf_across": "<f4", "mtf_along": "<f4", "snr": "<f4",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class TdiTags:
    """One record per line and column group; fields are kept in the forms of `FIELDS`.

    Attributes
    ----------
    first_column : (G,) int
        First column of each group, rising from 0; a group ends where the next begins.
    columns : int
        Of the detector line.
    ratios : (k,)
        Integration ratios that `ratio_index` counts.
    exposure : Exposure
        Of the head.
    signal_ratio : float
        Integration ratio that signals are given for.
    stages, ratio_index : (L, G)
        The setting.
    saturated : (L, G)
        1 where a line or the sum fills its well.
    table : (L, G)
        Number of the table that the setting was looked up in.
    velocity, slip : (L, G)
        Pixels per line period; rad.
    signal : (L, G)
        Electrons of one line at `signal_ratio`, as measured or looked up.
    mtf_across, mtf_along, snr : (L, G)
        Expected, of the whole system.

    Raises
    ------
    InputError
        Shapes or values that do not go together.
    """

    first_column: Index
    columns: int
    ratios: Array
    exposure: Exposure
    signal_ratio: float
    stages: NDArray[Any]
    ratio_index: NDArray[Any]
    saturated: NDArray[Any]
    table: NDArray[Any]
    velocity: NDArray[Any]
    slip: NDArray[Any]
    signal: NDArray[Any]
    mtf_across: NDArray[Any]
    mtf_along: NDArray[Any]
    snr: NDArray[Any]

    def __post_init__(self) -> None:
        first = np.asarray(self.first_column, dtype=np.intp)
        if not (len(first) and first[0] == 0 and (np.diff(first) > 0).all() and first[-1] < self.columns):
            raise InputError(
                f"tags: `first_column` is {first.tolist()} for {self.columns} columns; it rises from 0 and "
                "stays below their number"
            )
        object.__setattr__(self, "first_column", first)
        object.__setattr__(self, "ratios", np.asarray(self.ratios, dtype=np.float64))
        if not 0.0 < self.signal_ratio <= 1.0:
            raise InputError(f"tags: `signal_ratio` is {self.signal_ratio:g}; it is above 0, up to 1")
        for name, form in FIELDS.items():
            value = np.asarray(getattr(self, name))
            if value.ndim != 2 or value.shape != (len(self.stages), len(first)):
                raise InputError(
                    f"tags: `{name}` has shape {value.shape}; lines x {len(first)} groups are expected"
                )
            kept = np.ascontiguousarray(value.astype(form))
            if form[1] == "u" and not np.array_equal(kept, value):
                raise InputError(f"tags: `{name}` holds values that {8 * kept.itemsize} bits do not")
            object.__setattr__(self, name, kept)
        if self.stages.size and (self.stages.min() < 1 or self.ratio_index.max() >= len(self.ratios)):
            raise InputError("tags: a setting has no stage, or a ratio that is not in the list")

    def __len__(self) -> int:
        """Number of lines."""
        return len(self.stages)

    @property
    def integration_time(self) -> Array:
        """(L, G) line periods that all stages integrate together: N0 Kt0 + (N - N0) Kt."""
        return self.exposure.total(self.stages, self.ratios[self.ratio_index])

    def group_of_columns(self) -> Index:
        """(columns,) number of the group of each column."""
        return np.repeat(np.arange(len(self.first_column)), np.diff([*self.first_column, self.columns]))


class SystemMtf:
    """MTF of the whole system by column and setting; those of some settings are found once and kept.

    Parameters
    ----------
    model : ColumnMtf
        Of the G columns.
    settings : (U,) int
        Settings that are kept, as the grid counts them; others are found each time.
    """

    def __init__(self, model: ColumnMtf, settings: Index) -> None:
        self.model = model
        count = len(model.columns)
        self._kept = np.empty((count, len(settings), 2))
        self._place: Index | None = None
        for first in range(0, count, CHUNK):
            part = slice(first, min(first + CHUNK, count))
            found = self._system(np.arange(part.start, part.stop))
            self._kept[part] = found[:, settings]
            if self._place is None:
                self._place = np.full(found.shape[1], -1, dtype=np.intp)
                self._place[settings] = np.arange(len(settings))

    def _system(self, columns: Index) -> Array:
        """(c, P, 2) of some columns and all settings."""
        static = self.model.columns.static_mtf[columns]
        return self.model.central(columns) * static[:, None, :]

    def __call__(self, setting: Index) -> Array:
        """(L, G, 2) across and along, of settings (L, G)."""
        assert self._place is not None  # there is a column
        place = self._place[setting]
        out = self._kept[np.arange(setting.shape[1]), place]
        for group in np.flatnonzero((place < 0).any(axis=0)):
            other = place[:, group] < 0
            out[other, group] = self._system(np.array([group]))[0, setting[other, group]]
        return out


def tag_lines(
    model: ColumnMtf,
    setting: Index,
    signals: ArrayLike,
    grid: TdiGrid,
    detector: TdiDetector,
    *,
    first_column: ArrayLike,
    columns: int,
    table: int = 0,
    system: SystemMtf | None = None,
    step: float = 0.0,
) -> TdiTags:
    """The tags of lines from their settings and signals.

    Parameters
    ----------
    model : ColumnMtf
        Of the G column groups.
    setting : (L, G) int
        As the grid counts.
    signals : (L, G)
        Electrons of one line at the integration ratio of `detector.signal_ratio`.
    grid : TdiGrid
    detector : TdiDetector
    first_column : (G,) int
        First column of each group, rising from 0.
    columns : int
        Of the detector line.
    table : int
        Number of the table in use.
    system : SystemMtf, optional
        Of `model`, where more lines are tagged with it.
    step : float
        Above 0: signals are kept rounded (`rounded_signal`), and the SNR is that of the rounded ones.
    """
    signal = np.asarray(np.broadcast_to(signals, setting.shape), dtype=np.float64)
    stages, ratio = grid.stages_of(setting), grid.ratio_of(setting)
    if system is None:
        system = SystemMtf(model, np.unique(setting))
    mtf = system(setting)
    saturated = overflows(signal, stages, ratio, model.columns, detector)
    if step > 0.0:
        signal = rounded_signal(signal, step)
    ones, of_noise = np.ones_like(signal), np.empty_like(signal)
    for of_kind, at in detector.by_kind(model.columns):
        of_noise[:, at] = snr(
            signal[:, at], stages[:, at], ratio[:, at], of_kind.noise, of_kind.exposure, of_kind.reference
        )
    return TdiTags(
        first_column=np.asarray(first_column),
        columns=columns,
        ratios=grid.ratios,
        exposure=detector.exposure,
        signal_ratio=detector.signal_ratio,
        stages=stages,
        ratio_index=setting % len(grid.ratios),
        saturated=saturated,
        table=np.full(setting.shape, table),
        velocity=model.columns.velocity * ones,
        slip=model.columns.slip * ones,
        signal=signal,
        mtf_across=mtf[..., 0],
        mtf_along=mtf[..., 1],
        snr=of_noise,
    )


def overflows(
    signals: Array, stages: Index, ratio: Array, columns: ScanColumns, detector: TdiDetector
) -> NDArray[np.bool_]:
    """Where a line, or the sum, of columns fills its well: all of shape (L, C)."""
    full = np.empty(signals.shape, dtype=bool)
    for of_kind, at in detector.by_kind(columns):
        line, total = filled(signals[:, at], stages[:, at], ratio[:, at], of_kind)
        full[:, at] = (line > of_kind.full_well_line) | (total > of_kind.full_well_sum)
    return full


def rounded_signal(signals: ArrayLike, step: float = 0.05) -> Array:
    """Signals rounded to powers of 1 + `step`, 0 and less to 0: tags of an even scene then run on."""
    if not step > 0.0:
        raise InputError(f"`step` is {step:g}; a relative step above 0 is allowed")
    s = np.asarray(signals, dtype=np.float64)
    size = np.log1p(step)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(s > 0.0, np.exp(size * np.round(np.log(s) / size)), 0.0))


def encode_field(values: NDArray[Any], before: NDArray[Any] | None = None) -> bytes:
    """Run-length code of a field (L, G): runs of one value, and of values that stay from line to line.

    Parameters
    ----------
    values : (L, G)
    before : (G,), optional
        The line before, where these lines go on a field that is coded part by part.
    """
    size, width = values.dtype.itemsize, values.shape[1]
    whole = values if before is None else np.concatenate([before[None], values])
    patterns = np.ascontiguousarray(whole).view(f"<u{size}").ravel().astype(np.uint64)
    out = np.empty(values.size * (10 + size), dtype=np.uint8)
    length = encode_runs(patterns, 0 if before is None else width, width, size, out)
    return out[:length].tobytes()


def decode_field(code: bytes, shape: tuple[int, int], form: str) -> NDArray[Any]:
    """The field (L, G) of a code, in the form it had.

    Raises
    ------
    FormatError
        A code that does not make up such a field.
    """
    kind = np.dtype(form)
    patterns = np.zeros(shape[0] * shape[1], dtype=np.uint64)
    if not decode_runs(np.frombuffer(code, dtype=np.uint8), shape[1], kind.itemsize, patterns):
        raise FormatError(
            f"{len(code)} bytes of run-length code do not make up {shape[0]} x {shape[1]} values"
        )
    return patterns.astype(f"<u{kind.itemsize}").view(kind).reshape(shape)


@dataclass(frozen=True, eq=False)
class Recalibrated:
    """An image in electrons of one line at the integration ratio of the signal.

    Attributes
    ----------
    signal : (L, C)
    sigma : (L, C)
        1-sigma of what is systematic: integration times, column gains, dark current. Noise of the samples is
        not in it.
    """

    signal: Array
    sigma: Array


def recalibrate(
    samples: ArrayLike,
    tags: TdiTags,
    *,
    dark: ArrayLike = 0.0,
    dark_sigma: ArrayLike = 0.0,
    column_gain: ArrayLike = 1.0,
    column_gain_sigma: ArrayLike = 0.0,
    ratio_sigma: ArrayLike = 0.0,
    head_sigma: float = 0.0,
) -> Recalibrated:
    """Samples of any settings in one unit: each over its integration time.

    Parameters
    ----------
    samples : (L, C)
        Electrons of the sum.
    tags : TdiTags
        Of the same lines and columns.
    dark, dark_sigma : float or (C,)
        Electrons per line period at an integration ratio of 1, which are taken off; their 1-sigma.
    column_gain : float or (C,)
        Response of each column over the nominal, which samples less dark current are divided by.
    column_gain_sigma : float or (C,)
        Its relative 1-sigma.
    ratio_sigma : float or (k,)
        1-sigma of each integration ratio, line periods; independent of one another.
    head_sigma : float
        1-sigma of the head's integration ratio, line periods.

    Notes
    -----
    An integration time that is wrong scales what was collected, dark current included.
    """
    values = np.asarray(samples, dtype=np.float64)
    if values.shape != (len(tags), tags.columns):
        raise InputError(
            f"samples have shape {values.shape}, the tags are of {len(tags)} lines x {tags.columns} columns"
        )
    current, current_sigma, gain, gain_sigma = (
        np.broadcast_to(np.asarray(v, dtype=np.float64), (tags.columns,))
        for v in (dark, dark_sigma, column_gain, column_gain_sigma)
    )
    if not (gain > 0.0).all():
        raise InputError("`column_gain` holds values that are not above 0")
    group = tags.group_of_columns()
    time = tags.integration_time
    of_time = np.sqrt(_time_variance(tags, ratio_sigma, head_sigma)) / time
    collected = values / time[:, group]
    signal = (collected - current) / gain * tags.signal_ratio
    variance = ((of_time[:, group] * collected) ** 2 + current_sigma**2) * (tags.signal_ratio / gain) ** 2
    return Recalibrated(signal, np.sqrt(variance + (gain_sigma * signal) ** 2))


def _sigmas(tags: TdiTags, ratio_sigma: ArrayLike, head_sigma: float) -> Array:
    """(k,) 1-sigma of the integration ratios, checked."""
    of_ratio = np.broadcast_to(np.asarray(ratio_sigma, dtype=np.float64), tags.ratios.shape)
    for name, sigma in (("ratio_sigma", of_ratio), ("head_sigma", np.asarray(head_sigma))):
        if not (np.isfinite(sigma) & (sigma >= 0.0)).all():
            raise InputError(f"`{name}` is {np.asarray(sigma).tolist()}; sigmas are 0 or more")
    return of_ratio


def _time_variance(tags: TdiTags, ratio_sigma: ArrayLike, head_sigma: float) -> Array:
    """(L, G) variance of the integration time of all stages, line periods^2."""
    of_ratio = _sigmas(tags, ratio_sigma, head_sigma)
    head = np.minimum(tags.stages, tags.exposure.head_stages).astype(np.float64)
    body = tags.stages - head
    return np.asarray((head * head_sigma) ** 2 + (body * of_ratio[tags.ratio_index]) ** 2)


def seam_sigma(
    tags: TdiTags, *, dark: float = 0.0, ratio_sigma: ArrayLike = 0.0, head_sigma: float = 0.0
) -> Array:
    """Relative 1-sigma (L, G - 1) of the step that errors of integration times leave between groups.

    Neighbours share the error of the head, and that of their ratio where it is the same: groups of equal
    settings and signals have no seam. Parameters as of :func:`recalibrate`.
    """
    of_ratio = _sigmas(tags, ratio_sigma, head_sigma)
    head = np.minimum(tags.stages, tags.exposure.head_stages).astype(np.float64)
    with np.errstate(divide="ignore"):
        collected = (1.0 + dark * tags.signal_ratio / tags.signal) / tags.integration_time
    of_head, of_body = head * collected, (tags.stages - head) * collected
    left, right = tags.ratio_index[:, :-1], tags.ratio_index[:, 1:]
    apart = (of_body[:, :-1] * of_ratio[left]) ** 2 + (of_body[:, 1:] * of_ratio[right]) ** 2
    shared = ((of_body[:, :-1] - of_body[:, 1:]) * of_ratio[left]) ** 2
    body = np.where(left == right, shared, apart)
    return np.asarray(np.sqrt(body + ((of_head[:, :-1] - of_head[:, 1:]) * head_sigma) ** 2))
