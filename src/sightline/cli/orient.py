"""``sightline orient``: constant attitude errors of cameras that image one scene together."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite, Workers
from sightline.execution import Progress, Step, no_step, steps_of
from sightline.geometry.units import ARCSEC

if TYPE_CHECKING:
    from sightline.applications.stereo_orientation import StereoOrientation
    from sightline.io.stereo.load import Stereo


_AXES = ("roll", "pitch", "yaw")
#: Files that every orientation is written into.
_WRITES = ("summary.json", "orientation.csv", "covariance.csv", "report.html")
#: What residuals are of the methods that adjust no points.
_RESIDUALS = {"epipolar": "distance from epipolar lines", "plane": "miss on the plane (relief is in it)"}


class OrientMethod(StrEnum):
    """The estimators, best first."""

    ML_TRACK = "ml-track"
    ML_PAIR = "ml-pair"
    EPIPOLAR = "epipolar"
    PLANE = "plane"


def orient(
    file: Annotated[Path, typer.Argument(metavar="STEREO.toml", help="Planned poses, points, noise.")],
    out: Out,
    method: Annotated[
        OrientMethod,
        typer.Option(
            help="ml-track: points seen in all shots are one; ml-pair: new points in every shot; epipolar, "
            "plane: S2's own, linear."
        ),
    ] = OrientMethod.ML_TRACK,
    raw: Annotated[
        bool, typer.Option("--raw", help="Of epipolar: keep the bias of noise times noise.")
    ] = False,
    drift: Annotated[
        bool, typer.Option("--drift", help="Let the errors drift evenly with time about their middle value.")
    ] = False,
    predict: Annotated[
        bool,
        typer.Option(
            "--predict", help="Give the bound of what could be found, before anything is flown or matched."
        ),
    ] = False,
    workers: Workers = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Find the constant attitude errors of cameras from points they see together, with covariance."""
    import time

    from sightline.cli.output import output_folder
    from sightline.cli.terminal import answered, print_json, progress, say
    from sightline.errors import naming
    from sightline.kinds.orientation import Orientation

    begun = time.perf_counter()
    if predict:
        with (
            output_folder(out, overwrite=overwrite, writes=_WRITES) as folder,
            progress() as report,
            naming(file),
        ):
            summary = foretell(file, method, folder, report)
        if as_json:
            print_json(summary)
        else:
            tell_bound(summary)
            say(f"{out / 'orientation.csv'}, {out / 'covariance.csv'}, {out / 'report.html'}")
        return
    with (
        output_folder(out, overwrite=overwrite, writes=_WRITES) as folder,
        progress() as report,
    ):
        with naming(file):
            stereo, found = estimate(file, method, report, raw=raw, drift=drift)
        summary = Orientation().render(found, folder, report, begun)
    if answered(summary, as_json):
        return
    tell(stereo, found, summary)
    say(f"{out / 'orientation.csv'}, {out / 'covariance.csv'}, {out / 'report.html'}")


def estimate(
    file: Path, method: OrientMethod, report: Progress, *, raw: bool, drift: bool
) -> tuple[Stereo, StereoOrientation]:
    """The orientation of a STEREO.toml, and what it was found from."""
    from sightline.applications.expected_cost import orientation_cost
    from sightline.applications.stereo_orientation import orient as solve
    from sightline.applications.stereo_orientation import orient_pushbroom
    from sightline.cli.terminal import announce
    from sightline.errors import InputError
    from sightline.io.stereo.load import read_stereo
    from sightline.io.stereo.strips import StripProblem

    if raw and method is not OrientMethod.EPIPOLAR:
        raise InputError(f"--raw belongs to --method epipolar, here it is {method.value}; leave it out")
    report(f"reading {file}")
    stereo = read_stereo(file)
    announce(orientation_cost(stereo.problem))
    if stereo.pictures is not None:
        step = steps_of(report, f"finding points in {len(stereo.pictures.sources)} pictures")
        stereo = with_points_found(stereo, step)
    problem = stereo.problem
    report(f"solving for {len(problem.cameras)} cameras in {len(problem.images)} images")
    if isinstance(problem, StripProblem):
        if method is not OrientMethod.ML_TRACK or drift:
            raise InputError("[[strip]] is oriented by --method ml-track, without --drift; leave them out")
        result = orient_pushbroom(
            problem.strips, problem.tracks, problem.noise, names=problem.cameras, priors=problem.priors,
            point_names=problem.point_names,
        )  # fmt: skip
    else:
        result = solve(problem, method.value, raw=raw, drift=drift)
    return stereo, result


