"""Compiled loops of the choice: transfer of every setting, and the best setting of every cell.

Not here: their formulas one by one (``imaging/tdi_transfer.py``, which checks them).
"""

from __future__ import annotations

import math

from sightline.compiled import njit

#: Merits closer than this (relative) are one merit: which of them is larger is rounding.
TIE = 1e-12


@njit(cache=True, nogil=True, inline="always")
def _sinc(x):  # type: ignore[no-untyped-def]
    """Sine of pi x over pi x."""
    if abs(x) < 1e-9:
        return 1.0
    return math.sin(math.pi * x) / (math.pi * x)


@njit(cache=True, nogil=True, inline="always")
def _dirichlet(count, phase):  # type: ignore[no-untyped-def]
    """Magnitude of the mean of `count` unit vectors `phase` cycles apart."""
    rest = phase - round(phase)
    return abs(_sinc(count * rest) / _sinc(rest))


@njit(cache=True, nogil=True)
def exact_mtf(velocity, slip, fx, fy, stages, ratios, head, head_ratio, shift, out):  # type: ignore[no-untyped-def]
    """MTF of motion of every setting, exact for mixed exposures.

    Parameters
    ----------
    velocity, slip : (C,)
    fx, fy : float
        Cycles per pixel, each on its own axis.
    stages : (n,) int, rising
    ratios : (k,)
    head : int
    head_ratio, shift : float
        Of the head lines; centre of an exposure minus that of its line, in exposures.
    out : (C, n k, 2)
        Overwritten; settings ordered by stages, then ratio.
    """
    n_ratios = ratios.shape[0]
    real, imaginary = [0.0] * n_ratios, [0.0] * n_ratios
    for c in range(velocity.shape[0]):
        across = velocity[c] * math.tan(slip[c])
        for axis in range(2):
            f = fx if axis == 0 else fy
            psi = f * (across if axis == 0 else velocity[c])
            phi = f * (across if axis == 0 else velocity[c] - 1.0)
            for r in range(n_ratios):
                size = ratios[r] * _sinc(ratios[r] * psi)
                turn = -2.0 * math.pi * shift * ratios[r] * psi
                real[r], imaginary[r] = size * math.cos(turn), size * math.sin(turn)
            size = head_ratio * _sinc(head_ratio * psi)
            turn = -2.0 * math.pi * shift * head_ratio * psi
            first_re, first_im = size * math.cos(turn), size * math.sin(turn)
            head_re = head_im = rest_re = rest_im = 0.0
            k = 0
            for n in range(stages.shape[0]):
                while k < stages[n]:
                    turn = -2.0 * math.pi * k * phi
                    if k < head:
                        head_re += math.cos(turn)
                        head_im += math.sin(turn)
                    else:
                        rest_re += math.cos(turn)
                        rest_im += math.sin(turn)
                    k += 1
                body = max(stages[n] - head, 0)
                fixed_re = first_re * head_re - first_im * head_im
                fixed_im = first_re * head_im + first_im * head_re
                for r in range(n_ratios):
                    re = fixed_re + real[r] * rest_re - imaginary[r] * rest_im
                    im = fixed_im + real[r] * rest_im + imaginary[r] * rest_re
                    total = (stages[n] - body) * head_ratio + body * ratios[r]
                    out[c, n * n_ratios + r, axis] = math.sqrt(re * re + im * im) / total


@njit(cache=True, nogil=True)
def patent_mtf(velocity, slip, fx, fy, stages, ratios, head, head_ratio, shift, out):  # type: ignore[no-untyped-def]
    """MTF of motion of every setting by EP2733929; parameters as of `exact_mtf` (`shift` unused)."""
    n_ratios = ratios.shape[0]
    for c in range(velocity.shape[0]):
        across, along = math.tan(slip[c]) * fx, (velocity[c] - 1.0) * fy
        for n in range(stages.shape[0]):
            body = max(stages[n] - head, 0)
            for r in range(n_ratios):
                mean = ((stages[n] - body) * head_ratio + body * ratios[r]) / stages[n]
                out[c, n * n_ratios + r, 0] = _dirichlet(stages[n], across * mean)
                out[c, n * n_ratios + r, 1] = abs(_sinc(mean * fy)) * _dirichlet(stages[n], along * mean)


@njit(cache=True, nogil=True)
def snr_of_settings(signals, total, square, linear, constant, out):  # type: ignore[no-untyped-def]
    """SNR of every signal and setting.

    Parameters
    ----------
    signals : (S,)
        Electrons of one line at an integration ratio of 1.
    total : (P,)
        Line periods that all stages integrate.
    square, linear, constant : (P,)
        Of the variance, a parabola of the signal.
    out : (S, P)
        Overwritten; without noise infinite where there is signal, else 0.
    """
    for s in range(signals.shape[0]):
        signal = signals[s]
        for p in range(total.shape[0]):
            variance = (square[p] * signal + linear[p]) * signal + constant[p]
            if variance > 0.0:
                out[s, p] = signal * total[p] / math.sqrt(variance)
            else:
                out[s, p] = math.inf if signal * total[p] > 0.0 else 0.0


@njit(cache=True, nogil=True, fastmath=True)
def largest(a, b):  # type: ignore[no-untyped-def]
    """Largest product of two rows of numbers from 0 up."""
    most = 0.0
    for p in range(a.shape[0]):
        most = max(most, a[p] * b[p])
    return most


@njit(cache=True, nogil=True)
def best_settings(by_column, by_signal, out):  # type: ignore[no-untyped-def]
    """First setting of (nearly) the largest product of its two factors; -1 where all are zero.

    Parameters
    ----------
    by_column : (C, P)
        Factor of the merit that MTF gives; 0 where a setting is not allowed.
    by_signal : (S, P)
        Factor that SNR gives; 0 where a setting is not allowed.
    out : (C, S) int
        Overwritten.
    """
    for c in range(by_column.shape[0]):
        for s in range(by_signal.shape[0]):
            most = largest(by_column[c], by_signal[s])
            out[c, s] = -1
            if most > 0.0:
                least = most * (1.0 - TIE)
                p = 0
                while by_column[c, p] * by_signal[s, p] < least:
                    p += 1
                out[c, s] = p
