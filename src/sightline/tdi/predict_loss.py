"""What a choice is expected to lose because velocity, slip and motion are not known exactly.

Not here: making the choice (``choose.py``), what may be (``merit.py``, ``motion_mtf.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.tdi.choose import TdiChoice
from sightline.tdi.merit import ColumnMtf, column_factors, drawn_merit, signal_factors

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PredictedLoss:
    """Share of the merit that a choice gives away against one made knowing everything.

    Attributes
    ----------
    column : (C,)
        Number in the detector line.
    signals : (S,)
        Electrons of a head line.
    draws : (E, C, S)
        Loss if each draw were true.
    """

    column: Array
    signals: Array
    draws: Array

    @property
    def mean(self) -> Array:
        """(C, S) expected loss."""
        return np.asarray(self.draws.mean(axis=0))

    def upper(self, probability: float = 0.95) -> Array:
        """(C, S) loss that is not exceeded with this probability."""
        return np.asarray(np.quantile(self.draws, probability, axis=0))


def predict_loss(
    choice: TdiChoice,
    model: ColumnMtf,
    places: Sequence[int] | None = None,
    signals: Sequence[int] | None = None,
) -> PredictedLoss:
    """Loss of a choice at every draw of what may be.

    Parameters
    ----------
    choice : TdiChoice
    model : ColumnMtf
        Of the same columns, grid and rules.
    places : sequence of int, optional
        Places of columns in `choice.columns`; first, middle and last by default.
    signals : sequence of int, optional
        Places of signals; first, middle and last by default.

    Notes
    -----
    At each draw the merit of a setting is its mean over the draw's lines; the best setting is sought among
    those that main lobe, MTF and signal allow. Without draws nothing is uncertain and nothing is lost.
    """
    if len(model.columns) != len(choice.columns):
        raise InputError(
            f"columns mismatch: the choice has {len(choice.columns)} columns, the model {len(model.columns)}"
        )
    at = _spread(len(choice.columns)) if places is None else np.asarray(places, dtype=np.intp)
    bright = _spread(len(choice.signals)) if signals is None else np.asarray(signals, dtype=np.intp)
    losses = []
    for place in at:
        which = slice(int(place), int(place) + 1)
        each = drawn_merit(model, which, choice.rules)
        if each is None:
            losses.append(np.zeros((1, len(bright))))
            continue
        detector = choice.detector.of_column(choice.columns, int(place))
        by_signal = signal_factors(choice.signals[bright], choice.grid, detector, choice.rules)
        factors = column_factors(model, which, choice.grid, choice.rules)
        allowed = (factors.in_lobe & factors.in_bounds)[0]
        losses.append(_losses(each[:, 0], allowed, by_signal.allowed, choice.setting[place, bright]))
    return PredictedLoss(choice.columns.column[at], choice.signals[bright], np.stack(losses, axis=1))


def _spread(count: int) -> NDArray[np.intp]:
    """First, middle and last of so many."""
    return np.unique(np.array([0, count // 2, count - 1]))


def _losses(by_draw: Array, allowed: NDArray[np.bool_], by_signal: Array, chosen: NDArray[np.intp]) -> Array:
    """(E, S) losses of the settings chosen at one column."""
    out = np.zeros((len(by_draw), len(chosen)))
    for s, setting in enumerate(chosen):
        merit = by_draw * by_signal[s]
        best = np.where(allowed, merit, 0.0).max(axis=1)
        # a cell in which no setting is allowed has nothing to lose; nor has a stand-in that beats what is
        with np.errstate(invalid="ignore", divide="ignore"):
            loss = np.where(best > 0.0, 1.0 - merit[:, setting] / best, 0.0)
        out[:, s] = np.maximum(loss, 0.0)
    return out