def with_points_found(stereo: Stereo, step: Step = no_step) -> Stereo:
    """The same with points found in its pictures."""
    from dataclasses import replace

    from sightline.photogrammetry.pair.match_problem import match_problem
    from sightline.result import set_source

    if stereo.pictures is None:
        return stereo
    pictures = stereo.pictures
    found = match_problem(
        stereo.problem,
        pictures.sources,
        image=pictures.image,
        surface=stereo.surface,
        floor_px=pictures.floor_px,
        step=step,
    )
    stereo = replace(stereo, problem=found)
    set_source(found, stereo)
    return stereo


def foretell(file: Path, method: OrientMethod, folder: Path, report: Progress) -> dict[str, Any]:
    """The bound of a STEREO.toml, in files; gives the summary."""
    import time

    from sightline.applications.expected_cost import prediction_cost
    from sightline.applications.stereo_prediction import MOST_TABLED, predict, predict_plan
    from sightline.cli.terminal import announce
    from sightline.errors import InputError
    from sightline.io.stereo.load import read_stereo
    from sightline.io.stereo.plan import has_plan, read_plan
    from sightline.io.stereo.strips import StripProblem
    from sightline.kinds.orientation import Prediction

    begun = time.perf_counter()
    report("bounds")
    if has_plan(file):
        plan = read_plan(file).plan
        announce(prediction_cost(plan.pair.cameras, plan.shots, plan.points))
        tables = plan.pair.cameras * plan.shots * plan.points <= MOST_TABLED
        predicted = predict_plan(plan, method.value, tables=tables)
    else:
        problem = read_stereo(file, planned=True)
        if isinstance(problem.problem, StripProblem):
            raise InputError(
                "--predict is for frames: [[strip]] has no prediction; orient its points instead"
            )
        tables = len(problem.problem.tracks) <= MOST_TABLED
        predicted = predict(problem.problem, method.value, tables=tables)
    return Prediction().render(predicted, folder, report, begun)


def tell_bound(summary: dict[str, Any]) -> None:
    """The prediction in a few lines."""
    from sightline.cli.terminal import say

    for camera, sigma in summary["sigmas"].items():
        values = {axis: f"{size / ARCSEC:.3f}" for axis, size in sigma.items() if math.isfinite(size)}
        say(f"camera {camera}: bound of 1 sigma: {_axes_said(values)}")
    for entry in summary["unobservable"]:
        say(f"not observable: {entry['words']}")
    say(f"points: {summary['points_from']}")


def _axes_said(values: dict[str, str]) -> str:
    """Values (arcsec) of the axes that have one, and the names of the others."""
    given = ", ".join(f"{axis} {value}" for axis, value in values.items())
    hidden = ", ".join(axis for axis in _AXES if axis not in values)
    parts = [f"{given} arcsec" if given else "", f"{hidden} not observable" if hidden else ""]
    return "; ".join(part for part in parts if part)


def tell(stereo: Stereo, found: StereoOrientation, summary: dict[str, Any]) -> None:
    """The orientation in a few lines."""
    from sightline.cli.terminal import say
    from sightline.report.stereo_words import angle_words

    for camera, angles in summary["angles"].items():
        values = {
            axis: f"{angles[axis] / ARCSEC:+.3f} ± {angles[f'sigma_{axis}'] / ARCSEC:.3f}"
            for axis in _AXES
            if math.isfinite(angles[f"sigma_{axis}"])
        }
        say(f"camera {camera}: {_axes_said(values)}")
    _tell_drift_and_focal_length(stereo, found)
    for entry in summary["unobservable"]:
        say(f"not observable: {entry['words']}")
    weakest = next((entry for entry in summary["principal_sigmas"] if math.isfinite(entry["sigma"])), None)
    if weakest is not None:
        say(f"weakest direction that is seen: {weakest['words']}, {angle_words(weakest['sigma'])}")
    matches = summary["matches"]
    what = _RESIDUALS.get(summary["method"], "residual")
    say(
        f"{matches['kept']} of {matches['tried']} {matches['kind']} kept, {what} {matches['rms_px']:.3g} "
        f"px rms; {summary['chi_square']['verdict']}"
    )
    for note in summary["export_notes"]:
        say(note)


def _tell_drift_and_focal_length(stereo: Stereo, found: StereoOrientation) -> None:
    """Rates and focal lengths, where they were sought."""
    from sightline.cli.terminal import say
    from sightline.report.stereo_words import drift_rows, focal_rows

    for camera, *rates in drift_rows(found):
        values = {axis: r for axis, r in zip(_AXES, rates, strict=True) if r != "not observable"}
        say(f"camera {camera}: drift: {_axes_said(values).replace(' arcsec', ' arcsec/s')}")
    for camera, length, _, percent in focal_rows(stereo.problem, found):
        said = length if percent == "not observable" else f"{length} px, {percent} % from that of the file"
        say(f"camera {camera}: focal length {said}")
