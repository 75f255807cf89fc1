"""Places of n detectors with the most information at the worst frequency of a band.

Where all choices can be gone through (a thousand million can, in some ten seconds), they are: a layout
shifted or mirrored is the same layout, and one that already does worse at one frequency than the best so far
is left at once, so that a choice costs a few operations. Beyond that many, layouts are improved by moving one
detector, then two at once, to their best places, from many starts; the answer is then one that no move of two
detectors betters.

Not here: what information is (``information.py``).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError
from sightline.motion.layout.information import RowNoise, worst_case
from sightline.motion.layout.kernels import enumerate_layouts, exchange
from sightline.motion.observability import window_gain

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Choices up to which all are gone through (some seconds).
EXHAUSTIVE = 1_000_000_000
#: Orders of unlike images up to which each is gone through by itself.
MOST_ORDERS = 10_000
#: Frequencies per 1 / span in the search; the layouts found are judged more finely afterwards.
PER_PERIOD = 24
#: Most phasors (places x frequencies) held, and the frequencies per 1 / span that they must still allow.
MOST_CELLS, LEAST_PER_PERIOD = 16_000_000, 6
#: Most places that still leave a frequency or sixteen.
MOST_PLACES = MOST_CELLS // 16
#: Good layouts kept for ranking.
KEPT = 4000
#: Starts of the search that is not exhaustive, and how many of their results are improved by pairs.
STARTS, IMPROVED = 600, 12
#: Pairs of moves that improving them may cost, per sweep.
PAIR_WORK = 3.0e8
#: Spans, and starts for each, whose best layouts are sought where the search is not exhaustive.
SPANS, SPAN_STARTS = 24, 40


@dataclass(frozen=True, eq=False)
class Candidates:
    """Places that detectors may have.

    Attributes
    ----------
    t : (G,)
        s, increasing.
    min_spacing : float
        s; between neighbouring detectors.
    even : bool
        Whether the places are evenly spaced: a shifted or mirrored layout is then the same one.
    """

    t: Array
    min_spacing: float
    even: bool

    @classmethod
    def even_grid(cls, span: float, step: float, min_spacing: float) -> Candidates:
        """Multiples of `step` (s) from 0 to `span`; InputError where they are too many to search."""
        if span / step > MOST_PLACES:
            raise InputError(
                f"multiples of {step:.6g} s over {span:.6g} s are {span / step:.3g} places; the search holds "
                f"{MOST_PLACES} at most: give a longer step_px or a shorter span"
            )
        count = math.floor(span / step * (1.0 + 1e-9)) + 1
        return cls(step * np.arange(count, dtype=np.float64), min_spacing, True)

    @property
    def next_allowed(self) -> Index:
        """(G,) the first place far enough beyond each."""
        slack = 1e-9 * max(float(np.ptp(self.t)), 1e-300)
        beyond = np.searchsorted(self.t, self.t + self.min_spacing - slack, side="left")
        return np.maximum(beyond, np.arange(len(self.t)) + 1).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Found:
    """Good layouts, best first.

    Attributes
    ----------
    places : (K, n) int
        Indices into the candidates.
    order : (K, n) int
        Which image's noise stands at each place.
    worst : (K,)
        Least information in the band at the frequencies of the search, px^-2 per row.
    by_span : (B,)
        The same of the best layout of each span (shares (b + 1) / B of the whole); -inf where there is none.
    by_span_places : (B, n) int
    by_span_order : (B, n) int
    tried : float
        Layouts gone through (or judged).
    exhaustive : bool
    """

    places: Index
    order: Index
    worst: Array
    by_span: Array
    by_span_places: Index
    by_span_order: Index
    tried: float
    exhaustive: bool


def search_layouts(
    candidates: Candidates,
    noise: RowNoise,
    passband: tuple[float, float],
    *,
    exhaustive: bool | None = None,
    seed: int = 0,
) -> Found:
    """The layouts with the largest worst-case information in `passband` (Hz).

    Parameters
    ----------
    candidates : Candidates
    noise : RowNoise
        Of as many images as there are detectors; where they differ, their order is chosen too.
    passband : (low, high)
        Hz.
    exhaustive : bool, optional
        Go through all choices, or do not; by default where they are not too many.
    seed : int
        Of the starts where the search is not exhaustive.

    Raises
    ------
    InputError
        If the detectors do not fit.
    """
    n = len(noise.sigma_px)
    check_room(candidates, n)
    if exhaustive is None:
        exhaustive = choices(candidates, noise) <= EXHAUSTIVE and _orders(noise.kinds) <= MOST_ORDERS
    tables = _Tables.of(candidates, noise, passband)
    if exhaustive:
        orders = distinct_orders(noise.kinds, mirrored=candidates.even)
        return _joined([_exhaust(tables, candidates, noise, order) for order in orders], True)
    return _joined([_improve(tables, candidates, noise, seed)], False)


def expected_trials(candidates: Candidates, noise: RowNoise) -> float:
    """How many layouts a search judges, about: all, or what improving them from many starts comes to.

    By starts that move a detector some three times, and pairs of detectors that move once or twice.
    """
    if choices(candidates, noise) <= EXHAUSTIVE and _orders(noise.kinds) <= MOST_ORDERS:
        return choices(candidates, noise)
    places, n = len(candidates.t), len(noise.sigma_px)
    work = 0.5 * places**2 * 0.5 * n * (n - 1)
    pairs = float(np.clip(PAIR_WORK / work, 1, IMPROVED)) * work
    return 3.0 * n * places * (STARTS + SPANS * SPAN_STARTS) + 1.5 * pairs


def choices(candidates: Candidates, noise: RowNoise) -> float:
    """How many layouts there are, orders of unlike images included, mirrored ones once, of any spacing."""
    places, n = len(candidates.t), len(noise.sigma_px)
    ways = math.comb(places - 1, n - 1) if candidates.even else math.comb(places, n)
    try:
        return ways * _orders(noise.kinds) / (2.0 if candidates.even and n > 2 else 1.0)
    except OverflowError:  # 64 of 100,000 places are more than a float counts
        return math.inf


def _orders(images: Sequence[Hashable]) -> int:
    """In how many orders images that are alike or not can stand."""
    return math.factorial(len(images)) // math.prod(math.factorial(images.count(s)) for s in set(images))


def distinct_orders(sigma: Sequence[Hashable], *, mirrored: bool) -> Index:
    """Orders of images along the track that differ in their noise, (M, n); one of two mirrored ones."""
    kinds = {value: k for k, value in enumerate(dict.fromkeys(sigma))}
    seen: dict[tuple[int, ...], tuple[int, ...]] = {}
    for order in _arranged(list(range(len(sigma))), sigma):
        key = tuple(kinds[sigma[k]] for k in order)
        if not (mirrored and key[::-1] in seen):
            seen[key] = order
    return np.array(list(seen.values()), dtype=np.int64)


def _arranged(images: list[int], sigma: Sequence[Hashable]) -> Iterator[tuple[int, ...]]:
    """Every order of images that differs in their noise, once: alike ones in the order of their numbers."""
    if not images:
        yield ()
    tried: set[Hashable] = set()
    for k, image in enumerate(images):
        if sigma[image] not in tried:
            tried.add(sigma[image])
            for rest in _arranged(images[:k] + images[k + 1 :], sigma):
                yield (image, *rest)


def polished(
    positions: Array,
    noise: RowNoise,
    passband: tuple[float, float],
    *,
    step: float,
    span: float,
    min_spacing: float,
    fixed_span: bool = False,
) -> Array:
    """A layout moved off the grid to more information at the worst frequency, by a compass search.

    Positions (n,) in s start at 0 and stay within `span`. One detector is moved at a time, or all beyond a
    gap, by `step` and at last by a sixteenth of it.
    """
    best = np.array(positions, dtype=np.float64)
    value = worst_case(best, passband, noise)[0]
    n = len(best)
    moves = [np.eye(n)[k] for k in range(1, n)] + [(np.arange(n) >= k) * 1.0 for k in range(1, n - 1)]
    if fixed_span:
        moves = [move for move in moves if move[-1] == 0.0]
    for size in step * 0.5 ** np.arange(5):
        moved = True
        while moved:
            moved = False
            for move in (sign * size * move for move in moves for sign in (1.0, -1.0)):
                trial = best + move
                if np.diff(trial).min() < min_spacing * (1.0 - 1e-9) or trial[-1] > span * (1.0 + 1e-9):
                    continue
                now = worst_case(trial, passband, noise)[0]
                if now > value:
                    best, value, moved = trial, now, True
    return best


def check_room(candidates: Candidates, detectors: int) -> None:
    """InputError unless so many detectors fit, spacing kept."""
    if detectors < 2:
        raise InputError(f"`detectors` must be 2 or more, got {detectors}; one image alone sees no motion")
    allowed, place = candidates.next_allowed, 0
    for fitted in range(1, detectors + 1):
        if place >= len(candidates.t):
            raise InputError(
                f"{detectors} detectors at least {candidates.min_spacing:.6g} s apart do not fit: there is "
                f"room for {fitted - 1} within {float(np.ptp(candidates.t)):.6g} s; allow a longer span or "
                "closer detectors"
            )
        place = int(allowed[place])


@dataclass(frozen=True, eq=False)
class _Tables:
    """Phasors of every place at every frequency, what the window leaves, and what each image sees."""

    re: NDArray[np.float32]  # (G, F)
    im: NDArray[np.float32]
    gain: NDArray[np.float32]  # (F,)
    power: NDArray[np.float32]  # (F,) sum of weights by squares of what is seen
    weights: NDArray[np.float32]  # (n, F) weights by what is seen
    total: np.float32  # sum of weights

    @classmethod
    def of(cls, candidates: Candidates, noise: RowNoise, passband: tuple[float, float]) -> _Tables:
        low, high = passband
        periods, places = (high - low) * (float(np.ptp(candidates.t)) + noise.window), len(candidates.t)
        periods += (high - low) * max(noise.tdi, default=0.0)
        count = min(PER_PERIOD * periods, MOST_CELLS / places)
        if count < LEAST_PER_PERIOD * periods:
            raise InputError(
                f"{places} places over {periods:.0f} periods of the band are more than the search can hold; "
                "give fewer places, a shorter span or a narrower band"
            )
        f = np.linspace(low, high, max(math.ceil(count), 16) + 1)
        # neighbours are alike: in random order a bad layout is found out sooner
        f = np.random.default_rng(0).permutation(f)
        phase = 2.0 * np.pi * (candidates.t - candidates.t[0])[:, None] * f
        gain = window_gain(f, noise.window) ** 2
        seen, weights = noise.seen(f), noise.weights.astype(np.float32)
        total = weights.sum()
        power = (weights[:, None] * seen**2).sum(axis=0) if noise.tdi else np.full(len(f), total)
        return cls(
            np.cos(phase).astype(np.float32), np.sin(phase).astype(np.float32), gain.astype(np.float32),
            power.astype(np.float32), (weights[:, None] * seen).astype(np.float32), total,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Part:
    """Layouts of one search: as in `Found`, in any order."""

    places: Index
    order: Index
    worst: Array
    by_span: Array
    by_span_places: Index
    by_span_order: Index
    tried: float


def _exhaust(tables: _Tables, candidates: Candidates, noise: RowNoise, order: Index) -> _Part:
    """All layouts for one order of the images."""
    kinds = noise.ordered(order).kinds
    mirrored = candidates.even and kinds == kinds[::-1]
    firsts = 1 if candidates.even else len(candidates.t)
    places, worst, by_span, by_span_places, tried = enumerate_layouts(
        tables.re, tables.im, tables.gain, tables.power, tables.weights[order], tables.total,
        candidates.next_allowed, _span_bins(candidates), firsts, mirrored, KEPT,
    )  # fmt: skip
    orders, by_span_order = (np.tile(order, (len(rows), 1)) for rows in (places, by_span_places))
    return _Part(places, orders, worst, by_span, by_span_places, by_span_order, float(tried))


def _span_bins(candidates: Candidates) -> Array:
    """(G,) places in units of a bin of spans; there are as many bins as places."""
    t = candidates.t - candidates.t[0]
    return np.asarray(t / t[-1] * (len(t) - 1))


class _Improver:
    """Moves detectors of many starts to better places, and remembers every layout it ends at."""

    def __init__(self, tables: _Tables, candidates: Candidates, noise: RowNoise, seed: int) -> None:
        self.tables, self.candidates, self.noise = tables, candidates, noise
        self.rng = np.random.default_rng(seed)
        self.alike = len(set(noise.kinds)) == 1
        self.found: dict[tuple[tuple[int, ...], tuple[int, ...]], float] = {}
        self.tried = 0.0

    def improve(
        self, at: Index, order: Index, *, held: int, pairs: bool = False, places: int | None = None
    ) -> None:
        """Improve one layout, its first `held` detectors left alone, within the first `places` candidates."""
        tables, inside = self.tables, slice(places)
        moved, value, count = exchange(
            tables.re[inside], tables.im[inside], tables.gain, tables.power, tables.weights[order],
            tables.total, self.candidates.next_allowed[inside], at, held, pairs, self.alike,
        )  # fmt: skip
        along = np.argsort(moved)
        kept = order if self.alike else order[along]
        self.found[tuple(moved[along].tolist()), tuple(kept.tolist())] = float(value)
        self.tried += float(count)

    def order(self) -> Index:
        """An order of the images to start from."""
        n = len(self.noise.sigma_px)
        return np.arange(n) if self.alike else self.rng.permutation(n)

    def ranked(self) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Layouts (places, order), best first."""
        return sorted(self.found, key=lambda key: (-self.found[key], key))


