"""Lines of a moving scene, each set from its own head lines, in the order in which things become known.

Scene line l passes stage k in line period l + k. Its first stages are read for its signal; the setting found
from them acts `latency` line periods later. Stages that pass meanwhile integrate like the head, so that
`Exposure.head_stages` counts those that are read and those that wait.

Not here: the choice (``tdi/choose.py``), settings held from line to line (``tdi/hysteresis.py``), the image
(``simulate/tdi_strip.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.tdi.choose import choose_settings
from sightline.tdi.merit import ColumnMtf, SomeColumns, column_factors, signal_factors
from sightline.tdi.setting import Array, ChoiceRules, Index, TdiDetector, TdiGrid

#: Settings (G,) of the next line from its measured signals (G,); may remember the lines before.
Decide = Callable[[Array], Index]
#: Lines whose settings are judged at once.
_LINES = 256


@dataclass(frozen=True, eq=False)
class CausalLines:
    """What was known and set, line by line.

    Attributes
    ----------
    measured : (L, G)
        Electrons of one line at the signal's integration ratio, as its head lines say.
    setting : (L, G) int
    known_in : (L,) int
        Line period at whose end the signal of the line is known.
    acts_from : (L,) int
        First line period in which the setting acts on the line.
    """

    measured: Array
    setting: Index
    known_in: Index
    acts_from: Index


def head_readings(scene: Array, detector: TdiDetector, latency: int, rng: np.random.Generator) -> Array:
    """Electrons (L, K, G) that the head lines read: [l, k] is line l at stage k, in line period l + k.

    Parameters
    ----------
    scene : (L, G)
        Electrons of one line at the signal's integration ratio.
    detector : TdiDetector
        Its head has K + `latency` stages.
    latency : int
        Line periods from the last reading to the setting.
    rng : numpy.random.Generator

    Notes
    -----
    Shot noise of signal and dark current, gain noise and read noise; a full line reads as full.
    """
    law, ratio = detector.noise, detector.exposure.head_ratio
    read = _read_stages(detector, latency)
    shape = (len(scene), read, scene.shape[1])
    mean = np.broadcast_to((scene * (ratio / detector.signal_ratio))[:, None, :], shape)
    electrons = law.shot * rng.poisson(mean / law.shot) if law.shot > 0.0 else mean.copy()
    electrons = electrons + mean * np.sqrt(law.gain) * rng.standard_normal(shape)
    electrons += rng.poisson(law.dark * ratio, shape)
    electrons = np.minimum(electrons, detector.full_well_line)
    electrons += law.read * rng.standard_normal(shape)
    return np.asarray(electrons - law.dark * ratio)


def _read_stages(detector: TdiDetector, latency: int) -> int:
    """Head stages that are read in time."""
    head = detector.exposure.head_stages
    if latency < 0:
        raise InputError(f"`latency` is {latency} line periods; 0 or more are allowed")
    if head <= latency:
        raise InputError(
            f"a head of {head} stages and a latency of {latency} line periods leave no stage to measure the "
            "signal in; `head_stages` counts the stages that are read and those that wait"
        )
    return head - latency


def set_lines(
    readings: Array, decide: Decide, detector: TdiDetector, grid: TdiGrid, *, latency: int = 0
) -> CausalLines:
    """Settings of every line from what its head lines read, in the order of time.

    Parameters
    ----------
    readings : (L, K, G)
        Electrons of head line k of scene line l, read in line period l + k (`head_readings`).
    decide : callable
        Called once per line, in order, with the signals (G,) of that line.
    detector : TdiDetector
        Its head has K + `latency` stages.
    grid : TdiGrid
    latency : int
        Line periods from the last reading to the setting.

    Returns
    -------
    CausalLines

    Raises
    ------
    InputError
        A setting of fewer stages than have passed when it acts.
    """
    lines, read, groups = readings.shape
    if read != _read_stages(detector, latency):
        raise InputError(
            f"{read} readings per line and a latency of {latency} do not make the head of "
            f"{detector.exposure.head_stages} stages"
        )
    if grid.stages[0] < read + latency:
        raise InputError(
            f"grid `stages` begins at {grid.stages[0]}, but {read + latency} stages have passed when a "
            "setting acts; begin the grid there, or shorten the latency"
        )
    to_signal = detector.signal_ratio / detector.exposure.head_ratio
    measured, setting = np.empty((lines, groups)), np.empty((lines, groups), dtype=np.intp)
    sums = np.zeros((read, groups))  # of the lines now in the head
    for period in range(lines + read - 1):
        for line in range(max(period - read + 1, 0), min(period, lines - 1) + 1):
            stage = period - line
            slot = line % read
            sums[slot] = readings[line, stage] + (sums[slot] if stage else 0.0)
        done = period - read + 1
        if done >= 0:
            measured[done] = sums[done % read] * (to_signal / read)
            setting[done] = decide(measured[done])
    known_in = np.arange(lines) + read - 1
    return CausalLines(measured, setting, known_in, known_in + 1 + latency)


def clairvoyant_loss(
    model: ColumnMtf, scene: Array, setting: Index, grid: TdiGrid, detector: TdiDetector, rules: ChoiceRules
) -> tuple[Array, NDArray[np.bool_]]:
    """What settings lose against those that the true signals would have asked for.

    Parameters
    ----------
    model : ColumnMtf
        Of the G column groups.
    scene : (L, G)
        Electrons of one line at the signal's integration ratio: the truth.
    setting : (L, G) int
    grid : TdiGrid
    detector : TdiDetector
    rules : ChoiceRules
        The signal counts as known.

    Returns
    -------
    loss : (L, G)
        Share of merit; below 0 where a setting breaks a limit that the best keeps.
    overflows : (L, G) bool
        Where a well overflows though a setting exists that keeps it.
    """
    known = replace(rules, signal_sigma=0.0)
    loss, overflows = np.empty(scene.shape), np.empty(scene.shape, dtype=bool)
    for group in range(scene.shape[1]):
        one = SomeColumns(model, np.array([group]))
        by_column = column_factors(one, slice(0, 1), grid, known).merit[0]
        for begin in range(0, len(scene), _LINES):
            part = slice(begin, begin + _LINES)
            signals, taken = scene[part, group], setting[part, group]
            at = np.arange(len(signals))
            best = choose_settings(one, signals, grid, detector, known).setting[0]
            of_signals = signal_factors(signals, grid, detector, known)
            merit = by_column * of_signals.merit
            loss[part, group] = 1.0 - merit[at, taken] / merit[at, best]
            kept = of_signals.unsaturated
            overflows[part, group] = ~kept[at, taken] & kept[at, best]
    return loss, overflows
