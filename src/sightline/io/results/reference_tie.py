"""Control points of a reference → ``control_points.csv``, ``ties.csv``, ``summary.json``.

They are described in ``docs/formats/tie.md``.

Not here: where they come from (``applications/reference_tie.py``), the page (``report/tie_page.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.reference_tie import ReferenceTie
from sightline.io.acquisition.acquired import sha256
from sightline.io.formats.tables import write_columns
from sightline.io.results.line_of_sight import peak_memory
from sightline.version import VERSION

#: Every file that `tie` may leave.
TIE_FILES = (
    "control_points.csv", "ties.csv", "acquisition.toml", "sequence.toml", "stereo.toml", "frames.csv",
    "summary.json", "report.html",
)  # fmt: skip


def control_columns(tie: ReferenceTie) -> dict[str, Any]:
    """``control_points.csv``, as every TOML file takes it."""
    return {
        "x": tie.places[:, 0],
        "y": tie.places[:, 1],
        "z": tie.places[:, 2],
        "sigma": tie.sigma,
        "image": _names(tie),
        "line": tie.pixels[:, 0],
        "column": tie.pixels[:, 1],
        **(
            {"sigma_px": np.full(len(tie.image), tie.control_sigma_px)}
            if tie.lines is None
            else {"lines": tie.lines, **_sigmas(tie), "sigma_ground": tie.ground_sigma}
        ),
    }


def tie_columns(tie: ReferenceTie) -> dict[str, Any]:
    """``ties.csv``: what lies behind each control point, in the same order."""
    return {
        "image": _names(tie),
        "line": tie.pixels[:, 0],
        "column": tie.pixels[:, 1],
        "offset_line": tie.offset_px[:, 0],
        "offset_column": tie.offset_px[:, 1],
        **_sigmas(tie),
    }


def _sigmas(tie: ReferenceTie) -> dict[str, Any]:
    """Of each match, px."""
    return {"sigma_line": tie.match_sigma_px[:, 0], "sigma_column": tie.match_sigma_px[:, 1]}


def _names(tie: ReferenceTie) -> Any:
    return np.array([tie.names[k] for k in tie.image], dtype=np.str_)


def write_tables(folder: Path, tie: ReferenceTie) -> None:
    """Both tables."""
    # a tenth of a millimetre, of metres or of degrees
    places = {"x": "%.9f", "y": "%.9f", "z": "%.4f"} if np.abs(tie.places[:, :2]).max() <= 360.0 else {}
    places = places or dict.fromkeys("xyz", "%.4f")
    write_columns(folder / "control_points.csv", control_columns(tie), places)
    write_columns(folder / "ties.csv", tie_columns(tie))


def summarize_tie(
    tie: ReferenceTie, name: str, reference: str, inputs: Sequence[Path], *, wall_seconds: float | None
) -> dict[str, Any]:
    """The content of ``summary.json``."""
    images = []
    for number, matches in sorted(tie.matches.items()):
        rows = tie.image == number
        counts = matches.matches.counts()
        kept, outside = counts.pop("kept"), counts.pop("outside")
        images.append(
            {
                "name": tie.names[number],
                "points": int(rows.sum()),
                "offset_px": np.nanmedian(tie.offset_px[rows], axis=0).tolist(),
                "strength": matches.common_strength,
                "sigma_px": np.median(tie.match_sigma_px[rows], axis=0).tolist(),
                "windows": {
                    "tried": len(matches.matches) - outside,
                    "kept": kept,
                    "rejected": {key: count for key, count in counts.items() if count},
                },
            }
        )
    return {
        "name": name,
        "result": "ReferenceTie",
        "version": VERSION,
        "reference": reference,
        "points": len(tie.image),
        "control_sigma_px": tie.control_sigma_px,
        "sigma": float(np.median(tie.sigma)),
        "images": images,
        "left_out": {tie.names[k]: text for k, text in tie.left_out.items()},
        "warnings": list(tie.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": {str(path.name): sha256(path) for path in inputs},
    }
