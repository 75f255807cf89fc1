"""What a recovery of a spinning camera says on its page: the spin in words, pairs of strips as a table.

Not here: what all recoveries say (``words.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sightline.applications.spin_attitude import SpinAttitude
from sightline.report.page import Section, Table
from sightline.report.style import AXES, AXIS_UNITS
from sightline.report.words import digits

STRIP_HEADS = (
    "strips, exposures apart",
    "windows kept",
    "mean, line (px)",
    "mean, column (px)",
    "rms, line (px)",
    "rms, column (px)",
    "matcher's sigma ×",
    "means per exposure, rms (px)",
)
CLOSURE_HEADS = ("one after the other less direct", "line (px)", "column (px)")


def spin_sections(result: SpinAttitude, names: Sequence[str]) -> list[Section]:
    """Sentences and tables; `names` are those of the strips."""
    strips = (
        "Residuals after the estimate: mean over all windows with its sigma, rms of single windows, the "
        "factor by which the matcher's sigma was rescaled (line / column), and the rms of the means over "
        "single exposures (line / column)."
    )
    closures = (
        "Mean residuals of two pairs of strips one after the other, less that of the direct pair: zero "
        "where all agree."
    )
    found = [
        Section("spin", "Spin", [_spin(result), _observed(result), _departures(result)]),
        Section("pairs-of-strips", "Pairs of strips", [strips, Table(STRIP_HEADS, _strips(result, names))]),
    ]
    rows = _closures(result, names)
    return [*found, Section("closure", "Closure", [closures, Table(CLOSURE_HEADS, rows)])] if rows else found


def _spin(result: SpinAttitude) -> str:
    found = result.found
    turns = 60.0 * abs(found.rate) / (2.0 * np.pi)
    dt = found.interval
    parts = [
        f"± {digits(1e6 * dt * value, 2)} µrad {words}"
        for value, words in (
            (found.rate_sigma_images, "from the images"),
            (found.rate_sigma_camera, "from not knowing lens and chip better"),
            (found.rate_sigma_parallax, "from not knowing the parallax"),
        )
        if value > 0.0
    ]
    axis = ", ".join(f"{v:+.5f}" for v in found.axis)
    product = f"{found.rate_times_focal * dt:.4f} ± {digits(found.rate_times_focal_sigma * dt, 2)}"
    return (
        f"The body turns by {found.rate * dt:+.7f} rad per exposure of {dt:.4g} s ({turns:.5f} turns a "
        f"minute), {', '.join(parts)}, about the body axis [{axis}], known to "
        f"{digits(1e6 * found.axis_sigma.max(), 2)} µrad. What the images give themselves is rate times "
        f"focal length: {product} px per exposure."
    )


def _observed(result: SpinAttitude) -> str:
    rank = result.found.rank
    blind = f"; {rank.blind} are not observable at all" if rank.blind else ""
    return (
        f"Of {len(rank.names)} constants of spin, lens and chip that were not known exactly, the images "
        f"observe {rank.rank} directions better than was known before{blind}. The weakest direction: "
        f"{rank.weakest}."
    )


def _departures(result: SpinAttitude) -> str:
    found = result.found
    parts = [
        f"{axis} {digits(found.departure_rms[k] / result.scale[k], 2)} ± "
        f"{digits(found.departure_sigma[k] / result.scale[k], 2)} {AXIS_UNITS[k]}, at most "
        f"{digits(found.departure_limit[k] / result.scale[k], 2)}"
        for k, axis in enumerate(AXES)
    ]
    said = "; ".join(parts)
    return f"Departures of single exposures from an even spin (rms, its sigma, limit at 95 %): {said}."


def _strips(result: SpinAttitude, names: Sequence[str]) -> list[list[str]]:
    rows = []
    for strip in result.found.strips:
        means = strip.frame_means_px
        rows.append(
            [
                f"{names[strip.hub]} – {names[strip.partner]}, {strip.lag}",
                f"{strip.kept:,} of {strip.tried:,}",
                *(f"{m:+.3f} ± {s:.3f}" for m, s in zip(strip.mean_px, strip.mean_sigma_px, strict=True)),
                *(f"{value:.3f}" for value in strip.rms_px),
                " / ".join(f"{value:.2f}" for value in strip.scale),
                " / ".join(f"{value:.3f}" if np.isfinite(value) else "–" for value in means),
            ]
        )
    return rows


def _closures(result: SpinAttitude, names: Sequence[str]) -> list[list[str]]:
    rows = []
    for closure in result.found.closures:
        (a, b, d), (first, second) = closure.strips, closure.lags
        title = (
            f"{names[a]} – {names[b]}, {first}; {names[b]} – {names[d]}, {second}; less {names[a]} – "
            f"{names[d]}, {first + second}"
        )
        cells = zip(closure.value_px, closure.sigma_px, strict=True)
        rows.append([title, *(f"{value:+.3f} ± {sigma:.3f}" for value, sigma in cells)])
    return rows
