"""A batch → ``results.csv``, ``results.parquet`` and ``summary.json``, from what its inputs' commands wrote.

Not here: the page for people (``report/batch_page.py``).
"""

from __future__ import annotations

import csv
import json
import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.access import read_json
from sightline.applications.batch import Batch, JobOutcome
from sightline.errors import InputError, SightlineError
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.io.acquisition.load import load_acquisition
from sightline.io.config import read_toml
from sightline.io.formats.footprints import rings_of
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.version import VERSION
from sightline.writing import naming_file, whole

#: Every file that ``batch`` leaves beside the folders of its inputs.
BATCH_FILES = ("report.html", "results.csv", "results.parquet", "summary.json")
#: Columns of ``results.csv`` before the figures, with their units.
COLUMNS = {
    "name": "", "file": "", "command": "", "state": "", "status": "1", "message": "", "kept": "1",
    "wall_seconds": "s", "cpu_seconds": "s", "peak_memory_bytes": "B", "worker": "", "warnings": "1",
}  # fmt: skip
#: Figures of any command, with their units; of a command that has no such figure the cell is empty.
FIGURES = {
    "images": "1", "lines": "1", "points": "1", "matches_tried": "1", "matches_kept": "1",
    "residual_rms_px": "px", "rms_motion_roll_px": "px", "rms_motion_pitch_px": "px",
    "rms_motion_yaw_px": "px", "sigma_roll_px": "px", "sigma_pitch_px": "px", "sigma_yaw_px": "px",
    "observed_share": "1", "withheld_nees": "1", "withheld_coverage": "1", "weakest_sigma": "rad",
    "sigma_x": "m", "sigma_y": "m", "sigma_z": "m", "sigma_roll": "rad", "sigma_pitch": "rad",
    "sigma_yaw": "rad", "columns": "1", "signals": "1", "snr": "1", "certified_loss": "1",
}  # fmt: skip
_AXES = ("roll", "pitch", "yaw")


def figures_of(summary: Mapping[str, Any]) -> dict[str, float | None]:
    """The main numbers of one result, by the names of `FIGURES`; None of one that is not finite."""
    found = _FIGURES_OF.get(summary["result"], dict)(summary) if "result" in summary else {}
    return {
        name: float(found[name]) if found[name] is not None and math.isfinite(found[name]) else None
        for name in FIGURES
        if name in found
    }


def _of_motion(summary: Any) -> dict[str, Any]:
    """Of ``recover``."""
    moved, known, matches = summary["rms_motion_px"], summary["rms_sigma_px"], summary["matches"]
    return {
        "images": len(summary["images"]),
        "lines": summary["lines"],
        "matches_tried": matches["tried"],
        "matches_kept": matches["kept"],
        "residual_rms_px": summary["residual_rms_px"],
        **{f"rms_motion_{axis}_px": moved[axis] for axis in _AXES},
        **{f"sigma_{axis}_px": known[axis] for axis in _AXES},
        "observed_share": summary["observed_share"],
        "withheld_nees": _mean(summary["withheld"], "nees"),
        "withheld_coverage": _mean(summary["withheld"], "coverage"),
    }


def _mean(parts: Sequence[Mapping[str, Any]], key: str) -> float | None:
    """Mean over all windows of all pairs; None without any."""
    counts = [(part["count"], part[key]) for part in parts if part[key] is not None]
    total = sum(count for count, _ in counts)
    return sum(count * value for count, value in counts) / total if total else None


def _weakest(summary: Any) -> float | None:
    """Sigma of the combination of angles that is known worst."""
    return max(
        (one["sigma"] for one in summary["principal_sigmas"] if one["sigma"] is not None), default=None
    )


def _of_orientation(summary: Any) -> dict[str, Any]:
    """Of ``orient``."""
    matches = summary["matches"]
    return {
        "images": summary["images"],
        "points": summary["points"],
        "matches_tried": matches["tried"],
        "matches_kept": matches["kept"],
        "residual_rms_px": matches["rms_px"],
        "weakest_sigma": _weakest(summary),
    }


def _of_prediction(summary: Any) -> dict[str, Any]:
    """Of ``orient --predict``."""
    return {"points": summary["points"], "weakest_sigma": _weakest(summary)}


