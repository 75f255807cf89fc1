"""What a registration found, in names and numbers: the ``summary.json`` of ``register``.

Not here: the images (``registered.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sightline.applications.registration import Registration
from sightline.io.acquisition.acquired import Acquisition
from sightline.io.results.line_of_sight import peak_memory
from sightline.io.results.recovered import Recovered
from sightline.io.results.registered import Written
from sightline.motion.strip.lost_bands import pair_tells
from sightline.products.band_fit import BandFit
from sightline.products.image_map import MAP_TOLERANCE
from sightline.products.register_bands import MASK_SHARE
from sightline.products.resample import BAND, TAPS
from sightline.version import VERSION

#: Less of a band with a value than this is worth a warning, and more of it beyond the range of its type.
MOST, MOST_CLIPPED = 0.5, 0.05


def summarize_registration(
    acquisition: Acquisition,
    registration: Registration,
    recovered: Recovered,
    written: Written,
    before: Sequence[BandFit],
    after: Sequence[BandFit],
) -> dict[str, Any]:
    """The content of ``summary.json`` but for the wall time.

    Parameters
    ----------
    acquisition, registration, recovered, written
        What was registered, how, by which result, into what.
    before, after : sequence of BandFit
        Of the same pairs.

    Returns
    -------
    dict
        px and shares.
    """
    names = acquisition.names
    measured = _measured(recovered.summary)
    still = "cameras" if acquisition.still else "matches"
    bands = [
        {
            "name": name,
            "valid_share": share,
            "type": kind,
            "placed_by": still if measured is None else "matches" if name in measured else "motion",
        }
        for name, share, kind in zip(names, written.valid, written.dtypes, strict=True)
    ]
    pairs = [
        {"images": [names[k] for k in one.images], "before": _fit(one), "after": _fit(other)}
        for one, other in zip(before, after, strict=True)
    ]
    return {
        "name": acquisition.name,
        "result": "Registration",
        "version": VERSION,
        "onto": names[registration.reference],
        "shape": list(registration.after[registration.reference].shape),
        "files": list(written.files),
        "bands": bands,
        "pairs": pairs,
        "kernel": {"taps": TAPS, "band": BAND, "mask_share": MASK_SHARE, "map_tolerance_px": MAP_TOLERANCE},
        "motion": {key: recovered.summary.get(key) for key in ("name", "version", "reference_image")},
        "inputs": acquisition.input_hashes(),
        "warnings": [
            *_clipped(bands, written.clipped),
            *_warnings(bands, pairs, _compared(recovered.summary)),
        ],
        "peak_memory_bytes": peak_memory(),
    }


def _measured(summary: Mapping[str, Any]) -> set[str] | None:
    """Names of the bands that `recover` matched with another; None where its summary does not say."""
    if summary.get("control"):
        return set(summary["images"])  # its control points are matches with a reference
    pairs = summary.get("pairs")
    if not isinstance(pairs, list):
        return None
    return {name for pair in pairs if pair_tells(pair["kept"], pair["tried"]) for name in pair["images"]}


def _compared(summary: Mapping[str, Any]) -> set[str]:
    """Names of the bands of which `recover` compared windows with another, whether they matched or not."""
    pairs = summary.get("pairs")
    return {name for pair in pairs if pair["tried"] for name in pair["images"]} if pairs else set()


def _fit(fit: BandFit) -> dict[str, Any]:
    """Along lines (first) and columns."""
    return {
        "rms_px": list(fit.rms_px),
        "noise_px": list(fit.noise_px),
        "mean_px": list(fit.mean_px),
        "windows": fit.tried,
        "kept": len(fit.points),
    }


def _clipped(bands: Sequence[dict[str, Any]], shares: Sequence[float]) -> list[str]:
    """Bands whose type does not hold their values: resampling alone goes a little beyond full ones."""
    return [
        f"{100.0 * share:.0f} % of {band['name']} is beyond the range of {band['type']} and stays at its "
        "end; leave --type out, or give float32"
        for band, share in zip(bands, shares, strict=True)
        if share > MOST_CLIPPED
    ]


def _warnings(
    bands: Sequence[dict[str, Any]], pairs: Sequence[dict[str, Any]], compared: set[str]
) -> list[str]:
    """What a user should know before using the images."""
    out = [
        f"only {100 * band['valid_share']:.0f} % of {band['name']} has a value on this grid: it saw little "
        "of the same ground, or was masked"
        for band in bands
        if band["valid_share"] < MOST
    ]
    out += [
        f"{band['name']} is placed by its camera and the recovered motion alone: "
        + (
            "`recover` kept next to none of its windows, so nothing measured its place, and it may lie many "
            "pixels off; see the warnings of `recover`"
            if band["name"] in compared
            else "no window of it was compared for that, so that no match tells its offset, rotation and "
            "scale; how far it lies off is in `pairs`"
        )
        for band in bands
        if band["placed_by"] == "motion"
    ]
    for pair in pairs:
        rms, noise = np.array(pair["after"]["rms_px"]), np.array(pair["after"]["noise_px"])
        label = " - ".join(pair["images"])
        if not np.isfinite(rms).all():
            out.append(
                f"{label}: {pair['after']['kept']} of {pair['after']['windows']} windows match: too few to "
                "say how well they fit"
            )
        elif np.hypot(*rms) > 0.1 and np.hypot(*rms) > 2.0 * np.hypot(*noise):
            out.append(
                f"{label} still are {np.hypot(*rms):.2f} px apart (rms), where matches are good to "
                f"{np.hypot(*noise):.2f} px: the motion is not of this strip, or the ground is not known"
            )
    return out
