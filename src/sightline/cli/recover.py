"""``sightline recover``: the motion of the line of sight of a strip, from its own images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite, Resume, Workers
from sightline.execution import Progress

if TYPE_CHECKING:
    from sightline.io.acquisition.acquired import Acquisition
    from sightline.motion.results import LineOfSight
    from sightline.stages import Stages


def recover(
    acquisition: Annotated[Path, typer.Argument(metavar="ACQUISITION.toml", help="What was acquired.")],
    out: Out,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="NAME",
            help="Estimator of the motion: joint, or S1's own, from the angular differences of a strip's "
            "bands: inverse, wiener, polynomial, kalman.",
        ),
    ] = "joint",
    withhold: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--withhold",
            metavar="A B",
            help="Leave the pair of bands A, B out, predict it from the others, and say how its own matches "
            "agree.",
        ),
    ] = None,
    workers: Workers = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Recover roll, pitch and yaw with their sigma: per line of a strip's bands, or per frame."""
    from sightline.cli.output import finished_stages, output_folder
    from sightline.cli.terminal import answered, progress, say
    from sightline.io.results.hidden import TABLE
    from sightline.motion.strip.strip import RecoverOptions
    from sightline.report.words import grouped, withheld_words

    left_out = (withhold,) if withhold else ()
    RecoverOptions(method=method, withhold=left_out)  # a word that is none is refused before anything is read
    # a file of another acquisition beside this motion.csv would be taken for a part of the same result
    writes = ["summary.json", "motion.csv", "attitude.csv", "report.html"]
    with (
        output_folder(out, overwrite=overwrite, resume=resume, writes=writes) as folder,
        progress() as report,
    ):
        stages = finished_stages(out, refuse=resume and not overwrite)
        summary = recover_into(folder, acquisition, report, method=method, withhold=left_out, stages=stages)
    if answered(summary, as_json):
        return
    for axis, unit in (("roll", "px"), ("pitch", "px"), ("yaw", "px at the field's edge")):
        motion, sigma = summary["rms_motion_px"][axis], summary["rms_sigma_px"][axis]
        unseen = "" if motion > sigma else ": not told from no motion"
        say(f"{axis:5}  moved {motion:.4f} {unit} rms, known to {sigma:.4f} px (1-sigma){unseen}")
    if summary["hidden_directions"]:
        words = grouped(summary["hidden_directions"]["words"])
        say(f"(after what the images cannot see is left out, by {out / TABLE}: {words})")
    if method != "joint":
        departure = summary["method"]["rms_departure_from_joint_px"]
        apart = ", ".join(f"{axis} {value:.4f}" for axis, value in departure.items())
        say(f"(by {method}; apart from the joint estimate by {apart} px rms, which its sigma includes)")
    before, after = summary["residual_rms_before_px"], summary["residual_rms_px"]
    if before is not None:
        expected = summary["residual_sigma_px"]
        say(
            f"bands  {before:.4f} px rms apart by the cameras as given, {after:.4f} px by what was found, "
            f"where their matches' own sigma asks for {expected:.4f} px"
        )
    for sentence in withheld_words(summary):
        say(sentence)
    control, matches = summary["control"], summary["matches"]
    if control is not None:
        rms, expected = control["residual_rms_px"], control["residual_sigma_px"]
        say(
            f"control points lay {control['residual_rms_before_px']:.4f} px rms off by the camera as given, "
            f"{rms:.4f} px by what was found, where their own sigma asks for {expected:.4f} px at most"
        )
        say(
            f"from {control['kept']} of {control['points']} control points; {out / 'motion.csv'}, "
            f"{out / 'report.html'}"
        )
        return
    say(f"from {matches['kept']} of {matches['tried']} windows; {out / 'motion.csv'}, {out / 'report.html'}")


