"""Frames of a sequence that photogrammetry needs: far enough apart for depth, near enough to overlap.

Not here: what is made of them (``poses.py``, ``reconstruct.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sightline.errors import InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.matching.follow import Followed
from sightline.photogrammetry.sightings import Index, as_index

#: Overlaps that far from the wanted one are as good, share of the frame.
_GRACE = 0.03
#: Sharpness of a frame over that of its neighbours below which it is taken only where there is no other.
_BLURRED = 0.8
#: Frames to each side that show what is sharp.
_AROUND = 8
#: rad; less parallax gives no depth.
_LEAST_PARALLAX = 0.02
#: Least overlap that more parallax is bought with.
_LEAST_OVERLAP = 0.55


@dataclass(frozen=True, eq=False)
class Subset(ReadOnlyArrays):
    """Frames chosen, in their order.

    Attributes
    ----------
    frames : (K,) int
    overlap : (K,)
        Measured share of the frame that the one chosen before shows; NaN where a stretch begins.
    parallax : (K,)
        rad, angle between the lines of sight from both to the ground between them; NaN likewise.
    reason : tuple of str
        Why each was taken, in words.
    """

    frames: Index
    overlap: Array
    parallax: Array
    reason: tuple[str, ...]

    def __len__(self) -> int:
        """Number of frames chosen."""
        return len(self.frames)


def motion_overlap(motion: Array, shape: tuple[int, int]) -> float:
    """Share of a frame that is still seen after it moved by (line, column) px, turned (rad) and grew.

    Counted on a grid of 32 x 32 places.
    """
    lines, columns = shape
    grid = np.stack(
        np.meshgrid(np.linspace(-0.5, 0.5, 32) * lines, np.linspace(-0.5, 0.5, 32) * columns, indexing="ij"),
        axis=-1,
    ).reshape(-1, 2)
    c, s, g = np.cos(motion[2]), np.sin(motion[2]), 1.0 + motion[3]
    moved = g * grid @ np.array([[c, s], [-s, c]]) + motion[:2]
    return float((np.abs(moved) <= 0.5 * np.array(shape)).all(axis=1).mean())


def chained(first: Array, second: Array) -> Array:
    """Two motions (4,), one after the other."""
    c, s, g = np.cos(second[2]), np.sin(second[2]), 1.0 + second[3]
    shift = g * first[:2] @ np.array([[c, s], [-s, c]]) + second[:2]
    return np.array([*shift, first[2] + second[2], (1.0 + first[3]) * g - 1.0])


def choose_subset(
    followed: Followed,
    position: Array,
    distance: Array,
    shape: tuple[int, int],
    *,
    overlap: float = 0.8,
    stride: int | None = None,
) -> Subset:
    """Frames for photogrammetry, by measured overlap, parallax and sharpness.

    Parameters
    ----------
    followed : Followed
        How M frames moved.
    position : (M, 3)
        m, as well as it is known.
    distance : (M,)
        m, to the ground.
    shape : (int, int)
        Of a frame, px.
    overlap : float
        Wanted between frames chosen one after the other.
    stride : int, optional
        Take every so many frames instead, whatever they show.

    Returns
    -------
    Subset
    """
    if not 0.3 <= overlap < 1.0:
        raise InputError(f"`overlap` must be from 0.3 to 1, got {overlap}")
    walk = _Walk(followed, position, distance, shape)
    for chain in _chains(followed):
        if stride is not None:
            picks = [*range(0, len(chain), stride)]
            walk.take(chain, picks, [f"every {stride} frames"] * len(picks))
        else:
            walk.take(chain, *_walked(walk, chain, overlap))
    return Subset(
        as_index(walk.frames, "frames"), frozen(walk.overlap), frozen(walk.parallax), tuple(walk.reason)
    )


def _chains(followed: Followed) -> list[list[int]]:
    """Frames linked one to the next."""
    chains: dict[int, list[int]] = {}
    of: dict[int, int] = {}
    for k, before in enumerate(followed.before):
        if before >= 0:
            start = of.get(int(before), int(before))
            of[k] = of[int(before)] = start
            chains.setdefault(start, [start]).append(k)
    return [sorted(set(chain)) for chain in chains.values()]


class _Walk:
    """What two frames of a chain share."""

    def __init__(self, followed: Followed, position: Array, distance: Array, shape: tuple[int, int]) -> None:
        self.followed, self.position, self.distance, self.shape = followed, position, distance, shape
        self.sharp = _relative_sharpness(followed.sharpness)
        self.frames: list[int] = []
        self.overlap: list[float] = []
        self.parallax: list[float] = []
        self.reason: list[str] = []

    def angle(self, i: int, j: int) -> float:
        """rad, parallax between two frames."""
        base = float(np.linalg.norm(self.position[j] - self.position[i]))
        return float(2.0 * np.arctan2(0.5 * base, 0.5 * (self.distance[i] + self.distance[j])))

    def take(self, chain: list[int], picks: list[int], reasons: list[str]) -> None:
        """Note frames of a chain that were chosen."""
        for n, (pick, reason) in enumerate(zip(picks, reasons, strict=True)):
            frame = chain[pick]
            share = angle = np.nan
            if n:
                motion = np.zeros(4)
                for k in chain[picks[n - 1] + 1 : pick + 1]:
                    motion = chained(motion, self.followed.motion[k])
                share, angle = motion_overlap(motion, self.shape), self.angle(chain[picks[n - 1]], frame)
            self.frames.append(frame)
            self.overlap.append(share)
            self.parallax.append(angle)
            self.reason.append(reason)


def _relative_sharpness(sharpness: Array) -> Array:
    """Sharpness (M,) of each frame over the median of its neighbours."""
    out = np.full(len(sharpness), np.nan)
    for k in range(len(sharpness)):
        around = sharpness[max(k - _AROUND, 0) : k + _AROUND + 1]
        if np.isfinite(around).any():
            out[k] = sharpness[k] / np.nanmedian(around)
    return out


def _walked(walk: _Walk, chain: list[int], wanted: float) -> tuple[list[int], list[str]]:
    """Places in a chain and reasons, from its first frame to its last."""
    picks, reasons = [0], ["first of its stretch"]
    if walk.sharp[chain[0]] < _BLURRED:
        better = [k for k in range(1, min(4, len(chain))) if walk.sharp[chain[k]] >= _BLURRED]
        if better:
            picks, reasons = [better[0]], ["first sharp frame of its stretch"]
    while picks[-1] < len(chain) - 1:
        pick, reason = _next(walk, chain, picks[-1], wanted)
        picks.append(pick)
        reasons.append(reason)
    return picks, reasons


def _next(walk: _Walk, chain: list[int], start: int, wanted: float) -> tuple[int, str]:
    """The place after `start`, and why."""
    motion, shares = np.zeros(4), []
    for k in range(start + 1, len(chain)):
        motion = chained(motion, walk.followed.motion[chain[k]])
        shares.append(motion_overlap(motion, walk.shape))
        if shares[-1] < min(_LEAST_OVERLAP, wanted - _GRACE):
            break
    share = np.array(shares)
    places = start + 1 + np.arange(len(share))
    angle = np.array([walk.angle(chain[start], chain[p]) for p in places])
    sharp = walk.sharp[[chain[p] for p in places]]
    good = np.abs(share - wanted) <= _GRACE
    if not (share < wanted - _GRACE).any() and places[-1] == len(chain) - 1:
        return int(places[-1]), f"last of its stretch: {share[-1]:.0%} overlap"
    if not good.any():
        good = np.arange(len(share)) == int(np.argmin(np.abs(share - wanted)))
    note = ""
    if (
        angle[good].max() < _LEAST_PARALLAX
        and (deep := (share >= _LEAST_OVERLAP) & (angle >= _LEAST_PARALLAX)).any()
    ):
        good = np.arange(len(share)) == int(np.flatnonzero(deep)[0])
        note = "; nearer ones have too little parallax"
    clear = good & (sharp >= _BLURRED)
    if clear.any():
        note += f"; {int((good & ~clear).sum())} blurred passed over" if (good & ~clear).any() else ""
    else:
        note += "; blurred, but there is no other"
        clear = good
    rows = np.flatnonzero(clear)
    best = rows[np.argmax(np.round(sharp[rows], 2) - np.abs(share[rows] - wanted))]
    text = f"{share[best]:.0%} overlap (wanted {wanted:.0%}), {np.degrees(angle[best]):.1f} deg parallax"
    return int(places[best]), text + f", sharpness {sharp[best]:.2f} of its neighbours'" + note
