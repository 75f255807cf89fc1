"""Bands that match no other: which they are, by the windows kept, and what remains without them.

Not here: what is said of them (``warnings.py``), and what would have them match (``alternatives.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.matching.matches import KEPT, MASKED, NOT_CHOSEN, OUTLIER, OUTSIDE
from sightline.motion.measure.stars import StarRecord

#: Fewer windows than this share kept at the end are worth a warning.
ENOUGH_KEPT = 0.5
#: A pair that keeps fewer windows, or a smaller share of those compared, tells nothing: false matches do so.
FEWEST_KEPT, LEAST_SHARE = 10, 0.1

#: Of the windows of a wide search chance keeps up to an eighth: a band that keeps no more than this share in
#: any pair looks like none.
HARDLY = 0.25
#: Share of all windows that such a band costs at least where it is put last.
MUCH = 0.1


def pair_tells(kept: ArrayLike, tried: ArrayLike) -> NDArray[np.bool_]:
    """Whether pairs that kept so many windows of those tried measure anything; false matches alone do not."""
    kept, tried = np.asarray(kept), np.asarray(tried)
    return np.asarray((kept >= FEWEST_KEPT) & (kept >= LEAST_SHARE * tried))


def without_lost(records: Sequence[StarRecord], bands: int) -> tuple[StarRecord, ...]:
    """The records without what little was kept of bands that look like no other, beside others that match.

    Chance made it, or it lies where the search ended: a place for such a band, and a motion, no sigma owns.
    """
    lost = like_none(records, bands, LEAST_SHARE)
    if not lost.any() or lost.all():
        return tuple(records)
    out = []
    for record in records:
        star = record.star
        gone = lost[list(star.images)] | lost[star.hub]
        status = np.where(gone & (record.status == KEPT), OUTLIER, record.status)
        residual = np.where(gone[:, None], np.nan, star.residual_px)
        out.append(replace(record, star=replace(star, residual_px=residual), status=status))
    return tuple(out)


def windows_tried(record: StarRecord) -> NDArray[np.bool_]:
    """(G, K) windows that were compared: none under a mask, nor where the other image has no pixels."""
    return ~np.isin(record.status, (OUTSIDE, NOT_CHOSEN, MASKED))


def pairs_compared(records: Sequence[StarRecord], bands: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(bands, bands) windows of each pair that were compared, and those kept."""
    compared, kept = np.zeros((2, bands, bands), dtype=int)
    for record in records:
        tried = windows_tried(record)
        for k, image in enumerate(record.star.images):
            compared[record.star.hub, image] += int(tried[:, k].sum())
            kept[record.star.hub, image] += int(record.star.present[:, k].sum())
    return compared + compared.T, kept + kept.T


def like_none(records: Sequence[StarRecord], bands: int, share: float = HARDLY) -> NDArray[np.bool_]:
    """(bands,) those that keep less than a `share` of the windows compared with each other band."""
    compared, kept = pairs_compared(records, bands)
    return np.asarray(compared.any(axis=1) & (kept < share * compared + (compared == 0)).all(axis=1))


def spoilt_hub(records: Sequence[StarRecord], bands: int) -> int | None:
    """The band that others were compared through, though it matches hardly any; None if there is none."""
    through = compared_through(records, bands) * like_none(records, bands)
    return int(np.argmax(through)) if through.max() > MUCH else None


def compared_through(records: Sequence[StarRecord], bands: int) -> NDArray[np.float64]:
    """Of each band, the share of all windows tried that were cut from it to be found in two others or more.

    There these are compared through it alone: what it does not show, they do not.
    """
    tried = np.zeros(bands)
    of_all = 0
    for record in records:
        count = int(windows_tried(record).sum())
        of_all += count
        if len(record.star.images) > 1:
            tried[record.star.hub] += count
    return tried / max(of_all, 1)