def _of_poses(summary: Any) -> dict[str, Any]:
    """Of ``georeference``."""
    seen = summary["sightings"]
    return {
        "images": summary["frames"],
        "points": summary["points"],
        "matches_tried": seen["tried"],
        "matches_kept": seen["kept"],
        "residual_rms_px": seen["rms_px"],
        **{name: sigma["median"] for name, sigma in summary["sigmas"].items()},
    }


def _of_choice(summary: Any) -> dict[str, Any]:
    """Of ``tdi``."""
    return {
        "columns": summary["columns"],
        "signals": summary["signals"],
        "snr": summary["snr"]["mean"],
        "certified_loss": summary["table"].get("certified_loss"),
    }


_FIGURES_OF = {
    "LineOfSight": _of_motion, "FrameAttitude": _of_motion, "SpinAttitude": _of_motion,
    "StereoOrientation": _of_orientation, "StereoPrediction": _of_prediction,
    "SequencePoses": _of_poses, "TdiResult": _of_choice,
}  # fmt: skip


#: Points on each side of an outline.
_PER_SIDE = 8


def outline_of(command: str, file: Path, folder: Path) -> list[list[list[float]]]:
    """Rings of [longitude, latitude] (degrees) round the ground that an input saw; empty where none is known.

    Of a strip that of its first band, by the cameras as given; of a flight the box round its footprints.
    """
    try:
        if command == "recover":
            return _of_strip(file)
        if command == "georeference" and (folder / "footprints.geojson").is_file():
            return _of_flight(folder / "footprints.geojson")
    except (SightlineError, KeyError, TypeError, ValueError):  # the result is none the worse for it
        pass
    return []


def _of_strip(file: Path) -> list[list[list[float]]]:
    if read_toml(file).get("platform", {}).get("kind") == "level-flight":
        return []
    acquired = load_acquisition(file)
    surface: Any = acquired.surface
    radii = (
        surface.radii if hasattr(surface, "radii") else (getattr(surface, "a", 0), getattr(surface, "b", 0))
    )
    on_earth = all(abs(r / e - 1.0) < 1e-3 for r, e in zip(radii, WGS84, strict=True))
    if acquired.world != "earth-fixed" or not on_earth or not acquired.bands:
        return []
    camera = acquired.bands[0].camera
    part = np.arange(_PER_SIDE) / _PER_SIDE
    last = np.array([camera.lines - 1.0, camera.columns - 1.0])
    top = np.column_stack([0.0 * part, part * last[1]])
    right = np.column_stack([part * last[0], np.full(_PER_SIDE, last[1])])
    edge = np.concatenate([top, right, last - top, last - right])
    ground = camera.locate(edge, surface)
    if not np.isfinite(ground).all():
        return []
    return rings_of(np.degrees(to_geodetic(ground)[:, :2]))


def _of_flight(path: Path) -> list[list[list[float]]]:
    features = read_json(path, "footprints")["features"]
    parts = [feature["geometry"]["coordinates"] for feature in features]
    lonlat = np.concatenate([np.reshape(_flat(part), (-1, 2)) for part in parts])
    (west, south), (east, north) = lonlat.min(axis=0), lonlat.max(axis=0)
    if east - west > 180.0:  # on both sides of 180 degrees: no box
        return []
    return rings_of(np.array([[west, south], [east, south], [east, north], [west, north]]))


def _flat(value: Any) -> list[float]:
    return [number for item in value for number in _flat(item)] if isinstance(value, list) else [value]


def batch_columns(outcomes: Sequence[JobOutcome]) -> dict[str, list[Any]]:
    """``results.csv``: a row for each input; None where there is no such figure."""
    found: dict[str, list[Any]] = {name: [getattr(one, name) for one in outcomes] for name in COLUMNS}
    found["kept"] = [int(one.kept) for one in outcomes]
    return found | {name: [one.figures.get(name) for one in outcomes] for name in FIGURES}


