"""What stages of TDI average away, as large and as narrow as what their blur shows of it.

Rows whose stages count unevenly (`Star.uneven`) show a little of such motion, which is estimated with the
rest under wide tones. These are learned from the estimate, as expectation maximisation does: a tone's power
is that of the estimate and of its error.

Not here: the first guess of these tones (``estimation/search.py``), the weights of stages
(``motion/measure/uneven_blur.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matmul_toeplitz

from sightline.estimation.prior import Spectrum, Tone
from sightline.motion.strip.hyper import PriorModel
from sightline.motion.strip.joint import JointEstimate

Array = NDArray[np.float64]

#: A tone is looked at so many of its widths to either side, so many times the resolution at least.
WIDTHS, RESOLUTIONS = 2.0, 4.0
#: s; longest piece of a strip that is looked at as a whole, and so many pieces at most.
PIECE, MOST_PIECES = 1.0, 3
#: Least width of a tone, in units of one over the length of a piece.
NARROWEST = 0.1
#: A tone is at most as wide as this share of its frequency.
WIDEST = 0.1
#: An axis shows a mode of its own where it is this share of the loudest axis', each in its broadband sigmas.
SHOWS = 0.5


def learned(model: PriorModel, estimate: JointEstimate, seen: tuple[float, float]) -> PriorModel:
    """The model with hidden tones as an estimate under it shows them.

    Parameters
    ----------
    model : PriorModel
        Whose hidden tones are estimated with the rest (`blur_shows`); another comes back as it is.
    estimate : JointEstimate
    seen : (float, float)
        s; first and last instant of its measurements.
    """
    pieces = _pieces(estimate.grid.nodes, seen)
    if not pieces or not model.blur_shows:
        return model
    roll, pitch, yaw = (
        tuple(_learned(tone, axis, whole, estimate, pieces) for tone in model.unseen[axis])
        for axis, whole in enumerate(model.whole())
    )
    return of_one_body(replace(model, unseen=(roll, pitch, yaw)))


def of_one_body(model: PriorModel) -> PriorModel:
    """The model with hidden tones of axes that hardly show them where the axis that shows most has them.

    Modes of a body turn it about all of its axes. Across a narrow field blur tells a turn about the track
    from one about the line of sight no better than they are believed: an axis without a tone there would
    leave all of it to the other.
    """
    count = {len(tones) for tones in model.unseen}
    if len(count) > 1 or count == {0}:
        return model
    loud = [spectrum.components[1].sigma for spectrum in model.spectra]
    unseen = [list(tones) for tones in model.unseen]
    for k in range(count.pop()):
        shown = [unseen[axis][k].sigma / max(loud[axis], 1e-300) for axis in range(3)]
        first = max(range(3), key=shown.__getitem__)
        for axis in range(3):
            if shown[axis] < SHOWS * shown[first]:
                one = unseen[first][k]
                unseen[axis][k] = replace(one, sigma=unseen[axis][k].sigma)
    roll, pitch, yaw = (tuple(tones) for tones in unseen)
    return replace(model, unseen=(roll, pitch, yaw))


def _pieces(nodes: Array, seen: tuple[float, float]) -> list[slice]:
    """Nodes of the pieces that stand for a strip."""
    inside = np.flatnonzero((nodes >= seen[0]) & (nodes <= seen[1]))
    if len(inside) < 2:
        return []
    step = float(nodes[1] - nodes[0])
    size = min(len(inside), max(2, int(PIECE / step)))
    count = min(len(inside) // size, MOST_PIECES)
    begins = inside[0] + np.linspace(0, len(inside) - size, count).astype(int)
    return [slice(int(begin), int(begin) + size) for begin in begins]


def _learned(
    tone: Tone, axis: int, whole: Spectrum, estimate: JointEstimate, pieces: Sequence[slice]
) -> Tone:
    """A tone whose power is that of an estimate and of its error, as far as these are its own."""
    nodes = estimate.grid.nodes
    length = float(nodes[pieces[0]][-1] - nodes[pieces[0]][0])
    reach = max(WIDTHS * tone.bandwidth, RESOLUTIONS / length)
    f = np.arange(max(tone.frequency - reach, 1.0 / length), tone.frequency + reach, 1.0 / length)
    found, expected = np.zeros(len(f)), np.zeros(len(f))
    for piece in pieces:
        t = nodes[piece]
        window = np.sin(math.pi * (np.arange(len(t)) + 0.5) / len(t)) ** 2
        phase = 2.0 * math.pi * np.outer(t - t[0], f)
        waves = window[:, None] * np.concatenate([np.cos(phase), np.sin(phase)], axis=1)

        def power(of: Array) -> Array:
            return of.reshape(2, -1).sum(axis=0)

        lags = t - t[0]
        of_tone = power(np.einsum("nk,nk->k", waves, matmul_toeplitz(tone.autocovariance(lags), waves)))
        of_all = power(np.einsum("nk,nk->k", waves, matmul_toeplitz(whole.autocovariance(lags), waves)))
        weights = np.zeros((len(t), 3, waves.shape[1]))
        weights[:, axis] = waves
        error = power(np.diag(estimate.functional_covariance(t, weights)))
        angles = estimate.nodes[piece, axis]
        seen = power((waves.T @ angles) ** 2)
        share = of_tone / of_all
        found += share**2 * (seen + error) + (1.0 - share) * of_tone
        expected += of_tone
    middle, spread = _moments(f, found)
    _, usual = _moments(f, expected)
    width = tone.bandwidth * spread / usual
    return Tone(
        tone.sigma * math.sqrt(found.sum() / expected.sum()),
        middle,
        min(max(width, NARROWEST / length), WIDEST * middle),
    )


def _moments(f: Array, power: Array) -> tuple[float, float]:
    """Mean and standard deviation of frequencies by their power."""
    middle = float(f @ power / power.sum())
    return middle, math.sqrt(float((f - middle) ** 2 @ power / power.sum()))