def recover_into(
    folder: Path,
    acquisition: Path,
    report: Progress,
    *,
    method: str = "joint",
    withhold: tuple[tuple[str, str], ...] = (),
    truth: Path | None = None,
    stages: Stages | None = None,
) -> dict[str, Any]:
    """Recover the strip of `acquisition`, write every file of the result into `folder`, give the summary.

    The `truth` (a ``truth.csv``) is read after the estimate, to be drawn over it in the report.
    """
    import time

    from sightline.cli.terminal import announce, with_doubts
    from sightline.errors import naming
    from sightline.io.acquisition.load import load_acquisition, ready_to_recover
    from sightline.io.formats.tables import read_motion
    from sightline.kinds.recovery import Recovery

    begin = time.perf_counter()
    report("reading the acquisition")
    acquired = load_acquisition(acquisition)
    with with_doubts(acquired):
        announce(ready_to_recover(acquired, method))
        with naming(acquisition):
            result = recover_acquisition(acquired, report, method=method, withhold=withhold, stages=stages)
    true = None if truth is None else read_motion(truth)
    return Recovery().render(result, folder, report, begin, acquisition=acquired, truth=true)


def recover_acquisition(
    acquired: Acquisition,
    report: Progress,
    *,
    method: str = "joint",
    withhold: tuple[tuple[str, str], ...] = (),
    stages: Stages | None = None,
) -> LineOfSight:
    """Recover what an acquisition holds: bands of a strip, or frames of a camera, spinning or not."""
    from dataclasses import replace

    from sightline.applications.frame_attitude import recover_frame_attitude
    from sightline.applications.lag_sign import wrong_lag_sign
    from sightline.applications.line_of_sight import recover_line_of_sight
    from sightline.errors import InputError
    from sightline.motion.frames.passes import FrameOptions
    from sightline.motion.strip.strip import RecoverOptions

    if stages is not None:
        stages.depend(acquired.inputs)
    options = (
        RecoverOptions.from_matching(acquired.matching, method, withhold) if not acquired.frames else None
    )
    if options is None and method != "joint":
        raise InputError(
            f"--method {method} is for the bands of a strip: {acquired.path} holds frames, whose motion is "
            "recovered by the joint estimate alone; leave --method out"
        )
    if options is None and withhold:
        raise InputError(
            f"--withhold {' '.join(withhold[0])} is for the bands of a strip: {acquired.path} holds frames; "
            "leave --withhold out"
        )
    if acquired.frames and acquired.spin is not None:
        from sightline.applications.spin_attitude import SpinOptions, recover_spin_attitude

        return recover_spin_attitude(
            acquired.frames,
            acquired.surface,
            acquired.spin,
            lens=acquired.lens,
            chip=acquired.chip,
            attitude_sigma=acquired.attitude_sigma,
            parallax_sigma=acquired.parallax_sigma,
            sensors=acquired.sensors,
            control_points=acquired.control_points,
            options=SpinOptions.from_matching(acquired.matching),
            progress=report,
            stages=stages,
        )
    if acquired.frames:
        return recover_frame_attitude(
            acquired.frames,
            acquired.surface,
            lens=acquired.lens,
            height_sigma=acquired.height_sigma,
            sensors=acquired.sensors,
            control_points=acquired.control_points,
            options=FrameOptions.from_matching(acquired.matching),
            progress=report,
            stages=stages,
        )
    result = recover_line_of_sight(
        acquired.bands,
        acquired.surface,
        height_sigma=acquired.height_sigma,
        sensors=acquired.sensors,
        control_points=acquired.control_points,
        known=acquired.known_motion,
        options=options,
        progress=report,
        stages=stages,
    )
    if acquired.sensors or acquired.control_points is not None:
        return result  # with these the motion is tied to more than bands
    said = wrong_lag_sign(
        result,
        acquired.bands,
        acquired.surface,
        height_sigma=acquired.height_sigma,
        options=options,
        progress=report,
    )
    return replace(result, warnings=(*result.warnings, said)) if said else result