def _improve(tables: _Tables, candidates: Candidates, noise: RowNoise, seed: int) -> _Part:
    """Layouts that no move of two detectors betters, from many starts; and good ones of some spans."""
    n, search = len(noise.sigma_px), _Improver(tables, candidates, noise, seed)
    free = 1 if candidates.even else 0
    for start in _starts(candidates, n, search.rng):
        search.improve(start, search.order(), held=free)
    work = 0.5 * len(candidates.t) ** 2 * 0.5 * n * (n - 1)
    for places, order in search.ranked()[: int(np.clip(PAIR_WORK / work, 1, IMPROVED))]:
        search.improve(np.array(places), np.array(order), held=free, pairs=True)
    shortest = int(_tightest(candidates, n)[-1])
    for last in np.unique(np.geomspace(shortest, len(candidates.t) - 1, SPANS).round().astype(int)):
        for start in _starts(candidates, n, search.rng, last=last)[:SPAN_STARTS]:
            both_ends_first = np.roll(start, 1)
            search.improve(both_ends_first, search.order(), held=2, places=last + 1)
    return _collected(search, candidates)


def _collected(search: _Improver, candidates: Candidates) -> _Part:
    """What a search ended at, with the best of each span."""
    ranked = search.ranked()
    every, orders = (np.array([key[k] for key in ranked], dtype=np.int64) for k in (0, 1))
    values = np.array([search.found[key] for key in ranked])
    bins = _span_bins(candidates)
    span = np.rint(bins[every[:, -1]] - bins[every[:, 0]]).astype(np.intp)
    by_span, row = np.full(len(bins), -np.inf), np.zeros(len(bins), dtype=np.intp)
    for k in range(len(ranked) - 1, -1, -1):  # the best comes last and stays
        by_span[span[k]], row[span[k]] = values[k], k
    return _Part(every, orders, values, by_span, every[row], orders[row], search.tried)


