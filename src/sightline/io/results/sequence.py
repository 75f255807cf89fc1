"""Poses of a sequence → ``frames_used.csv`` and ``summary.json``; described in ``docs/formats.md``.

Not here: the poses themselves and models for other programs (``sequence_exports.py``), the page
(``report/sequence_page.py``).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from sightline.applications.sequence_poses import SequencePoses
from sightline.io.formats.tables import write_columns
from sightline.io.results.line_of_sight import peak_memory, write_json
from sightline.io.results.poses import SIGMAS, SOURCES, in_table_axes, pose_axes
from sightline.io.results.rig import rig_summary, write_rig
from sightline.io.results.sequence_exports import write_pose_exports, write_sequence_poses
from sightline.io.sequence.load import FrameSequence
from sightline.photogrammetry.flight.table_check import table_fits
from sightline.version import VERSION

Array = NDArray[np.float64]

#: Constant errors of the tables, in the order of `FramePoses.bias`.
DATUM = ("x", "y", "z", "roll", "pitch", "yaw")
#: Columns of ``frames_used.csv``, by the table of which they tell.
CHI_SQUARED = {"positions": "position_chi_squared", "attitudes": "attitude_chi_squared"}
#: Sightings up to which models for other programs hold points; they are text, some 60 bytes each.
EXPORTED_SIGHTINGS = 1_000_000


def write_sequence_result(
    folder: Path, sequence: FrameSequence, found: SequencePoses, *, wall_seconds: float, **more: Any
) -> dict[str, Any]:
    """Write every table of the poses of a sequence, and the summary.

    Parameters
    ----------
    folder : Path
        Exists.
    sequence : FrameSequence
    found : SequencePoses
    wall_seconds : float
        s; of the whole command so far.
    more
        Further entries of the summary.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.
    """
    write_sequence_poses(folder, sequence, found.poses, found.source)
    few = len(found.tracks) <= EXPORTED_SIGHTINGS
    notes = write_pose_exports(
        folder, sequence, found.poses, found.source, found.tracks if few else None, found.rig
    )
    if not few:
        notes += (
            f"colmap/ and reconstruction.json hold no points: there are {len(found.tracks)} sightings, "
            f"written are {EXPORTED_SIGHTINGS} at most",
        )
    write_frames_used(folder / "frames_used.csv", sequence, found)
    if found.rig is not None:
        write_rig(folder, sequence.problem, found)
    summary = summarize_sequence(sequence, found, wall_seconds=wall_seconds)
    summary |= {"export_notes": list(notes)} | more
    write_json(folder / "summary.json", summary)
    return summary


def frame_residuals(found: SequencePoses) -> Array:
    """px (M,), rms of the residuals of each frame's good sightings, per coordinate; NaN without any."""
    poses = found.poses
    good = ~poses.rejected
    count = len(found.source)
    square = np.bincount(found.tracks.image[good], (poses.residual_px[good] ** 2).sum(axis=1), count)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(square / (2.0 * np.bincount(found.tracks.image[good], minlength=count)))


def write_frames_used(path: Path, sequence: FrameSequence, found: SequencePoses) -> None:
    """``frames_used.csv``: what each frame gave, why it is of the subset, why it gave nothing."""
    count = len(found.source)
    tried = np.bincount(found.tracks.image, minlength=count)
    subset, overlap, parallax = (
        np.zeros(count, dtype=np.int64),
        np.full(count, np.nan),
        np.full(count, np.nan),
    )
    words = list(found.reason)
    chosen = found.subset
    for k, frame in enumerate(chosen.frames):
        subset[frame], overlap[frame], parallax[frame] = 1, chosen.overlap[k], chosen.parallax[k]
        words[frame] = words[frame] or chosen.reason[k]
    columns: dict[str, Any] = {
        "frame": np.array(sequence.problem.frames, dtype=str),
        "t": sequence.problem.t,
        "source": np.array(found.source, dtype=str),
        "windows": tried,
        "sightings": found.poses.sightings,
        "residual_px": frame_residuals(found),
        "sharpness": found.followed.sharpness,
        "stretch": found.stretch,
        "subset": subset,
        "overlap": overlap,
        "parallax": parallax,
        **_chi_squared(sequence, found),
        "reason": np.array(words, dtype=str),
    }
    formats = dict.fromkeys(
        ("residual_px", "sharpness", "overlap", "parallax", *CHI_SQUARED.values()), "%.6g"
    )
    write_columns(path, columns, formats | {"t": "%.17g"})


def _chi_squared(sequence: FrameSequence, found: SequencePoses) -> dict[str, Array]:
    """Per frame how far each table lies from its pose, (M,) each; NaN where the table says nothing."""
    out = {name: np.full(len(found.source), np.nan) for name in CHI_SQUARED.values()}
    for fit in table_fits(found.problem or sequence.problem, found.poses):
        out[CHI_SQUARED[fit.name]][fit.rows] = fit.square
    return out


