"""Attitude errors of cameras, and their bound: `orient`, `orient --predict`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.access import read_text
from sightline.applications.stereo_orientation import StereoOrientation
from sightline.applications.stereo_prediction import MOST_TABLED, Improvement, StereoPrediction, improvements
from sightline.errors import FormatError, InputError, SightlineError, foreign_errors
from sightline.evaluation.direction_words import AXES, angle_names
from sightline.geometry.earth import WGS84, to_geodetic
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.geometry.units import ARCSEC
from sightline.io.formats.footprints import feature_of, ground_outlines
from sightline.io.formats.tables import read_columns
from sightline.io.names import file_stems
from sightline.io.results.catalog import strip_features
from sightline.io.results.exports import OF_PLACE, Exported
from sightline.io.results.stereo import ORIENTATION, write_stereo_result
from sightline.io.results.stereo_exports import corrections, write_exports
from sightline.io.results.stereo_predicted import write_prediction
from sightline.io.stereo.load import Stereo, read_stereo
from sightline.io.stereo.plan import PlannedPass
from sightline.io.stereo.strips import StripProblem
from sightline.io.stereo.tables import StereoPoseTable
from sightline.kinds.kind import (
    MODEL_FILES,
    REPORT,
    SUMMARY,
    Columns,
    OpenedFolder,
    ResultKind,
    Tell,
    columns_of,
    given,
    warned,
)
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.report.stereo_page import stereo_page
from sightline.report.stereo_prediction_page import prediction_page
from sightline.result import source_of

Array = NDArray[np.float64]


class Orientation(ResultKind):
    """`StereoOrientation`."""

    types: tuple[type[Any], ...] = (StereoOrientation,)
    table, index = "orientation", ("camera",)
    files: tuple[str, ...] = (
        "orientation.csv", "covariance.csv", "matches_used.csv", "points.csv", "cameras_corrected.csv",
        "attitude_*.csv", "attitude_*.aem", "colmap/*", SUMMARY, REPORT,
    )  # fmt: skip
    units = {
        **dict.fromkeys(AXES, "rad"), **dict.fromkeys(("residual_px",), "px"), "t": "s",
        **dict.fromkeys(("x", "y", "z", "height", "height_before"), "m"),
    }  # fmt: skip

    def facts(self, result: StereoOrientation) -> Mapping[str, str]:
        """Cameras, method, the angles."""
        said = {
            "cameras": f"{len(result.cameras)} ({', '.join(result.cameras[:4])})",
            "method": result.method,
        }
        for name, angles, sigma in list(zip(result.cameras, result.angles, result.sigma, strict=True))[:2]:
            triple = zip(AXES, angles / ARCSEC, sigma / ARCSEC, strict=True)
            words = ", ".join(f"{axis} {value:+.3g} ± {size:.2g}" for axis, value, size in triple)
            said[f"camera {name}"] = f"{words} arcsec"
        return {**said, **warned(result)}

    def columns(self, result: StereoOrientation) -> Columns:
        """``orientation.csv``."""
        values = [np.array(result.cameras, dtype=object), *result.angles.T, *result.sigma.T]
        return dict(zip(ORIENTATION, values, strict=True))

    def numbers(self, result: Any, name: str) -> dict[str, NDArray[Any]]:
        """``covariance.csv`` has its names in a comment."""
        if name != "covariance":
            return super().numbers(result, name)
        names = angle_names(result.cameras)
        return {key: column for key, column in zip(names, result.covariance.T, strict=True)}

    def unit(self, column: str, table: str) -> str:
        """As named; of the angles of cameras, such as ``roll_1``, rad, of their covariance rad^2."""
        if table == "covariance":
            return "rad2"
        return "rad" if column.partition("_")[0] in AXES else super().unit(column, table)

    def variables(self, result: Any) -> Mapping[str, Any]:
        """The covariance of all angles."""
        return {"covariance": (("angle", "angle_too"), result.covariance, "rad2")}

    def exported(self, result: StereoOrientation, acquisition: Any) -> Exported:
        """What the images cover, by their corrected attitudes; `acquisition` is the STEREO.toml."""
        opened = result.origin if isinstance(result.origin, OpenedFolder) else None
        if acquisition is None and opened is not None:
            raise InputError(
                "what `orient` found holds no camera (attitudes for other programs are in its own folder): "
                "add --acquisition FILE, the STEREO.toml of it"
            )
        stereo = stereo_of(result) if acquisition is None else read_stereo(Path(acquisition))
        problem = stereo.problem
        if problem.cameras != tuple(result.cameras):
            raise InputError(
                f"{stereo.path}: its cameras are {', '.join(problem.cameras)}, those of the result "
                f"{', '.join(result.cameras)}; give the file that it was found from"
            )
        if not np.isfinite(result.angles).all():
            raise InputError("some angles of the result are not observable: no attitude says what is covered")
        images = problem.images
        return Exported(
            stereo.name, images.t, images.world_from_body.as_quat(), None, problem.epoch, None,
            footprints=_outlines(stereo, result), radii=(stereo.another_body and problem.radii) or WGS84,
            folder=None if opened is None else opened.folder,
            files=() if opened is None else tuple(opened.names), only=OF_PLACE,
        )  # fmt: skip

    def left(self, folder: Path, summary: dict[str, Any]) -> list[str]:
        """The tables, the model, attitudes of the cameras that the summary names."""
        stems = file_stems([str(name) for name in summary["angles"]]) if "angles" in summary else []
        attitudes = [f"attitude_{stem}.{kind}" for stem in stems for kind in ("csv", "aem")]
        return [*super().left(folder, summary), *MODEL_FILES, *attitudes]

    def render(self, result: StereoOrientation, folder: Path, tell: Tell, begun: float) -> dict[str, Any]:
        """Every file, and what would better the angles."""
        stereo = stereo_of(result)
        tell("what would improve it")
        better = improvements_of(stereo.problem, result.method)
        tell("writing")
        notes = write_exports(folder, stereo, result)
        seconds = time.perf_counter() - begun
        summary = write_stereo_result(
            folder, stereo, result, better, wall_seconds=seconds, export_notes=list(notes)
        )
        stereo_page(stereo, result, summary).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """Angles with their covariance, drifts, points."""
        cameras, angles, _ = _orientation(folder / "orientation.csv")
        advice = "run `sightline orient` again"
        with foreign_errors(folder / SUMMARY, "is no summary of `orient`", advice):
            drift = summary["drift"]
            rates = None if drift is None else [drift[name] for name in cameras]
            found = {
                "method": str(summary["method"]),
                "unchecked": summary["matches"]["unchecked"],
                "cost": summary["cost"],
                "degrees_of_freedom": summary["degrees_of_freedom"],
                "iterations": summary["iterations"],
                "solve_seconds": summary["solve_seconds"],
                "warnings": tuple(summary["warnings"]),
                "bias": None
                if summary["bias_removed"] is None
                else np.array(summary["bias_removed"], dtype=float),
                "drift": None if rates is None else _per_camera(rates, ""),
                "drift_sigma": None if rates is None else _per_camera(rates, "sigma_"),
            }
        points = read_columns(folder / "points.csv", ("x", "y", "z"), infinite=("x", "y", "z"))
        return {
            **found,
            "cameras": cameras,
            "angles": angles,
            "covariance": _covariance(folder / "covariance.csv", len(cameras)),
            "points": np.column_stack([np.asarray(points[axis], dtype=np.float64) for axis in "xyz"]),
        }

    def draw(self, result: Any, axes: Sequence[Any]) -> None:
        """Angles with 1 sigma, arcsec."""
        found = self.numbers(result, self.table)
        place = np.arange(len(found["camera"]))
        for k, axis in enumerate(AXES):
            value, sigma = found[axis] / ARCSEC, found[f"sigma_{axis}"] / ARCSEC
            seen = np.isfinite(sigma)
            shown = np.where(np.isfinite(value), value, 0.0)
            at = (place + 0.2 * (k - 1))[seen]
            axes[0].errorbar(at, shown[seen], sigma[seen], fmt="o", capsize=3, label=axis)
        axes[0].set_xticks(place, [f"camera {name}" for name in found["camera"]])
        axes[0].set_ylabel("angle ± 1 sigma (arcsec)")
        axes[0].legend()


class Prediction(Orientation):
    """`StereoPrediction`."""

    types = (StereoPrediction,)
    files = ("orientation.csv", "covariance.csv", "tables.csv", SUMMARY, REPORT)

    def facts(self, result: Any) -> Mapping[str, str]:
        """Cameras, method, the bounds."""
        said = {
            "cameras": f"{len(result.cameras)} ({', '.join(result.cameras[:4])})",
            "method": result.method,
        }
        for name, sigma in list(zip(result.cameras, result.sigmas, strict=True))[:2]:
            words = ", ".join(f"{axis} ± {s / ARCSEC:.3g}" for axis, s in zip(AXES, sigma, strict=True))
            said[f"camera {name}"] = f"{words} arcsec"
        return said

    def columns(self, result: Any) -> Columns:
        """``orientation.csv``, without angles."""
        values = [
            np.array(result.cameras, dtype=object),
            *np.full((3, len(result.cameras)), np.nan),
            *result.sigmas.T,
        ]
        return dict(zip(ORIENTATION, values, strict=True))

    def render(self, result: Any, folder: Path, tell: Tell, begun: float) -> dict[str, Any]:
        """Every file."""
        values = given(result)
        tell("writing")
        problem: Stereo | PlannedPass
        if "plan" in values:
            source = source_of(values["plan"])
            problem = (
                source if isinstance(source, PlannedPass) else _Unsaved(Path(), "prediction", values["plan"])
            )
        else:
            problem = stereo_of(result)
        summary = write_prediction(folder, problem, result, wall_seconds=time.perf_counter() - begun)
        prediction_page(result, summary).write(folder / REPORT)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The bounds."""
        cameras, _, _ = _orientation(folder / "orientation.csv")
        with foreign_errors(folder / SUMMARY, "is no summary of `orient --predict`", "run it again"):
            return {
                "method": str(summary["method"]),
                "cameras": cameras,
                "covariance": _covariance(folder / "covariance.csv", len(cameras)),
                "points": summary["points"],
                "shots": summary["shots"],
                "sightings": summary["sightings"],
                "baseline": summary["baseline"],
                "window": summary["window_seconds"],
                "how": summary["points_from"],
            }