def write_batch(
    folder: Path, result: Batch, inputs: Mapping[str, str], *, wall_seconds: float
) -> dict[str, Any]:
    """Write both tables and ``summary.json``; gives the summary.

    Parameters
    ----------
    folder : Path
        Exists.
    result : Batch
    inputs : dict of str to str
        SHA-256 of each file that was given, by its name as it was given.
    wall_seconds : float
        s; of the whole command.
    """
    columns = batch_columns(result.outcomes)
    with (
        whole(folder / "results.csv") as draft,
        draft.open("w", newline="", encoding="utf-8", errors="backslashreplace") as stream,
    ):
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            table.writerow(["" if value is None else _cell(value) for value in row])
    if has_parquet():
        outlines = [one.outline for one in result.outcomes]
        _write_parquet(folder / "results.parquet", columns, outlines)
    summary = summarize_batch(result, inputs, wall_seconds=wall_seconds)
    write_json(folder / "summary.json", summary)
    return summary


def _cell(value: Any) -> Any:
    return f"{value:.10g}" if isinstance(value, float) else value


def has_parquet() -> bool:
    """Whether the library that writes Parquet is there (extra `catalog`)."""
    from importlib.util import find_spec

    return find_spec("pyarrow") is not None


def _write_parquet(
    path: Path, columns: Mapping[str, Sequence[Any]], outlines: Sequence[list[list[list[float]]]]
) -> None:
    """The same table as GeoParquet 1.1: numbers as numbers, units in the metadata of columns, outlines.

    https://geoparquet.org/releases/v1.1.0: longitude and latitude where no reference system is named.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(
            f"{path.name} needs the package pyarrow, which cannot be loaded ({error}); run "
            "`pip install pyarrow`, or uninstall it: results.csv holds the same"
        ) from error
    whole_numbers = {"status", "warnings", "peak_memory_bytes"}
    fields, arrays = [], []
    for name, values in columns.items():
        unit = (COLUMNS | FIGURES)[name]
        kind = pyarrow.string() if not unit else pyarrow.float64()
        kind = pyarrow.int64() if name in whole_numbers else pyarrow.bool_() if name == "kept" else kind
        shown = [_text(value) for value in values] if not unit else list(values)
        fields.append(pyarrow.field(name, kind, metadata={"unit": unit} if unit else None))
        arrays.append(pyarrow.array([bool(v) for v in shown] if name == "kept" else shown, kind))
    fields.append(pyarrow.field("geometry", pyarrow.binary()))
    arrays.append(pyarrow.array([_wkb(rings) for rings in outlines], pyarrow.binary()))
    kinds = sorted({"Polygon" if len(rings) == 1 else "MultiPolygon" for rings in outlines if rings})
    geometry = {"geometry": {"encoding": "WKB", "geometry_types": kinds}}
    geo = json.dumps({"version": "1.1.0", "primary_column": "geometry", "columns": geometry})
    with whole(path) as draft, naming_file(path):
        parquet.write_table(
            pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields, {"geo": geo})), draft
        )


def _wkb(rings: Sequence[Sequence[Sequence[float]]]) -> bytes | None:
    """A polygon of each ring, as well-known binary (OGC 06-103r4, 8.2): little endian; None without any."""
    polygons = [
        struct.pack("<BIII", 1, 3, 1, len(ring)) + b"".join(struct.pack("<dd", *point) for point in ring)
        for ring in rings
    ]
    if len(polygons) < 2:
        return polygons[0] if polygons else None
    return struct.pack("<BII", 1, 6, len(polygons)) + b"".join(polygons)


def _text(value: str) -> str:
    """As UTF-8 can hold it: names of files are bytes."""
    return value.encode(errors="backslashreplace").decode()


def summarize_batch(result: Batch, inputs: Mapping[str, str], *, wall_seconds: float) -> dict[str, Any]:
    """The content of ``summary.json``."""
    outcomes = result.outcomes
    return {
        "name": result.name,
        "result": "Batch",
        "version": VERSION,
        "done": len(outcomes) - len(result.failed),
        "failed": len(result.failed),
        "jobs": [
            {
                "name": one.name,
                "file": one.file,
                "command": one.command,
                "state": one.state,
                "status": one.status,
                "message": one.message,
                "warnings": one.warnings,
                "wall_seconds": one.wall_seconds,
                "peak_memory_bytes": one.peak_memory_bytes,
                "figures": one.figures,
            }
            for one in outcomes
        ],
        "warnings": [],
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": dict(inputs),
    }