def summarize_sequence(
    sequence: FrameSequence, found: SequencePoses, *, wall_seconds: float
) -> dict[str, Any]:
    """The content of ``summary.json``."""
    problem, poses = sequence.problem, found.poses
    covariance = in_table_axes(
        sequence.world, problem.radii, poses.position, poses.world_from_body, poses.covariance
    )[2]
    sigma = np.sqrt(np.einsum("mii->mi", covariance))
    lost = [k for k, reason in enumerate(found.reason) if reason]
    return {
        "name": sequence.name,
        "epoch": problem.epoch,
        "result": "SequencePoses",
        "version": VERSION,
        "frames": len(problem),
        "sources": {word: found.source.count(word) for word in SOURCES},
        "not_estimated": [{"frame": problem.frames[k], "reason": found.reason[k]} for k in lost],
        "stretches": int(found.stretch.max()) + 1,
        "subset": {"frames": [problem.frames[k] for k in found.subset.frames], "overlap": problem.overlap},
        "sigmas": {
            name: {"median": float(np.median(s)), "largest": float(s.max())}
            for name, s in zip(SIGMAS, sigma.T, strict=True)
        },
        "datum": _datum(sequence, found),
        "tables": _tables(sequence, found),
        "focal_length": _focal_length(sequence, found),
        "readout_time": _readout_time(sequence, found),
        "scale_sigma": poses.scale_sigma,
        "rig": rig_summary(problem, found),
        "bow": [dict(zip(DATUM[3:], map(float, bow), strict=True)) for bow in poses.bow],
        "sightings": _sightings(found),
        "points": int(np.isfinite(poses.points).all(axis=1).sum()),
        "warnings": list(found.warnings),
        "wall_seconds": wall_seconds,
        "peak_memory_bytes": peak_memory(),
        "inputs": sequence.input_hashes(),
    }


def _datum(sequence: FrameSequence, found: SequencePoses) -> dict[str, dict[str, float] | None]:
    """Constant errors of the tables (table less truth) and their sigmas; None where none was sought."""
    turn = np.eye(6)
    turn[:3, :3] = pose_axes(sequence.world, sequence.problem.radii)[1].as_matrix().T
    bias = turn @ found.poses.bias
    variance = np.diag(turn @ found.poses.bias_covariance @ turn.T)
    return {
        name: {"bias": float(b), "sigma": math.sqrt(v)} if v > 0.0 else None
        for name, b, v in zip(DATUM, bias, variance, strict=True)
    }


def _tables(sequence: FrameSequence, found: SequencePoses) -> dict[str, dict[str, Any]]:
    """Chi-square of what is given of the poses, and the frame that misses it most."""
    names = sequence.problem.frames
    return {
        fit.name: {
            "frames": len(fit.rows),
            "numbers": fit.numbers,
            "chi_squared": fit.chi_squared,
            "chi_squared_99": float(chdtri(fit.numbers, 0.01)),
            "farthest": {
                "frame": names[int(fit.rows[np.argmax(fit.square)])],
                "chi_squared": float(fit.square.max()),
            },
        }
        # as solved: with angles of turned frames turned
        for fit in table_fits(found.problem or sequence.problem, found.poses)
    }


def _focal_length(sequence: FrameSequence, found: SequencePoses) -> dict[str, float | None] | None:
    """px; what was found of the focal length, and what was given; None where it was kept."""
    focal, given = found.poses.focal, sequence.problem.detector
    if focal is None:
        return None
    px = found.poses.detector(given).focal_length_px
    return {
        "focal_length_px": px,
        "sigma_px": given.focal_length_px * focal.sigma,
        "told_px": given.focal_length_px,
        "told_sigma_px": given.focal_length_px * focal.prior if math.isfinite(focal.prior) else None,
    }


def _readout_time(sequence: FrameSequence, found: SequencePoses) -> dict[str, float] | None:
    """s; what was found of the readout time, and what was given; None where it was kept."""
    readout, given = found.poses.readout, sequence.problem
    if readout is None:
        return None
    return {
        "seconds": readout.seconds,
        "sigma": readout.sigma,
        "given": given.readout_time,
        "given_sigma": given.readout_sigma,
    }


def _sightings(found: SequencePoses) -> dict[str, Any]:
    """How many were tried, kept and rejected, and their residuals (px)."""
    poses = found.poses
    kept = poses.residual_px[~poses.rejected]
    return {
        "tried": len(found.tracks),
        "kept": len(kept),
        "rejected": int(poses.rejected.sum()),
        "rms_px": float(np.sqrt((kept**2).mean())) if len(kept) else math.nan,
    }
