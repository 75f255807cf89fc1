"""What stages of TDI average away, where, as large and as narrow as what their blur shows of it.

Rows whose stages count unevenly (`Star.uneven`) show a little of such motion, which is estimated with the
rest: under wide tones where rows show none, under narrow ones where they show a mode. Both are learned from
the estimate, as expectation maximisation does: a tone's power is that of the estimate and of its error.

Not here: the first guess of these tones (``estimation/search.py``), the weights of stages
(``motion/measure/uneven_blur.py``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import matmul_toeplitz
from scipy.special import kve

from sightline.estimation.prior import Spectrum, Tone
from sightline.estimation.search import (
    HIDDEN_TO,
    HIGHEST,
    LEFT_BY_TDI,
    SAME_TONE,
    SELDOM,
    left_by_tdi,
    mode_density,
    seen_modes,
)
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
#: Sizes of a mode that are tried, in units of what is usual, and at how many places it is found more closely.
SIZES, CLOSELY = np.geomspace(0.05, 20.0, 13), 11
#: Probability that chance shows one anywhere, and its width at first, in units of one over the length.
CHANCE, BEGUN = 0.01, 0.3
#: Odds of a mode there, by rows and by modes that are seen, from which on it is taken for one all the same.
LIKELY = SELDOM / (1.0 - SELDOM)
#: So many amplitudes tell their variance by themselves.
MANY = 30.0
#: More evidence than this is beyond any doubt, and its exponential beyond numbers.
MOST_EVIDENCE = 500.0
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
    pieces, length, f = _averaged_away(estimate, seen, tdi)
    if not len(f) or not model.blur_shows:
        return model
    evidence = _evidence(f, pieces, model, estimate)
    kind, size, place = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
    odds = _odds(f, evidence, model, length).sum(axis=0)
    there = np.abs(f - f[place]) < SAME_TONE / length
    likely = odds[there].sum() >= LIKELY * (1.0 + odds[~there].sum())
    if not likely and evidence[kind, size, place] < math.log(len(f) / CHANCE):
        return model
    near = f[place] + np.linspace(-0.5, 0.5, CLOSELY) / length
    evidence = _evidence(near, pieces, model, estimate)[kind]
    size, place = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
    frequency, apart = float(near[place]), SAME_TONE / length
    unseen = []
    sizes = SIZES[size] * _usual(model, frequency)
    for sigma, tones in zip(sizes.tolist(), model.unseen, strict=True):
        off = [(abs(tone.frequency - frequency), tone) for tone in tones]
        if not any(distance < apart and tone.bandwidth < apart for distance, tone in off):
            others = [tone for distance, tone in off if distance > max(apart, WIDTHS * tone.bandwidth)]
            tones = (*others, Tone(sigma, frequency, BEGUN / length))
        unseen.append(tones)
    return model if unseen == list(model.unseen) else replace(model, unseen=tuple(unseen))


def likely_modes(
    model: PriorModel,
    estimate: JointEstimate,
    seen: tuple[float, float],
    tdi: Sequence[float],
    least: Array,
) -> tuple[Array, Array, Array]:
    """How likely modes larger than `least` are where stages hide them, by what rows show and what is seen.

    Parameters
    ----------
    model, estimate, seen, tdi
        As for `with_shown_mode`.
    least : (3,)
        rad; a mode counts that is larger about some axis.

    Returns
    -------
    f : (n,)
        Hz
    odds : (n,)
        Of a mode there against none.
    sizes : (n, 3)
        rad, rms of such modes in roll, pitch, yaw.
    """
    pieces, length, f = _averaged_away(estimate, seen, tdi)
    if not len(f):
        return f, f, np.zeros((0, 3))
    evidence = _evidence(f, pieces, model, estimate)
    usual = _usual(model, f)
    larger = np.any(SIZES[:, None, None] * usual > least, axis=2)
    odds = _odds(f, evidence, model, length) * larger
    mean = (SIZES[:, None] ** 2 * odds).sum(axis=0) / np.maximum(odds.sum(axis=0), 1e-300)
    return f, odds.sum(axis=0), np.sqrt(mean)[:, None] * usual


def _averaged_away(
    estimate: JointEstimate, seen: tuple[float, float], tdi: Sequence[float]
) -> tuple[list[slice], float, Array]:
    """Pieces of a strip, their length (s), and what stages average away (Hz), half the resolution apart."""
    pieces = _pieces(estimate.grid.nodes, seen)
    if not pieces or not tdi:
        return pieces, 0.0, np.zeros(0)
    length = _length(estimate, pieces)
    f = np.arange(1.0 / length, min(HIDDEN_TO / min(tdi), HIGHEST / estimate.grid.step), 0.5 / length)
    return pieces, length, f[left_by_tdi(f, tdi) < LEFT_BY_TDI]


def _odds(f: Array, evidence: Array, model: PriorModel, length: float) -> Array:
    """Odds (sizes, frequencies) of modes at `f` (Hz) against none, by the evidence of rows of a `length` (s).

    Modes are as dense beyond those that are seen as `Search.hidden_tones` has it, by the axis that lets most
    expect; a mode of all axes is as likely as one of any alone.
    """
    dense = [mode_density(f, count, strong) for _, count, strong in filter(None, _seen(model))]
    if not dense:
        return np.zeros(evidence.shape[1:])
    # of an exponential variance, in equal steps of its log
    share = 2.0 * math.log(SIZES[1] / SIZES[0]) * SIZES[:, None] ** 2
    likelier = np.exp(np.minimum(evidence, MOST_EVIDENCE)).mean(axis=0)
    return np.asarray(np.max(dense, axis=0) * (0.5 / length) * share * likelier)


def _length(estimate: JointEstimate, pieces: Sequence[slice]) -> float:
    """s, of a piece of a strip."""
    piece = estimate.grid.nodes[pieces[0]]
    return float(piece[-1] - piece[0])


def _evidence(f: Array, pieces: Sequence[slice], model: PriorModel, estimate: JointEstimate) -> Array:
    """Log of how much likelier a mode at `f` (Hz) makes the rows, (4, sizes, frequencies).

    A mode of all axes, or of roll, pitch or yaw alone.

    Notes
    -----
    Sinusoids of Gaussian amplitudes of variance v, in units of what is usual about each axis, make rows
    ``exp(s' (1 / v + J)^-1 s / 2) / det(1 + v J)^(1/2)`` times as likely, with their score s and information
    J; phases of pieces of a strip tell nothing of each other. Beforehand v is exponential, of mean 1.
    """
    out = np.tile(-(SIZES[:, None] ** 2) * np.ones(len(f)), (4, 1, 1))
    rows = _shown(f, pieces, _usual(model, f), estimate) if model.blur_shows else ()
    for place, score, information in rows:
        for kind, axes in enumerate((slice(0, 6), slice(0, 2), slice(2, 4), slice(4, 6))):
            j, vectors = np.linalg.eigh(information[axes, axes])
            seen = 1.0 + np.outer(SIZES**2, np.maximum(j, 0.0))
            gain = SIZES[:, None] ** 2 * (vectors.T @ score[axes]) ** 2 / seen
            out[kind, :, place] += 0.5 * (gain - np.log(seen)).sum(axis=1)
    return out


def _usual(model: PriorModel, f: ArrayLike) -> Array:
    """(..., 3) rad; sigmas of modes at `f` (Hz) in roll, pitch, yaw, by those that are seen.

    Notes
    -----
    Variances fall as f^-3 (`Search.hidden_tones`); small modes, some of them none, count for little. An axis
    without any has them as the others do, by its broadband jitter; where none is seen, modes are as large as
    that.
    """
    loud = np.array([spectrum.components[1].sigma ** 2 for spectrum in model.spectra])
    strength = np.array([math.nan if one is None else one[0] for one in _seen(model)])
    known = np.isfinite(strength)
    if not known.any():
        return np.sqrt(loud) * np.ones((*np.shape(f), 1))
    others = np.mean(strength[known] / loud[known])
    return np.sqrt(np.where(known, strength, others * loud) / np.asarray(f)[..., None] ** 3)


def _seen(model: PriorModel) -> list[tuple[float, float, Array] | None]:
    """`seen_modes` of each axis; None of one without any."""
    tones = [np.array([(tone.frequency, tone.sigma**2) for tone in one.tones]) for one in model.spectra]
    return [seen_modes(*one.T) if len(one) else None for one in tones]


def _shown(
    f: Array, pieces: Sequence[slice], sizes: Array, estimate: JointEstimate
) -> Iterator[tuple[int, Array, Array]]:
    """At each of `f` (Hz), by its place: score (6,) and information (6, 6) of its cosines and sines.

    Of roll, pitch, yaw, of `sizes` (frequencies, 3) in rad.
    """
    nodes = estimate.grid.nodes
    parts = np.array_split(np.arange(len(f)), -(-len(f) // AT_ONCE))
    for piece, part in ((piece, part) for piece in pieces for part in parts):
        phase = 2.0 * math.pi * np.outer(nodes[piece] - nodes[piece][0], f[part])
        waves = np.zeros((len(nodes), 3, len(part), 3, 2))
        for axis in range(3):
            waves[piece, axis, :, axis] = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
            waves[piece, axis, :, axis] *= sizes[part, axis, None]
        score, information = estimate.shown_of(waves.reshape(len(nodes), 3, -1))
        for k, place in enumerate(part):
            own = slice(6 * k, 6 * k + 6)
            yield int(place), score[own], information[own, own]


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
    known = any(spectrum.tones for spectrum in model.spectra)

    def usual(tone: Tone, axis: int) -> float:
        return float(_usual(model, tone.frequency)[axis]) if known else math.inf

    roll, pitch, yaw = (
        tuple(_learned(tone, axis, whole, usual(tone, axis), estimate, pieces) for tone in model.unseen[axis])
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
    tone: Tone, axis: int, whole: Spectrum, usual: float, estimate: JointEstimate, pieces: Sequence[slice]
) -> Tone:
    """A tone whose power is that of an estimate and of its error, as far as these are its own.

    Of a mode, whose few amplitudes tell its variance badly, as that of a mode as large as is `usual` (rad).
    """
    nodes, length = estimate.grid.nodes, _length(estimate, pieces)
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
    variance = tone.sigma**2 * float(found.sum() / expected.sum())
    # rows that show no mode do not tell where it is: a wide tone would shrink about what is none
    if tone.bandwidth > SAME_TONE / length:
        return replace(tone, sigma=math.sqrt(variance))
    amplitudes = 2.0 + 2.0 * math.pi * tone.bandwidth * length * len(pieces)
    middle, spread = _moments(f, found)
    _, as_wide = _moments(f, expected)
    width = tone.bandwidth * spread / as_wide
    size = math.sqrt(_mean_variance(variance, amplitudes, usual**2))
    return Tone(size, middle, min(max(width, NARROWEST / length), WIDEST * middle))


def _mean_variance(found: float, count: float, usual: float) -> float:
    """Variance to be expected of `count` amplitudes whose mean square is `found`; exponential beforehand.

    Of a mean that is `usual`, infinite where nothing is known beforehand. What is left is a generalised
    inverse Gaussian distribution.
    """
    if usual == math.inf:
        return found
    count, found = min(count, MANY), max(found, 1e-12 * usual)
    order, at = 0.5 * count - 1.0, math.sqrt(2.0 * count * found / usual)
    return float(math.sqrt(0.5 * count * found * usual) * kve(order - 1.0, at) / kve(order, at))


def _moments(f: Array, power: Array) -> tuple[float, float]:
    """Mean and standard deviation of frequencies by their power."""
    middle = float(f @ power / power.sum())
    return middle, math.sqrt(float((f - middle) ** 2 @ power / power.sum()))
