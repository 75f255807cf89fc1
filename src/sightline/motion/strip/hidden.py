"""What stages of TDI average away, where, as large and as narrow as what their blur shows of it.

Rows whose stages count unevenly (`Star.uneven`) show a little of such motion, which is estimated with the
rest: under wide tones where rows show none, under narrow ones where they show a mode. Both are learned from
the estimate, as expectation maximisation does: a tone's power is that of the estimate and of its error.

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
from sightline.estimation.search import HIDDEN_TO, HIGHEST, LEFT_BY_TDI, SAME_TONE, left_by_tdi
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
#: Sizes of a mode that are tried, in broadband sigmas, and at how many places it is found more closely.
SIZES, CLOSELY = np.geomspace(0.05, 20.0, 13), 11
#: Probability that chance shows one anywhere, and its width at first, in units of one over the length.
CHANCE, BEGUN = 0.01, 0.3
#: Frequencies that are looked at together: the waves of each are six motions.
AT_ONCE = 16


def with_shown_mode(
    model: PriorModel, estimate: JointEstimate, seen: tuple[float, float], tdi: Sequence[float]
) -> PriorModel:
    """The model with the mode that rows show most plainly beside it where stages hide modes, if they do.

    All axes have it, in the place of wide tones about there.

    Parameters
    ----------
    model, estimate, seen
        As for `learned`.
    tdi : sequence of float
        s; over which the stages average.
    """
    nodes = estimate.grid.nodes
    pieces = _pieces(nodes, seen)
    if not pieces or not model.blur_shows or not tdi:
        return model
    length = float(nodes[pieces[0]][-1] - nodes[pieces[0]][0])
    f = np.arange(1.0 / length, min(HIDDEN_TO / min(tdi), HIGHEST / estimate.grid.step), 0.5 / length)
    f = f[left_by_tdi(f, tdi) < LEFT_BY_TDI]
    if not len(f):
        return model
    evidence = _evidence(f, pieces, model, estimate)
    kind, size, place = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
    if evidence[kind, size, place] < math.log(len(f) / CHANCE):
        return model
    near = f[place] + np.linspace(-0.5, 0.5, CLOSELY) / length
    evidence = _evidence(near, pieces, model, estimate)[kind]
    size, place = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
    frequency, apart = float(near[place]), SAME_TONE / length
    unseen = []
    for loud, tones in zip(_loud(model), model.unseen, strict=True):
        off = [(abs(tone.frequency - frequency), tone) for tone in tones]
        if not any(distance < apart and tone.bandwidth < apart for distance, tone in off):
            others = [tone for distance, tone in off if distance > max(apart, WIDTHS * tone.bandwidth)]
            tones = (*others, Tone(float(SIZES[size] * loud), frequency, BEGUN / length))
        unseen.append(tones)
    return model if unseen == list(model.unseen) else replace(model, unseen=tuple(unseen))


def _loud(model: PriorModel) -> Array:
    """(3,) rad; sigmas of the broadband jitter."""
    return np.array([spectrum.components[1].sigma for spectrum in model.spectra])


def _evidence(f: Array, pieces: Sequence[slice], model: PriorModel, estimate: JointEstimate) -> Array:
    """Log of how much likelier a mode at `f` (Hz) makes the rows, (4, sizes, frequencies).

    A mode of all axes, or of roll, pitch or yaw alone.

    Notes
    -----
    Sinusoids of Gaussian amplitudes of variance v, in units of the broadband jitter of each axis, make rows
    ``exp(s' (1 / v + J)^-1 s / 2) / det(1 + v J)^(1/2)`` times as likely, with their score s and information
    J; phases of pieces of a strip tell nothing of each other. Beforehand v is exponential, of the mean of the
    modes that are seen, which falls as f^-3 (`Search.hidden_tones`).
    """
    nodes, loud = estimate.grid.nodes, _loud(model)
    modes = [
        (tone.sigma / size) ** 2 * tone.frequency**3
        for spectrum, size in zip(model.spectra, loud, strict=True)
        for tone in spectrum.tones
    ]
    strength = float(np.square(modes).sum() / np.sum(modes)) if modes else math.inf
    out = np.tile(-np.outer(SIZES**2, f**3 / strength), (4, 1, 1))
    parts = np.array_split(np.arange(len(f)), -(-len(f) // AT_ONCE))
    for piece, part in ((piece, part) for piece in pieces for part in parts):
        phase = 2.0 * math.pi * np.outer(nodes[piece] - nodes[piece][0], f[part])
        waves = np.zeros((len(nodes), 3, len(part), 3, 2))
        for axis in range(3):
            waves[piece, axis, :, axis] = loud[axis] * np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        score, information = estimate.shown_of(waves.reshape(len(nodes), 3, -1))
        for k, place in enumerate(part):
            own = slice(6 * k, 6 * k + 6)
            for kind, axes in enumerate((slice(0, 6), slice(0, 2), slice(2, 4), slice(4, 6))):
                j, vectors = np.linalg.eigh(information[own, own][axes, axes])
                seen = 1.0 + np.outer(SIZES**2, np.maximum(j, 0.0))
                gain = SIZES[:, None] ** 2 * (vectors.T @ score[own][axes]) ** 2 / seen
                out[kind, :, place] += 0.5 * (gain - np.log(seen)).sum(axis=1)
    return out


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
    size = tone.sigma * math.sqrt(found.sum() / expected.sum())
    # rows that show no mode do not tell where it is: a wide tone would shrink about what is none
    if tone.bandwidth > SAME_TONE / length:
        return replace(tone, sigma=size)
    middle, spread = _moments(f, found)
    _, usual = _moments(f, expected)
    width = tone.bandwidth * spread / usual
    return Tone(size, middle, min(max(width, NARROWEST / length), WIDEST * middle))


def _moments(f: Array, power: Array) -> tuple[float, float]:
    """Mean and standard deviation of frequencies by their power."""
    middle = float(f @ power / power.sum())
    return middle, math.sqrt(float((f - middle) ** 2 @ power / power.sum()))
