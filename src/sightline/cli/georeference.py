"""``sightline georeference``: pose of every frame of a sequence, and what is made of it."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite, Resume, Workers

if TYPE_CHECKING:
    from sightline.applications.sequence_poses import SequencePoses
    from sightline.io.sequence.load import FrameSequence

_LISTED = 3
_SAID = {
    "sigma_x": 1.0, "sigma_y": 1.0, "sigma_z": 1.0,
    "sigma_roll": 180.0 / math.pi, "sigma_pitch": 180.0 / math.pi, "sigma_yaw": 180.0 / math.pi,
}  # fmt: skip


class SubsetMethod(StrEnum):
    """How frames between those of the subset get their poses."""

    ALL_FRAMES = "all-frames"
    DISPLACEMENT = "displacement"
    SLERP = "slerp"
    SPLINE = "spline"


def georeference(
    file: Annotated[Path, typer.Argument(metavar="SEQUENCE.toml", help="Frames and their rough poses.")],
    out: Out,
    stride: Annotated[
        int | None,
        typer.Option(
            "--stride",
            min=1,
            max=1_000_000,
            help="Subset for photogrammetry and --method: every so many frames, whatever overlap is wanted.",
        ),
    ] = None,
    method: Annotated[
        SubsetMethod,
        typer.Option(
            help="all-frames: every frame adjusted by its own image; for comparison, from the subset alone: "
            "displacement (S4's displacement and yaw), slerp, spline."
        ),
    ] = SubsetMethod.ALL_FRAMES,
    poses_only: Annotated[
        bool, typer.Option("--poses-only", help="Make no maps of the bands, whatever the file asks for.")
    ] = False,
    workers: Workers = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Find the pose of every frame of a sequence, with covariance, and lay all bands on a map."""
    import time

    from sightline.applications.sequence_between import interpolate_between
    from sightline.applications.sequence_poses import georeference_sequence
    from sightline.cli.output import finished_stages, output_folder
    from sightline.cli.terminal import announce, complain, print_json, progress, say
    from sightline.errors import InputError, naming
    from sightline.io.results.cube_summary import check_cube, ready_to_georeference
    from sightline.io.sequence.load import read_sequence
    from sightline.kinds.sequence import Poses

    begun = time.perf_counter()
    with (
        output_folder(
            out, overwrite=overwrite, resume=resume, writes=["summary.json", "poses.csv", "report.html"]
        ) as folder,
        progress() as report,
    ):
        stages = finished_stages(out, refuse=resume and not overwrite)
        report(f"reading {file}")
        sequence = read_sequence(file)
        cost = ready_to_georeference(sequence, maps=not poses_only)
        if cost.lacks_room(out):
            raise InputError(f"{cost.lacks_room(out)}, or --poses-only")
        announce(cost)
        if not poses_only:
            check_cube(sequence)  # maps that cannot be made are refused before hours of work, not after
        with naming(file):
            found = georeference_sequence(sequence.problem, stride=stride, progress=report, stages=stages)
            if method is not SubsetMethod.ALL_FRAMES:
                report(f"frames between the subset's by {method.value}")
                found = interpolate_between(found, method.value)
        summary = Poses().render(found, folder, report, begun, maps=not poses_only, method=method.value)
    made = summary["cube"] is not None or summary["registered"] is not None
    lacking = not made and sequence.cube.make and not poses_only
    if as_json:
        print_json(summary)
        if lacking:
            raise typer.Exit(1)
        return
    for warning in summary["warnings"]:
        complain("warning", warning)
    tell(sequence, found, summary)
    say(f"{out / 'poses.csv'}, {out / 'report.html'}")
    if lacking:  # asked for, and not among what was written
        raise typer.Exit(1)


