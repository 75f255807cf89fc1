"""What windows at one place of the detector err alike in all frames, finer than any field of the lens.

Panes, filters and the pixels themselves shift the image by hundredths of a pixel, otherwise in every window.
Frames that follow each other evenly see the same pairs of places at one lag: their errors do not average.
They are learned from products of residuals of different frames, which no noise of single frames makes.

Not here: what they do to the covariance (``errors.py``), smooth fields (``lens_field.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sightline.motion.frames.errors import overlap
from sightline.motion.frames.noise import CLIP, MIN_COUNT, cholesky_factors, free_directions, whitened_by
from sightline.motion.frames.solve import FrameEstimate

Array = NDArray[np.float64]

#: Standard errors that products of different frames must stand above zero.
SIGN = 3.0


@dataclass(frozen=True, eq=False)
class _Seen:
    """Residuals of one frame's windows (G,) at one lag, in sigmas of the matcher, free of heights.

    `kept` are good ones; `by_px` (G, 2) is their change with the match, per px, `design` (G, P) that with the
    unknowns; `measured` (G, 2) is where they were found, px.
    """

    value: Array
    kept: NDArray[np.bool_]
    by_px: Array
    design: Array
    measured: Array


def learn_repeated(estimate: FrameEstimate) -> float:
    """Sigma (px) of a field of shifts, alike in all frames, that windows which overlap share.

    Notes
    -----
    A match errs by the field at the partner less that at the hub. Least squares over all pairs of frames,
    windows at one place of the hub: ``E[r_a r_b] + d_a P d_b' = (1 + share) b_a . b_b sigma^2`` with
    residuals r, sensitivities d to the unknowns of posterior P (what the fit takes out of the errors), b to
    the match, and the share of pixels that the windows in the partners have in common. 0 where products
    show none.
    """
    window = estimate.matched[0].window
    product = weight = spread = 0.0
    count = 0
    for (lag, _), frames in _by_lag(estimate).items():
        variance = float(estimate.noise.of((lag,))[0, 0])
        posterior = [one.design @ estimate.posterior for one in frames]
        for first, second in combinations(range(len(frames)), 2):
            a, b = frames[first], frames[second]
            both = a.kept & b.kept
            share = 1.0 + overlap(a.measured[both], b.measured[both], window)
            taken = np.einsum("gp,gp->g", posterior[first][both], b.design[both])
            model = share * (a.by_px[both] * b.by_px[both]).sum(axis=1)
            product += float(model @ (a.value[both] * b.value[both] + taken))
            weight += float(model @ model)
            spread += variance**2 * float(model @ model)
            count += int(both.sum())
    if count < MIN_COUNT or product < SIGN * np.sqrt(spread):
        return 0.0
    return float(np.sqrt(product / weight))


def _by_lag(estimate: FrameEstimate) -> dict[tuple[int, int], list[_Seen]]:
    """Residuals of all frames by lag and direction."""
    out: dict[tuple[int, int], list[_Seen]] = {}
    followed = zip(estimate.matched, estimate.clean_px, estimate.followed(), strict=True)
    for star, clean, (line, _, design, _) in followed:
        factors = cholesky_factors(line.covariance_px)
        scaled, inverse = whitened_by(clean, factors), np.linalg.inv(factors)
        limit = CLIP * np.sqrt(np.diag(estimate.noise.of(star.lags)))
        for part, direction in enumerate(free_directions(line, bool(estimate.fields))):
            value = (direction * scaled).sum(axis=2)
            kept = line.present & (np.abs(value) <= limit) & (direction != 0.0).any(axis=2)
            by_px = np.einsum("gkc,gkcd->gkd", direction, inverse)
            rows = np.einsum("gkc,gkcp->gkp", direction, design)
            for k, lag in enumerate(star.lags):
                seen = _Seen(value[:, k], kept[:, k], by_px[:, k], rows[:, k], star.measured[:, k])
                out.setdefault((lag, part), []).append(seen)
    return out
