"""Figures against frequency: spectrum of the motion with its tones, and what could be seen at all.

Not here: how they are found (``motion/tones.py``, ``evaluation/observed.py``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.evaluation.error_spectrum import error_psd
from sightline.evaluation.observed import SEEN_SIGMAS, SEEN_TONE_PX, MatchedDirections
from sightline.motion.observability import Passbands
from sightline.motion.results import LineOfSight
from sightline.motion.tones import DetectedTone, spectrum
from sightline.report.figure import Figure
from sightline.report.marks import Line, Note, Points, Rules, Spans
from sightline.report.style import AXES, AXIS_COLOURS, AXIS_UNITS, BLIND, INK, MUTED, labels

Array = NDArray[np.float64]
#: A PSD is drawn over at most so many decades below its peak.
DECADES = 9.0
#: Blind frequencies of a pair drawn at most, and the largest amplitude drawn, px.
_MARKS, _LARGEST = 400, 1e3


def spectrum_figure(
    result: LineOfSight, bands: Mapping[str, Passbands], tones: Sequence[DetectedTone], highest: float
) -> Figure:
    """PSD of each axis with tones named, beside the prior, the remaining error, and blind bands shaded."""
    found = spectrum(result.motion)
    inside = (found.frequency > 0.0) & (found.frequency <= highest)
    frequency = found.frequency[inside]
    fine = np.geomspace(frequency[0], highest, 1000)
    left = error_psd(result, fine)
    figure = Figure(3, height=215)
    for axis, name in enumerate(AXES):
        panel, square = figure[axis], 1.0 / result.scale[axis] ** 2
        psd, error = found.psd[inside, axis] * square, left[:, axis] * square
        blind = _outside(bands[name], float(frequency[0]), highest)
        panel.add(
            Spans(spans=blind, name=f"blind to a tone of {SEEN_TONE_PX:g} px", colour=BLIND),
            Line(x=frequency, y=psd, name="recovered motion", colour=AXIS_COLOURS[axis], width=1.1),
        )
        if result.spectra is not None:
            prior = result.spectra[axis].psd(fine) * square
            panel.add(Line(x=fine, y=prior, name="spectrum fitted to it (prior)", colour=INK))
        panel.add(Line(x=fine, y=error, name="error that remains", colour=MUTED, dash="dot"))
        own = [tone for tone in tones if tone.axis == name]
        if own:
            near = [np.argmax(psd * (np.abs(frequency - tone.frequency) <= 3 * frequency[0])) for tone in own]
            names = [tone.name for tone in own]
            panel.add(
                Points(
                    x=frequency[near],
                    y=psd[near],
                    name="tone",
                    symbol="ring",
                    size=9,
                    texts=names,
                    says=names,
                )
            )
        top = float(np.log10(psd.max())) + 1.5
        least = min(float(np.log10(max(np.percentile(psd, 2), 1e-300))), float(np.log10(error.min()))) - 0.3
        unit = "px²/Hz" if axis < 2 else "px²/Hz at field edge"
        panel.y.title, panel.y.log = f"{name} ({unit})", True
        panel.y.low, panel.y.high = 10.0 ** max(least, top - DECADES), 10.0**top
    axis_x = figure[0].x
    axis_x.title, axis_x.log, axis_x.low, axis_x.high = "frequency (Hz)", True, float(frequency[0]), highest
    return figure


def visibility_figure(result: LineOfSight, seen: MatchedDirections, names: Sequence[str]) -> Figure:
    """Smallest tone that would stand out, per axis, and below it the blind frequencies of every pair."""
    # a pair matched both ways is blind at the same frequencies: once is enough
    once: dict[frozenset[int], tuple[int, int]] = {}
    for pair in seen.blind:
        once.setdefault(frozenset(pair), pair)
    names = labels(names)
    pairs = [(f"{names[a]} – {names[b]}", seen.blind[a, b]) for a, b in once.values()]
    figure = Figure(2, height=[260, 24.0 * max(len(pairs), 1)])
    f = seen.frequency[1:]
    smallest = SEEN_SIGMAS * seen.tone_sigma[1:] / result.scale
    panel, below = figure[0], figure[1]
    for axis, name in enumerate(AXES):
        y = np.minimum(smallest[:, axis], _LARGEST)
        panel.add(Line(x=f, y=y, name=f"{name} ({AXIS_UNITS[axis]})", colour=AXIS_COLOURS[axis], width=1.2))
    words = f"a tone of {SEEN_TONE_PX:g} px; above this line it counts as blind"
    panel.add(Rules(y=[SEEN_TONE_PX], dash="dash"), Note(y=SEEN_TONE_PX, words=words))
    for k, (name, at) in enumerate(pairs):
        x = at[:: max(1, len(at) // _MARKS)]
        panel_y = np.full(len(x), float(k))
        below.add(Points(x=x, y=panel_y, name=name, key=False, symbol="tick", size=12, colour=MUTED))
    panel.y.title, panel.y.log = "smallest tone seen (px)", True
    panel.y.low = 10.0 ** (float(np.log10(smallest.min())) - 0.2)
    largest = float(np.percentile(np.minimum(smallest, _LARGEST), 99.5))
    panel.y.high = 10.0 ** min(max(math.log10(largest), 0.0), 2.0)
    below.y.title, below.y.grid = "blind alone", False
    below.y.ticks = [(float(k), name) for k, (name, _) in enumerate(pairs)]
    below.y.low, below.y.high = -0.6, len(pairs) - 0.4
    panel.x.title, panel.x.low, panel.x.high = "frequency (Hz)", 0.0, float(f[-1])
    return figure


def tones_of(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[DetectedTone]:
    """Tones of a ``summary.json`` as the objects they were."""
    keys = DetectedTone.__dataclass_fields__
    return [
        DetectedTone(**{key: tone[key] for key in keys if key in tone} | {"axis": axis})
        for axis in AXES
        for tone in found[axis]
    ]


def _outside(bands: Passbands, lowest: float, highest: float) -> list[tuple[float, float]]:
    """Every range of frequencies outside the passbands."""
    out, start = [], lowest
    for low, high in [*bands, (highest, highest)]:
        if low > start:
            out.append((start, min(low, highest)))
        start = max(start, high)
    return out