class _Unsaved(PlannedPass):
    """A plan that is in no file."""

    def input_hashes(self) -> dict[str, str]:
        """None."""
        return {}


def _outlines(stereo: Stereo, result: StereoOrientation) -> tuple[dict[str, Any], ...]:
    """GeoJSON features of what each image shows by its corrected attitude; none in a flat world."""
    problem = stereo.problem
    if problem.radii is None:
        return ()
    radii = problem.radii
    if isinstance(problem, StripProblem):
        return tuple(
            strip_features(dict(zip(problem.cameras, problem.strips, strict=True)), stereo.surface, radii)
        )
    images = problem.images
    turned = images.world_from_body * corrections(problem, result)
    out: list[dict[str, Any]] = []
    for number, name in enumerate(problem.cameras):
        rows = np.flatnonzero(images.camera == number)
        ground = ground_outlines(
            problem.detectors[number],
            problem.mounts[number],
            images.position[rows],
            turned[rows],
            stereo.surface,
        )
        for row, outline in zip(rows.tolist(), ground, strict=True):
            shot = float(problem.shot_names[images.shot[row]])
            said = {"camera": name, "shot": shot, "t": float(images.t[row])}
            if np.isfinite(outline).all():
                out.append(feature_of(np.degrees(to_geodetic(outline, radii)[:, :2]), said))
    return tuple(out)


