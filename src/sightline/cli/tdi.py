"""``sightline tdi``: how many TDI stages, and how long each integrates, for every column and signal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite, Resume, Workers
from sightline.execution import Progress

if TYPE_CHECKING:
    from sightline.stages import Stages


def tdi(
    file: Annotated[Path, typer.Argument(metavar="TDI.toml", help="Detector, columns, signals, rules.")],
    out: Out,
    motion: Annotated[
        Path | None,
        typer.Option(
            "--motion",
            metavar="DIR",
            help="Folder that `recover` wrote for the acquisition of \\[columns]: settings for its motion.",
        ),
    ] = None,
    signals: Annotated[
        Path | None,
        typer.Option(
            "--signals",
            metavar="IMAGE",
            help="Raster or .npy of electrons of one line, a pixel for every column: also write the setting "
            "and the tags of each of its pixels (settings.tif, tags.bin).",
        ),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option(
            help="Image a target with the choice and with one setting for all (not under --motion)."
        ),
    ] = True,
    workers: Workers = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Choose TDI stages and integration ratio per column and signal, as a table looked up at line rate."""
    from sightline.cli.output import finished_stages, output_folder
    from sightline.cli.terminal import answered, progress, say
    from sightline.io.results.tdi_settings import SETTINGS, TAGS

    writes = ["summary.json", "choice.csv", "table.bin", "report.html"]
    with (
        output_folder(out, overwrite=overwrite, resume=resume, writes=writes) as folder,
        progress() as report,
    ):
        stages = finished_stages(out, refuse=resume and not overwrite)
        summary = choose_into(folder, file, motion, report, pictures=pictures, signals=signals, stages=stages)
    if answered(summary, as_json):
        return
    tell(summary)
    say(f"{out / 'choice.csv'}, {out / 'table.bin'}, {out / 'report.html'}")
    if signals is not None:
        say(f"{out / SETTINGS}, {out / TAGS}")


def choose_into(
    folder: Path,
    file: Path,
    motion: Path | None,
    report: Progress,
    *,
    pictures: bool,
    signals: Path | None = None,
    stages: Stages | None = None,
) -> dict[str, Any]:
    """Choose for a TDI.toml, write every file of the result, give the summary."""
    import time

    from sightline.applications.expected_cost import tdi_cost
    from sightline.applications.tdi_choice import choose_tdi
    from sightline.applications.tdi_lines import check_columns
    from sightline.cli.terminal import announce
    from sightline.errors import naming
    from sightline.io.results.tdi_settings import open_signals
    from sightline.io.tdi.load import load_tdi
    from sightline.kinds.tdi import Choice
    from sightline.result import source_of

    begun = time.perf_counter()
    image = None if signals is None else open_signals(signals)
    problem = load_tdi(file, motion)
    if image is not None:  # refused before anything is chosen
        with naming(signals):
            check_columns(image, problem.columns)
    announce(tdi_cost(problem))
    with naming(file):
        if stages is not None:
            stages.depend([source_of(problem), signals])
        chosen = choose_tdi(problem, progress=report, stages=stages)
    return Choice().render(chosen, folder, report, begun, pictures=pictures, signals=signals, stages=stages)


def tell(summary: dict[str, Any]) -> None:
    """The choice in a few lines."""
    from sightline.cli.terminal import say

    stages, ratio = summary["stages"], summary["integration_ratio"]
    say(
        f"{summary['columns']} columns x {summary['signals']} signals: {stages['min']:g} to "
        f"{stages['max']:g} stages, integration ratio {ratio['min']:g} to {ratio['max']:g}"
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
    image = summary.get("signal_image")
    if image is not None:
        stages, often = image["stages"], image["changes_per_line_and_column"]
        held = f"changes its setting every {1.0 / often:,.3g} lines" if often else "keeps its setting"
        lines = f"image of {image['lines']:,} lines"
        say(f"{lines}: {stages['min']:g} to {stages['max']:g} stages; a column {held}")
