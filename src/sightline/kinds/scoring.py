"""A score against truth: what `score` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sightline.errors import foreign_errors
from sightline.evaluation.score import AXES, AxisScore, Score
from sightline.io.results.line_of_sight import write_json
from sightline.kinds.kind import SUMMARY, Columns, ResultKind, Tell
from sightline.version import VERSION


class Scoring(ResultKind):
    """`Score`. The command writes no files; `write` leaves what it prints as ``summary.json``."""

    types = (Score,)
    table, index, files = "axes", ("axis",), (SUMMARY,)

    def facts(self, result: Score) -> Mapping[str, str]:
        """Errors, and whether the sigmas are true."""
        return {
            "lines": str(result.lines),
            **{
                name: f"error {axis.rms:.3g} {axis.unit} rms, NEES {axis.nees:.3g}"
                for name, axis in result.axes.items()
            },
        }

    def columns(self, result: Score) -> Columns:
        """A row per axis."""
        rows = [vars(axis) for axis in result.axes.values()]
        return {"axis": list(AXES)} | {key: [row[key] for row in rows] for key in rows[0]}

    def summarize(self, result: Score) -> dict[str, Any]:
        """What the command prints."""
        return {"result": "Score", "version": VERSION, **result.as_dict()}

    def render(self, result: Score, folder: Path, tell: Tell, begun: float) -> dict[str, Any]:
        """The one file."""
        summary = self.summarize(result)
        write_json(folder / SUMMARY, summary)
        return summary

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """All of it."""
        with foreign_errors(folder / SUMMARY, "is no score", "write it again"):
            return {
                **{name: AxisScore(**summary[name]) for name in AXES},
                "lines": int(summary["lines"]),
                "hidden": tuple(summary["hidden_directions_removed"]),
                "left_out": tuple(summary["left_out"]),
                "absolute": {name: AxisScore(**entry) for name, entry in summary["absolute"].items()},
            }

    def draw(self, result: Score, axes: Sequence[Any]) -> None:
        """Error beside the stated sigma."""
        place = np.arange(3.0)
        for k, (key, label) in enumerate((("rms", "error, rms"), ("sigma", "stated sigma"))):
            axes[0].bar(
                place + 0.4 * k - 0.2, [getattr(axis, key) for axis in result.axes.values()], 0.4, label=label
            )
        axes[0].set_xticks(place, [f"{name} ({axis.unit})" for name, axis in result.axes.items()])
        axes[0].legend()