def _starts(
    candidates: Candidates, n: int, rng: np.random.Generator, *, last: int | None = None
) -> list[Index]:
    """Random layouts of all spans, or with their ends at the first place and at `last`, spacing kept."""
    allowed, places = candidates.next_allowed, len(candidates.t)
    out: list[Index] = [_tightest(candidates, n)]
    while len(out) < STARTS:
        reach = min(places, max(n, round(places * float(rng.uniform()) ** 2))) if last is None else last + 1
        first = 0 if candidates.even or last is not None else int(rng.integers(0, places - reach + 1))
        chosen = np.sort(rng.choice(reach, n, replace=False)).astype(np.int64) + first
        chosen[0] = first
        for k in range(1, n):  # push apart what stands too close; what is pushed out starts at the tightest
            chosen[k] = max(chosen[k], allowed[min(chosen[k - 1], places - 1)])
        out.append(chosen if chosen[-1] < first + reach else out[0].copy())
        if last is not None:
            out[-1][-1] = last
    return out if last is None else [start for start in out[1:] if start[-1] >= allowed[start[-2]]]


def _tightest(candidates: Candidates, n: int) -> Index:
    """The layout of the first places that are allowed."""
    allowed, out = candidates.next_allowed, [0]
    while len(out) < n:
        out.append(int(allowed[out[-1]]))
    return np.array(out, dtype=np.int64)


def _joined(parts: Sequence[_Part], exhaustive: bool) -> Found:
    """Results of all orders of the images, best first."""
    places = np.concatenate([part.places for part in parts])
    order = np.concatenate([part.order for part in parts])
    worst = np.concatenate([part.worst for part in parts])
    rank = np.argsort(-worst, kind="stable")
    spans = np.stack([part.by_span for part in parts])
    best, rows = np.argmax(spans, axis=0), np.arange(spans.shape[1])
    return Found(
        places[rank], order[rank], worst[rank], spans[best, rows],
        np.stack([part.by_span_places for part in parts])[best, rows],
        np.stack([part.by_span_order for part in parts])[best, rows],
        sum(part.tried for part in parts), exhaustive,
    )  # fmt: skip
