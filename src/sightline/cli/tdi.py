"""``sightline tdi``: how many TDI stages, and how long each integrates, for every column and signal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import Json, Out, Overwrite

if TYPE_CHECKING:
    from sightline.applications.tdi_choice import TdiResult


def tdi(
    file: Annotated[Path, typer.Argument(metavar="TDI.toml", help="Detector, columns, signals, rules.")],
    out: Out,
    motion: Annotated[
        Path | None,
        typer.Option(
            "--motion",
            metavar="DIR",
            help="Folder that `recover` wrote for the acquisition of [columns]: settings for its motion.",
        ),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option(help="Image a target with the choice, and with one setting for all, for the report."),
    ] = True,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Choose TDI stages and integration ratio per column and signal, as a table looked up at line rate."""
    import time
    from dataclasses import replace

    from sightline.applications.tdi_choice import choose_tdi
    from sightline.cli.output import check_output_folder, output_folder
    from sightline.cli.terminal import complain, print_json, progress
    from sightline.errors import InputError
    from sightline.evaluation.tdi_pictures import strip_pictures
    from sightline.io.tdi import load_tdi, tdi_inputs
    from sightline.io.tdi_results import write_choice, write_tdi_summary
    from sightline.io.tdi_table import write_table
    from sightline.report.tdi_page import write_tdi_report

    begin = time.perf_counter()
    check_output_folder(out, overwrite=overwrite)
    with progress() as report:
        problem = load_tdi(file, motion)
        report(f"choosing among {len(problem.grid)} settings")
        result = choose_tdi(problem)
        target = None
        if pictures:
            report("imaging a target")
            try:
                target = strip_pictures(result.choice, aperture=problem.aperture)
            except InputError as reason:  # the choice stands without them
                said = f"no pictures of a target: {reason}"
                result = replace(result, warnings=(*result.warnings, said))
        report("writing the choice, its table and report")
        with output_folder(out, overwrite=overwrite) as folder:
            write_choice(folder / "choice.csv", result.choice)
            write_table(folder, result.table)
            seconds = time.perf_counter() - begin
            summary = write_tdi_summary(
                folder / "summary.json", result, tdi_inputs(file, motion), wall_seconds=seconds
            )
            write_tdi_report(folder / "report.html", result, summary, target)
    if as_json:
        print_json(summary)
        return
    for warning in result.warnings:
        complain("warning", warning)
    _tell(result, summary, out)


def _tell(result: TdiResult, summary: dict[str, Any], out: Path) -> None:
    """The choice in a few lines."""
    from sightline.cli.terminal import say

    choice = result.choice
    say(
        f"{summary['columns']} columns x {summary['signals']} signals: {choice.stages.min()} to "
        f"{choice.stages.max()} stages, integration ratio {choice.integration_ratio.min():g} to "
        f"{choice.integration_ratio.max():g}"
    )
    for way in summary["other_ways"]:
        say(
            f"{way['name']} would lose {100.0 * way['mean_loss']:.3g} % of the merit on average, "
            f"{100.0 * way['worst_loss']:.3g} % at worst"
        )
    table = summary["table"]
    say(
        f"table of {table['cells']} cells, {table['bytes']:,} bytes: loses "
        f"{100.0 * table['certified_loss']:.2g} % of the merit at worst, "
        f"{100.0 * table['mean_loss']:.2g} % on average"
    )
    say(f"{out / 'choice.csv'}, {out / 'table.bin'}, {out / 'report.html'}")