def stereo_of(result: Any) -> Stereo:
    """What a result was found from: the file that was loaded, or what the call was given."""
    values = given(result)
    problem = values["problem"] if "problem" in values else _strip_problem(values, result)
    source = source_of(values.get("problem", values.get("tracks")))
    if isinstance(source, Stereo):
        return source
    images = problem.images
    names = np.asarray(problem.shot_names, dtype=np.float64)
    poses = StereoPoseTable(
        problem.cameras, images.camera, images.shot, names, images.t, images.position,
        images.world_from_body.as_quat(),
    )  # fmt: skip
    return Stereo(
        path=Path("stereo.toml"),
        name="orientation",
        problem=problem,
        surface=Plane(0.0) if problem.radii is None else Ellipsoid(*problem.radii),
        world="local" if problem.radii is None else "earth-fixed",
        another_body=False,
        poses=poses,
        pairs=None,
        pictures=None,
        inputs=(),
    )


def _strip_problem(values: Mapping[str, Any], result: StereoOrientation) -> StereoProblem:
    """What `orient_pushbroom` was given, as a problem."""
    source = source_of(values["tracks"])
    if isinstance(source, Stereo):
        return source.problem
    raise InputError(
        "an orientation of strips is written with what its file says besides: name the strips in a "
        "STEREO.toml ([[strip]]) and give what load_stereo reads of it"
    )


def improvements_of(problem: StereoProblem, method: str) -> tuple[Improvement, ...]:
    """What would better the angles of frames, by the bound; none for strips and very many sightings."""
    if isinstance(problem, StripProblem) or len(problem.tracks) > MOST_TABLED:
        return ()
    try:
        return improvements(problem, method)
    except SightlineError:  # the orientation stands without advice
        return ()


def _orientation(path: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Names, angles and sigmas of ``orientation.csv``; not observable ones are NaN and infinite."""
    table = columns_of(path.read_text(encoding="utf-8"), path)
    if set(ORIENTATION) - set(table):
        raise FormatError(
            f"{path}: columns {', '.join(ORIENTATION)} are expected; run `sightline orient` again"
        )
    with foreign_errors(path, "is no table of angles", "run `sightline orient` again"):
        angles, sigma = (
            np.column_stack([np.asarray(table[f"{head}{axis}"], dtype=np.float64) for axis in AXES])
            for head in ("", "sigma_")
        )
    return tuple(str(name) for name in table["camera"]), angles, sigma


def _covariance(path: Path, cameras: int) -> Array:
    """``covariance.csv``."""
    text = read_text(path, "a covariance", advice="run `sightline orient` again")
    with foreign_errors(path, "is no covariance", "run `sightline orient` again"):
        lines = [line for line in text.splitlines() if line and not line.startswith("#")]
        found = np.array([line.split(",") for line in lines], dtype=np.float64)
    if found.shape != (3 * cameras, 3 * cameras):
        raise FormatError(
            f"{path}: {found.shape} numbers for {cameras} cameras; run `sightline orient` again"
        )
    return found


def _per_camera(rates: Sequence[Mapping[str, Any]], head: str) -> Array:
    """(C, 3) of a summary's entries by axis; NaN where null."""
    return np.array([[entry[f"{head}{axis}"] for axis in AXES] for entry in rates], dtype=np.float64)