def tell(sequence: FrameSequence, found: SequencePoses, summary: dict[str, Any]) -> None:
    """The poses in a few lines."""
    from sightline.cli.terminal import say

    counts = ", ".join(f"{count} {word}" for word, count in summary["sources"].items() if count)
    say(f"{sequence.name}: {summary['frames']} frames: {counts}")
    for entry in summary["not_estimated"][:_LISTED]:
        say(f"not estimated: {entry['frame']}: {entry['reason']}")
    if len(summary["not_estimated"]) > _LISTED:
        say(f"not estimated: {len(summary['not_estimated']) - _LISTED} more, see frames_used.csv")
    middle = {name: summary["sigmas"][name]["median"] * unit for name, unit in _SAID.items()}
    say(
        "usual sigma of a pose: x {sigma_x:.3g}, y {sigma_y:.3g}, z {sigma_z:.3g} m; roll {sigma_roll:.2g}, "
        "pitch {sigma_pitch:.2g}, yaw {sigma_yaw:.2g} degrees".format(**middle)
    )
    say(_view_words(sequence, found))
    if summary["focal_length"] is not None:
        say(_focal_words(summary["focal_length"]))
    for camera in (summary["rig"] or [])[1:]:
        say(_camera_words(camera))
    seen = summary["sightings"]
    say(
        f"{seen['kept']} of {seen['tried']} sightings of {summary['points']} points kept, residual "
        f"{seen['rms_px']:.3g} px rms; subset of {len(found.subset)} frames"
    )
    if summary["cube"] is not None:
        tell_cube(summary["cube"])
    for note in summary["export_notes"]:
        say(note)


def _camera_words(camera: dict[str, Any]) -> str:
    """The offset of a camera of a rig."""
    angles = ", ".join(
        f"{math.degrees(value):.4f} +- {math.degrees(sigma):.4f}"
        for value, sigma in zip(camera["orientation"], camera["orientation_sigma"], strict=True)
    )
    lever = ", ".join(
        f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}"
        for value, sigma in zip(camera["position"], camera["position_sigma"], strict=True)
    )
    held = [name for name in camera["held"] if name in "xyz"]
    return (
        f"camera {camera['camera']}: turned by {angles} degrees, at {lever} mm from the first"
        + (f" ({', '.join(held)} as given: not observable)" if held else "")
        + f"; residual {camera['rms_px'] or math.nan:.3g} px rms"
    )


def _view_words(sequence: FrameSequence, found: SequencePoses) -> str:
    """The field of view, which shows a focal length in other units."""
    from sightline.io.camera_schema import field_degrees

    along, across = field_degrees(found.poses.detector(sequence.problem.detector))
    return f"field of view {along:.3g} degrees along x {across:.3g} across"


def _focal_words(focal: dict[str, Any]) -> str:
    """The focal length found and the one given."""
    known = "nothing known of it" if focal["told_sigma_px"] is None else f"+- {focal['told_sigma_px']:.2g}"
    return (
        f"focal length {focal['focal_length_px']:.6g} px, sigma {focal['sigma_px']:.2g} px; given "
        f"{focal['told_px']:.6g} px, {known}"
    )


def tell_cube(cube: dict[str, Any]) -> None:
    """The maps in a few lines."""
    from sightline.cli.terminal import say

    rows, columns = cube["shape"]
    bands = cube["bands"]
    covered = min(band["passed"] for band in bands)
    count = f"{len(bands)} bands" if len(bands) != 1 else "1 band"
    said = f"{count} of {rows} rows x {columns} columns of {cube['gsd']:.3g} m"
    share = f"a band covers at least {100.0 * covered:.1f} % of what lines of every band passed"
    say(f"{said}; {share}" if math.isfinite(covered) else said)
    misfit = [pair["rms_px"] for pair in cube["pairs"] if math.isfinite(pair["rms_px"])]
    if misfit:
        say(
            f"bands lie on each other to {min(misfit):.2g} to {max(misfit):.2g} px rms in those "
            f"{len(misfit)} of {len(cube['pairs'])} pairs that look alike enough to be compared, up to "
            f"{_farthest(cube):.0f} nm apart"
        )
    for warning in cube["warnings"]:
        say(warning)


def _farthest(cube: dict[str, Any]) -> float:
    """nm between the bands farthest apart that could be compared; 0 where they have no wavelengths."""
    nm = [band["wavelength_nm"] for band in cube["bands"]]
    apart = [
        abs(nm[pair["bands"][0]] - nm[pair["bands"][1]])
        for pair in cube["pairs"]
        if math.isfinite(pair["rms_px"])
    ]
    return max((d for d in apart if math.isfinite(d)), default=0.0)
