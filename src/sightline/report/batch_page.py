"""A batch → its page: how many are done, which failed and why, main figures of each with a link to its page.

Not here: the pages of the inputs (each in its own folder).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from sightline.applications.batch import Batch, JobOutcome
from sightline.errors import printable, shortened
from sightline.execution import size_words, time_words
from sightline.report.page import LONGEST_WORD, Page, Section, Table, inputs

#: What a command's table shows: head, figure, form.
_SHOWN = {
    "recover": (
        ("lines", "lines", "{:.0f}"), ("windows kept", "matches_kept", "{:.0f}"),
        ("residual (px)", "residual_rms_px", "{:.4f}"),
        ("roll moved (px)", "rms_motion_roll_px", "{:.4f}"), ("sigma (px)", "sigma_roll_px", "{:.4f}"),
        ("pitch moved (px)", "rms_motion_pitch_px", "{:.4f}"), ("sigma (px)", "sigma_pitch_px", "{:.4f}"),
        ("yaw moved (px)", "rms_motion_yaw_px", "{:.4f}"), ("sigma (px)", "sigma_yaw_px", "{:.4f}"),
        ("NEES withheld", "withheld_nees", "{:.2f}"),
    ),
    "georeference": (
        ("frames", "images", "{:.0f}"), ("points", "points", "{:.0f}"),
        ("residual (px)", "residual_rms_px", "{:.3f}"), ("sigma x (m)", "sigma_x", "{:.3g}"),
        ("sigma y (m)", "sigma_y", "{:.3g}"), ("sigma z (m)", "sigma_z", "{:.3g}"),
        ("sigma roll (rad)", "sigma_roll", "{:.2g}"), ("sigma pitch (rad)", "sigma_pitch", "{:.2g}"),
        ("sigma yaw (rad)", "sigma_yaw", "{:.2g}"),
    ),
    "orient": (
        ("images", "images", "{:.0f}"), ("points", "points", "{:.0f}"),
        ("matches kept", "matches_kept", "{:.0f}"), ("residual (px)", "residual_rms_px", "{:.3f}"),
        ("weakest sigma (rad)", "weakest_sigma", "{:.3g}"),
    ),
    "tdi": (
        ("columns", "columns", "{:.0f}"), ("signals", "signals", "{:.0f}"), ("mean SNR", "snr", "{:.1f}"),
        ("certified loss", "certified_loss", "{:.2g}"),
    ),
}  # fmt: skip


def batch_page(result: Batch, summary: Mapping[str, Any]) -> Page:
    """The page of a batch.

    Parameters
    ----------
    result : Batch
    summary : mapping
        The content of its ``summary.json``.
    """
    outcomes, failed = result.outcomes, result.failed
    done = [one for one in outcomes if not one.status]
    sections = [
        Section("failed", "Failed", [_failures(failed)]) if failed else None,
        *(_of_command(command, done) for command in _SHOWN),
        inputs(summary),
    ]
    return Page(
        result.name,
        "results of many inputs",
        f"{len(outcomes)} inputs{_took(result)}",
        _sentences(result),
        [],
        [section for section in sections if section is not None],
        f"Sightline {summary['version']}; {summary['wall_seconds']:.0f} s",
    )


def _sentences(result: Batch) -> list[str]:
    outcomes, failed = result.outcomes, result.failed
    kept = sum(one.kept for one in outcomes)
    said = f"{len(outcomes) - len(failed)} of {len(outcomes)} inputs are done"
    said += f", {kept} of them by an earlier batch" if kept else ""
    warned = sum(one.warnings > 0 for one in outcomes if not one.status)
    return [
        f"{said}; {len(failed)} failed." if failed else f"{said}.",
        *([f"{warned} of them have warnings, which stand on their own pages."] if warned else []),
        "The tables link each page; results.csv has every figure.",
    ]


def _took(result: Batch) -> str:
    """CPU time and memory of all."""
    cpu = sum(one.cpu_seconds for one in result.outcomes)
    most = max((one.peak_memory_bytes or 0 for one in result.outcomes), default=0)
    return f"; {time_words(cpu)} of CPU in all" + (f"; {size_words(most)} of memory at most" if most else "")


def _failures(failed: Sequence[JobOutcome]) -> Table:
    rows = [[one.name, one.command or "none", one.status, one.message, one.file] for one in failed]
    return Table(["input", "command", "exit status", "message", "file"], rows, [0, 1, 3, 4])


def _of_command(command: str, done: Sequence[JobOutcome]) -> Section | None:
    """A table of the inputs of one command; None where there are none."""
    own = [one for one in done if one.command == command]
    if not own:
        return None
    shown = _SHOWN[command]
    rows = [
        [
            _link(one.name),
            *(_number(one.figures.get(key), form) for _, key, form in shown),
            one.warnings,
            f"{one.cpu_seconds:.1f}",
            "kept" if one.kept else "done",
        ]
        for one in own
    ]
    heads = ["input", *(head for head, _, _ in shown), "warnings", "CPU (s)", "state"]
    return Section(command, f"Inputs of {command}", [Table(heads, rows, [0])])


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _link(name: str) -> Markup:
    """The page of an input, below the folder of this one."""
    shown = shortened(printable(name), LONGEST_WORD)
    return Markup('<a href="{}/report.html">{}</a>').format(quote(name, errors="replace"), shown)
