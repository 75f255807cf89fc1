"""Poses of a flight and the maps of its bands: `georeference`."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sightline.applications.frame_cube import CubeSummary
from sightline.applications.rig_bands import registered_bands
from sightline.applications.sequence_poses import SequencePoses
from sightline.errors import FormatError, InputError, SightlineError, foreign_errors
from sightline.io.acquisition.schema import WorldSection
from sightline.io.formats.tables import read_columns
from sightline.io.results.cube_files import CubeFolder
from sightline.io.results.cube_summary import cube_summary, earlier_cube, remove_cube, write_cube
from sightline.io.results.exports import Exported
from sightline.io.results.line_of_sight import write_json
from sightline.io.results.poses import POSES, SIGMAS, in_table_axes, read_pose_covariance
from sightline.io.results.rig import write_registered_capture
from sightline.io.results.sequence import write_sequence_result
from sightline.io.results.sequence_exports import frame_features
from sightline.io.sequence.load import FrameSequence
from sightline.io.sequence.schema import CubeSection
from sightline.kinds.kind import (
    MODEL_FILES,
    REPORT,
    SUMMARY,
    Columns,
    OpenedFolder,
    ResultKind,
    Tell,
    given,
    per_axis,
    warned,
)
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.products.cube_plan import choose_bands
from sightline.products.cube_store import MemoryStore
from sightline.report.sequence_cube import cube_view
from sightline.report.sequence_page import sequence_page
from sightline.result import source_of
from sightline.version import VERSION

#: m from the origin beyond which positions are Earth-fixed.
_EARTH_FIXED = 6e6
#: m from it beyond which they are fixed to some body.
_BODY_FIXED = 1e6
FOOTPRINTS = "footprints.geojson"
_CUBE_FILES = ("bands/*", "cube.tif", "cube.dat", "cube.hdr", "cube.nc", "cube.zarr/*")


class Poses(ResultKind):
    """`SequencePoses`. Maps of the bands are files, made while the poses are written; they are never held."""

    types = (SequencePoses,)
    table, index = "poses", ("frame",)
    files = (
        "poses.csv", "covariance.npz", "frames_used.csv", "colmap/*", "reconstruction.json", "opk.csv",
        "ypr.csv", "geo.txt", FOOTPRINTS, "rig.csv", "rig_cameras.json",
        "rig_assignments.json", "registered.tif", *_CUBE_FILES, SUMMARY,
        REPORT,
    )  # fmt: skip
    units = {
        "t": "s", **dict.fromkeys("xyz", "m"), **dict.fromkeys(("roll", "pitch", "yaw"), "rad"),
        "residual_px": "px", "parallax": "rad", **dict.fromkeys(("omega", "phi", "kappa"), "degrees"),
        **dict.fromkeys(("ypr:yaw", "ypr:pitch", "ypr:roll"), "degrees"),
    }  # fmt: skip
    options = ("maps",)

    def facts(self, result: SequencePoses) -> Mapping[str, str]:
        """Frames by source, how well poses are known."""
        sigma = self._sigmas(result)
        middle = np.median(sigma, axis=0)
        counts = {word: result.source.count(word) for word in dict.fromkeys(result.source)}
        sources = ", ".join(f"{count} {word}" for word, count in counts.items())
        return {
            "frames": f"{len(result.source)} ({sources})",
            "sigma of places": f"{per_axis(middle[:3], names='xyz')} m",
            "of angles": f"{per_axis(np.degrees(middle[3:]))} degrees",
            **warned(result),
        }

    def _sigmas(self, result: SequencePoses) -> np.ndarray[Any, Any]:
        if isinstance(result.origin, OpenedFolder):
            found = self.numbers(result, self.table)
            return np.column_stack([np.asarray(found[name], dtype=np.float64) for name in SIGMAS])
        return np.sqrt(np.einsum("mii->mi", result.poses.covariance))

    def columns(self, result: SequencePoses) -> Columns:
        """``poses.csv``."""
        sequence = sequence_of(result)
        problem, poses = sequence.problem, result.poses
        position, attitude, covariance = in_table_axes(
            sequence.world, problem.radii, poses.position, poses.world_from_body, poses.covariance
        )
        sigma = np.sqrt(np.einsum("mii->mi", covariance))
        values = [
            np.array(problem.frames, dtype=object), problem.t, *position.T, *attitude.as_quat().T, *sigma.T,
            np.array(result.source, dtype=object),
        ]  # fmt: skip
        return dict(zip(POSES, values, strict=True))

    def variables(self, result: SequencePoses) -> Mapping[str, Any]:
        """The covariance of each pose."""
        if isinstance(result.origin, OpenedFolder):
            covariance = result.covariance
        else:
            sequence, poses = sequence_of(result), result.poses
            covariance = in_table_axes(
                sequence.world,
                sequence.problem.radii,
                poses.position,
                poses.world_from_body,
                poses.covariance,
            )[2]
        return {"covariance": (("frame", "unknown", "unknown_too"), covariance, "m2, m rad, rad2")}

    def exported(self, result: SequencePoses, acquisition: Any) -> Exported:
        """Poses of all frames that have one, in the axes of ``poses.csv``."""
        if acquisition is not None:
            raise InputError("poses of a flight are exported without an acquisition: leave it out")
        table = self.numbers(result, self.table)
        place, turn = (
            np.column_stack([np.asarray(table[key], dtype=np.float64) for key in keys])
            for keys in (("x", "y", "z"), ("qx", "qy", "qz", "qw"))
        )
        known = np.isfinite(place).all(axis=1) & np.isfinite(turn).all(axis=1)
        summary = self.summary(result)
        least = float(np.linalg.norm(place[known], axis=1).min()) if known.any() else 0.0
        fixed, far = least > _EARTH_FIXED, least > _BODY_FIXED  # far and not fixed: axes of another body
        sigma = np.column_stack([np.asarray(table[key], dtype=np.float64) for key in SIGMAS[3:]])
        return Exported(
            str(summary.get("name", "")), np.asarray(table["t"], dtype=np.float64)[known], turn[known],
            sigma[known], summary.get("epoch"), "ITRF" if fixed else None, place[known],
            flight=True, **({} if far and not fixed else _for_catalogues(result, summary)),
        )  # fmt: skip

    def left(self, folder: Path, summary: dict[str, Any]) -> list[str]:
        """The tables, the models, maps that the summary lists."""
        tables = [name for name in self.files if "*" not in name and not name.startswith("cube.")]
        return [*tables, *MODEL_FILES, *earlier_cube(folder, summary.get("cube") or {})]

    def render(
        self,
        result: SequencePoses,
        folder: Path,
        tell: Tell,
        begun: float,
        *,
        maps: bool = True,
        method: str = "all-frames",
    ) -> dict[str, Any]:
        """Every file; `maps` as ``[cube]`` asks for them. Those that cannot be made are a warning."""
        sequence = sequence_of(result)
        more: dict[str, Any] = {"method": method, "cube": None, "registered": None}
        view, spent = None, None
        one = result.rig is not None and len(sequence.problem) == 1
        if one and maps and sequence.cube.make:
            tell("bands laid on the first camera")
            more["registered"] = write_registered_capture(folder, registered_bands(sequence.problem, result))
        elif maps and sequence.cube.make:
            try:
                made, files = write_cube(folder, sequence, result, progress=tell)
                more["cube"], view, spent = cube_summary(made, files), cube_view(made), made.seconds
            except SightlineError as error:
                # the poses took hours and are good: they are not lost with the maps
                remove_cube(folder)
                words = f"no maps of the bands were made: {error}; the poses are written without them"
                result = replace(result, warnings=(*result.warnings, words))
        tell("writing")
        seconds = time.perf_counter() - begun
        summary = write_sequence_result(folder, sequence, result, wall_seconds=seconds, **more)
        sequence_page(sequence.problem, result, summary, cube=view, cube_seconds=spent).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """Where each frame's pose comes from, its covariance; the poses are the result's table."""
        advice = "run `sightline georeference` again"
        words = ("frame", "source", "reason")
        used = read_columns(folder / "frames_used.csv", (*words, "stretch"), text=words)
        poses = read_columns(folder / "poses.csv", POSES, text=("frame", "source"), infinite=SIGMAS)
        covariance = read_pose_covariance(folder / "covariance.npz").covariance
        if not len(used["source"]) == len(poses["source"]) == len(covariance):
            raise FormatError(f"{folder}: its tables have other frames than poses.csv; {advice}")
        with foreign_errors(folder / SUMMARY, "is no summary of `georeference`", advice):
            return {
                "source": tuple(str(word) for word in poses["source"]),
                "reason": tuple(str(word) for word in used["reason"]),
                "stretch": np.asarray(used["stretch"]).astype(np.intp),
                "covariance": covariance,
                # said by the page alone: the same result has the same summary, however long it took
                "seconds": {},
                "taken_over": {},
                "warnings": tuple(summary["warnings"]),
            }

    def draw(self, result: SequencePoses, axes: Sequence[Any]) -> None:
        """The path from above, by source."""
        found = self.numbers(result, self.table)
        x, y = (np.asarray(found[axis], dtype=np.float64) for axis in "xy")
        axes[0].plot(x, y, linewidth=0.6, color="0.6")
        for source in dict.fromkeys(result.source):
            of = np.array([word == source for word in result.source])
            axes[0].plot(x[of], y[of], ".", label=source)
        axes[0].set_aspect("equal", adjustable="datalim")
        axes[0].set_xlabel("x (m)")
        axes[0].set_ylabel("y (m)")
        axes[0].legend()


class Cube(ResultKind):
    """`CubeSummary`.

    The maps are where the `store` of the call put them: of one in memory they can be written, those of an
    opened result are copied from its folder.
    """

    types = (CubeSummary,)
    table, index = "bands", ("name",)
    files = (*_CUBE_FILES, SUMMARY)
    units = {"wavelength_nm": "nm"}

    def left(self, folder: Path, summary: dict[str, Any]) -> list[str]:
        """Maps that the summary lists."""
        return [SUMMARY, *earlier_cube(folder, summary)]

    def facts(self, result: CubeSummary) -> Mapping[str, str]:
        """Bands and the map."""
        said = self.summary(result)
        rows, columns = said["shape"]
        return {
            "bands": str(len(said["bands"])),
            "map": f"{rows} rows x {columns} columns of {said['gsd']:.3g} m",
            "frames": str(said["frames_used"]),
            **warned(result),
        }

    def columns(self, result: CubeSummary) -> Columns:
        """A row per band."""
        bands = self.summary(result)["bands"]
        return {key: [np.nan if band[key] is None else band[key] for band in bands] for key in bands[0]}

    def summarize(self, result: CubeSummary) -> dict[str, Any]:
        """Nothing has to be written for it."""
        return {"result": "CubeSummary", "version": VERSION, **cube_summary(result)}

    def render(self, result: CubeSummary, folder: Path, tell: Tell, begun: float) -> dict[str, Any]:
        """The maps as GeoTIFFs, and the summary."""
        values = given(result)
        store = values.get("store")
        if not isinstance(store, MemoryStore):
            where = "are lost" if store is None else "lie where its `store` left them"
            raise InputError(
                f"the pixels of this cube {where}: give assemble_cube a MemoryStore to write them later, or "
                "write the poses, which makes the maps that [cube] asks for"
            )
        problem: SequenceProblem = values["problem"]
        layout = choose_bands(problem, values.get("plan") or _plan(), np.zeros((0, 0, 2)), 1.0, 1.0)
        if layout.names != result.names:
            layout = replace(layout, names=result.names, wavelength_nm=result.wavelength_nm)
        files = CubeFolder(folder)
        try:
            files.begin(result.grid, layout)
            files.write(0, 0, store.values)
            names = files.finish()
        finally:
            files.discard()
        summary = {"result": "CubeSummary", "version": VERSION, **cube_summary(result, names)}
        write_json(folder / SUMMARY, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """What the summary has in numbers."""
        with foreign_errors(folder / SUMMARY, "is no summary of a cube", "write it again"):
            bands = summary["bands"]

            def of(key: str) -> np.ndarray[Any, Any]:
                return np.array([band[key] for band in bands], dtype=np.float64)

            return {
                "names": tuple(band["name"] for band in bands),
                "wavelength_nm": of("wavelength_nm"),
                "coverage": of("coverage"),
                "passed": of("passed"),
                "beyond": of("beyond"),
                "whole": of("map_share"),
                "seams": of("seams"),
                "seam_jump": of("seam_jump"),
                "surface": summary["surface"],
                "area": summary["area"],
                "frames_used": summary["frames_used"],
                "unread": tuple(summary["unread"]),
                "seconds": {},
                "warnings": tuple(summary["warnings"]),
            }

    def draw(self, result: CubeSummary, axes: Sequence[Any]) -> None:
        """How much of the ground each band covers."""
        axes[0].bar(np.arange(len(result.names)), result.passed)
        axes[0].set_xticks(np.arange(len(result.names)), result.names, rotation=60, ha="right")
        axes[0].set_ylabel("share of the ground passed over (1)")


def _for_catalogues(result: SequencePoses, summary: Mapping[str, Any]) -> dict[str, Any]:
    """What `Exported` holds of a flight besides poses: outlines of the frames, the files, the map."""
    if not isinstance(result.origin, OpenedFolder):
        problem = sequence_of(result).problem
        return {"footprints": tuple(frame_features(problem, result.poses, result.source))}
    place, names = result.origin.folder, result.origin.names
    features = []
    if FOOTPRINTS in names:
        with foreign_errors(place / FOOTPRINTS, "holds no footprints", "run `sightline georeference` again"):
            features = json.loads(result.origin.text(FOOTPRINTS))["features"]
    return {
        "footprints": tuple(features), "folder": place, "files": tuple(names), "cube": summary.get("cube"),
    }  # fmt: skip


def _plan() -> Any:
    from sightline.products.cube_plan import CubePlan

    return CubePlan()


def sequence_of(result: SequencePoses) -> FrameSequence:
    """What the poses were found from: the file that was loaded, or what the call was given."""
    problem = given(result)["problem"]
    source = source_of(problem)
    if isinstance(source, FrameSequence):
        return source
    return FrameSequence(
        path=Path("sequence.toml"),
        name="flight",
        problem=problem,
        world=WorldSection(frame="local" if problem.radii is None else "earth-fixed"),
        cube=CubeSection(make=False),
        files=(),
        inputs=(),
    )
