"""The page of a georeferenced frame sequence.

Not here: its figures and words (the other ``sequence_*`` files).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sightline.applications.sequence_poses import SequencePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.report import sequence_cube, sequence_figures
from sightline.report import sequence_words as words
from sightline.report.figure import Figure
from sightline.report.page import Page, Section, Table, inputs
from sightline.report.sequence_cube import CubeView
from sightline.report.sequence_overlap_figure import FEW_FRAMES, overlap_figure, shared_points
from sightline.report.sequence_trajectory_figure import trajectory_figure
from sightline.report.sequence_view import SequenceView, control_places, sequence_view


def sequence_page(
    problem: SequenceProblem,
    found: SequencePoses,
    summary: Mapping[str, Any],
    *,
    cube: CubeView | None = None,
    cube_seconds: Mapping[str, float] | None = None,
) -> Page:
    """The page of a georeferenced sequence.

    Parameters
    ----------
    problem : SequenceProblem
    found : SequencePoses
    summary : mapping
        `name`, `version`, and where they are known `wall_seconds`, `peak_memory_bytes`, `inputs` (file to
        SHA-256), `files` (names written beside the page), `warnings` (those of `found` otherwise).
    cube : CubeView, optional
        The cube that was made with these poses.
    cube_seconds : mapping, optional
        CPU seconds of its stages.
    """
    view = sequence_view(problem, found)
    files = ", ".join(summary.get("files", []))
    beside = f"Files beside this page: {files}. " if files else ""
    return Page(
        heading=summary["name"],
        what="poses of a frame sequence",
        about=about(problem, summary, view, sum(found.taken_over.values())),
        sentences=words.sentences(problem, found, view) + _cube_words(problem, cube),
        warnings=list(summary.get("warnings", found.warnings)),
        mind="Mind before using the poses",
        sections=[
            *_idle(problem, found, view),
            *([] if cube is None else _pictures(cube) + cube_sections(cube)),
            *_rig(problem, found),
            *sections(problem, found, view),
            *_tables(problem, found, view, cube_seconds),
            *([inputs(summary)] if summary.get("inputs") else []),
        ],
        footer=f"{beside}1 sigma means 68 times in 100; px are of the frames, on the ground one spans what "
        "the camera's height makes of it.",
    )


def _folding(heads: Sequence[str], rows: list[list[str]], left: list[int], said: str) -> Table:
    """A table that is folded where it is long."""
    return Table(heads, rows, left, said if len(rows) > words.FOLDED else "")


def _idle(problem: SequenceProblem, found: SequencePoses, view: SequenceView) -> list[Section]:
    """Frames without evidence; none where all have some."""
    rows = words.idle_rows(problem, found, view)
    said = (
        "Nothing in their images shows their poses, which are carried over from their neighbours by the "
        "smoothness of the path and by the tables; their sigmas say so."
    )
    table = _folding(words.IDLE_HEADS, rows, [0, 3], f"all {len(rows)} runs of frames")
    return [Section("not-estimated", "Frames that could not be estimated", [said, table])] if rows else []


def _rig(problem: SequenceProblem, found: SequencePoses) -> list[Section]:
    """Cameras of a rig; none where there is one camera."""
    if found.rig is None:
        return []
    said = (
        "How each camera is turned (about body axes) and where its lens lies (forward, right, down) against "
        "the first, which is the body. What the images do not know better than what was given stays as it "
        "was, with that sigma; the last column names it."
    )
    table = Table(words.RIG_HEADS, words.rig_rows(problem, found), [0, 9])
    return [Section("rig", "Cameras of the rig", [said, table])]


def _pictures(cube: CubeView) -> list[Section]:
    """Three bands of the cube; none where they never meet."""
    parts = [part for slider in sequence_cube.sliders(cube) for part in (slider.said, slider.html)]
    return [Section("pictures", "Three bands in colour, before and after", parts)] if parts else []


def _tables(
    problem: SequenceProblem, found: SequencePoses, view: SequenceView, cube_seconds: Any
) -> list[Section]:
    """Constant errors and bow, the subset, time."""
    biases = words.bias_table(problem, found) + words.focal_row(problem, found)
    biases += words.readout_row(problem, found)
    bows, subset = words.bow_rows(problem, found, view), words.subset_rows(problem, found)
    stages, count = words.stage_rows(found, cube_seconds), len(found.subset)
    constant: list[str | Table] = [
        "Errors that all rows of a table have in common: table less truth; positions to the east, the north "
        "and up in the middle of the flight, angles about body axes.",
        Table(words.BIAS_HEADS, biases, [0, 4]),
    ]
    tables: list[str | Table] = [
        "The tables beside the poses found: squares of what lies between them, constant errors taken off, "
        "over sigmas squared. Poses follow the tables where images tell little: of good ones it is less. "
        "Frames that were taken as turned against their angles are compared as turned.",
        Table(words.TABLE_HEADS, words.table_rows(problem, found), [0, 4]),
    ]
    bow = (
        "A stretch of the flight is a run of frames without a pause. Bow: 1 sigma of the even trend of the "
        "angles' errors from its first frame to its last, rms along it. It bends the ground of a long strip "
        "and is hardly observable in any overlap."
    )
    why = (
        f"{count} frames. Overlap: share of the frame that the one taken before shows, as measured. "
        "Parallax: angle between the lines of sight of both to the ground between them."
    )
    why += f" The first {len(subset)} are listed; poses.csv marks all." if count > len(subset) else ""
    took = "Processor time; stages of a start that was stopped count with what they took then."
    heads = [*words.STAGE_HEADS, *([words.TAKEN_OVER] if found.taken_over else [])]
    bow_table = _folding(words.BOW_HEADS, bows, [0, 7], f"all {len(bows)} stretches")
    subset_table = _folding(words.SUBSET_HEADS, subset, [0, 4], "all frames of the subset")
    return [
        Section(
            "constant-errors",
            "Constant errors, tables and bow",
            [*(constant if biases else []), *tables, bow, bow_table],
        ),
        Section("subset", "The subset, and why each frame was taken", [why, subset_table]),
        *([Section("time", "Time per stage", [took, Table(heads, stages, [0, 4])])] if stages else []),
    ]


def _cube_words(problem: SequenceProblem, cube: CubeView | None) -> list[str]:
    """The cube, and what its bands show of the poses where they come from different frames."""
    if cube is None:
        return []
    by_line = problem.detector.wavelength_nm is not None
    if not by_line or not len(cube.pair_rms_px):
        return sequence_cube.cube_sentences(cube)
    relative = (
        "Behind the filter two bands of one place come from different frames: how well bands fit is a "
        "measured figure of how well those frames are known to each other, beside the absolute sigmas above."
    )
    return [*sequence_cube.cube_sentences(cube), relative]


def about(
    problem: SequenceProblem, summary: Mapping[str, Any], view: SequenceView, earlier: float = 0.0
) -> str:
    """One line under the title; `earlier`: s of processor time in starts that were stopped."""
    lines, columns = problem.detector.shape
    parts = [
        f"Poses of {len(problem):,} frames of {lines} × {columns} px by Sightline {summary['version']}",
        *([f"t = 0 is {problem.epoch}"] if problem.epoch else []),
    ]
    if view.origin is not None:
        east, north = view.origin
        parts.append(
            f"about {abs(north):.4f}° {'N' if north >= 0.0 else 'S'}, {abs(east):.4f}° "
            f"{'E' if east >= 0.0 else 'W'}"
        )
    if summary.get("wall_seconds"):
        before = f", and {earlier:.0f} s of processor time in starts before this" if earlier else ""
        parts.append(f"made in {summary['wall_seconds']:.0f} s{before}")
    if summary.get("peak_memory_bytes"):
        parts.append(f"{summary['peak_memory_bytes'] / 2**30:.2f} GiB of memory at most")
    return "; ".join(parts)


def sections(problem: SequenceProblem, found: SequencePoses, view: SequenceView) -> list[Section]:
    """All figures of the poses in the order of the page."""
    shared = shared_points(view, found)
    each = (
        "Each dot is a frame."
        if len(view.t) <= FEW_FRAMES
        else f"Each dot is a group of about {len(view.t) / max(len(shared.frames), 1):.0f} frames around one "
        "of the subset."
    )
    return [
        Section(
            "trajectory",
            "Trajectory in plan and in profile",
            [
                "Where the camera was. Ellipses hold the true, absolute position of their frame 95 times in "
                "100; they are mostly what all frames have wrong together, so that the path is known far "
                "better in itself. Scales and enlargements are in the titles of the panels.",
                trajectory_figure(view, control_places(problem, found)),
            ],
        ),
        Section(
            "residuals",
            "Reprojection error along the sequence",
            [
                "How far points seen in a frame lie from where the solution puts them. Frames that stand out "
                "above the dotted line blur, show moving things, or moved while they were read out otherwise "
                "than modelled.",
                sequence_figures.frame_residual_figure(view, problem.epoch),
            ],
        ),
        Section(
            "parameters",
            "Six parameters against time",
            [
                "Lines: what was found, less an even path of each stretch (positions: even acceleration; "
                "angles: an even turn), so that jitter can be seen. Left: with what the tables gave of the "
                "same, whose distance from the line is their noise and constant error, and the band that "
                "holds the absolute value 95 times in 100; it moves mostly as a whole. Right: the lines by "
                "themselves, at a scale of their own.",
                sequence_figures.departure_figure(view, problem.epoch),
            ],
        ),
        Section(
            "sigma",
            "1-sigma of the six parameters against time",
            [
                "Of absolute poses. A level floor is what all frames have wrong together (the datum); peaks "
                "are frames without evidence of their own, ends of stretches are known less. Wide lines lie "
                "under narrow ones of the same value. On the ground, errors of place and of tilt partly make "
                "up for each other.",
                sequence_figures.pose_sigma_figure(view, problem.epoch),
            ],
        ),
        Section(
            "overlap",
            "Which frames see the same points",
            [
                f"{each} Arcs join groups of one stretch, straight lines groups of different stretches; the "
                "wider, the more points both see. In the matrix, blocks beside the diagonal are what "
                "stretches share; a gap in the diagonal is a place where nothing was followed from one "
                "frame to the next.",
                overlap_figure(view, shared),
            ],
        ),
    ]


def cube_sections(cube: CubeView) -> list[Section]:
    """Figures of a cube."""
    drawn: list[tuple[str, str, str, Figure | None]] = [
        (
            "band-error",
            "Band-to-band error over the ground",
            "How far bands lie from each other, rms over the pairs compared in each place; every cell is "
            "a window that was compared, px are those of the map. Patches along the path are errors of "
            "poses, patches that follow hills errors of the surface; white: not known.",
            sequence_cube.error_map_figure(cube),
        ),
        (
            "band-pairs",
            "Band-to-band error against the distance of the wavelengths",
            "Each dot is a pair of bands. Bands far apart in wavelength were taken by other frames and look "
            "less alike: where dots rise with distance, compare them with the noise of the comparison.",
            sequence_cube.pair_figure(cube),
        ),
        (
            "coverage",
            "Coverage of each band",
            "Share of the ground that the lines of every band passed over for which a band has a value: "
            "less than all where steps between frames were too long for its lines.",
            sequence_cube.coverage_figure(cube),
        ),
    ]
    return [Section(name, title, [said, figure]) for name, title, said, figure in drawn if figure is not None]
