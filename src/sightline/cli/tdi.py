"""``sightline tdi``: how many TDI stages, and how long each integrates, for every column and signal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite
from sightline.cli.terminal import Progress

if TYPE_CHECKING:
    from sightline.applications.tdi_choice import TdiResult
    from sightline.applications.tdi_lines import SignalLines
    from sightline.evaluation.tdi_pictures import StripPictures


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
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Choose TDI stages and integration ratio per column and signal, as a table looked up at line rate."""
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import complain, print_json, progress, say
    from sightline.io.results.tdi_settings import SETTINGS, TAGS

    with (
        output_folder(out, overwrite=overwrite, earlier=lambda _: (SETTINGS, TAGS)) as folder,
        progress() as report,
    ):
        chosen = judge(file, motion, report, pictures=pictures, signals=signals)
        summary = write_judged(folder, chosen, report)
    if as_json:
        print_json(summary)
        return
    for warning in summary["warnings"]:
        complain("warning", warning)
    tell(summary)
    say(f"{out / 'choice.csv'}, {out / 'table.bin'}, {out / 'report.html'}")
    if signals is not None:
        say(f"{out / SETTINGS}, {out / TAGS}")


@dataclass(frozen=True, eq=False)
class Judged:
    """A choice before it is written.

    Attributes
    ----------
    result : TdiResult
    pictures : StripPictures or None
    lines : SignalLines or None
        Of an image of signals.
    inputs : tuple of Path
        Files that were read.
    begun : float
        s of ``time.perf_counter``; when work began.
    """

    result: TdiResult
    pictures: StripPictures | None
    lines: SignalLines | None
    inputs: tuple[Path, ...]
    begun: float


def judge(
    file: Path, motion: Path | None, report: Progress, *, pictures: bool, signals: Path | None = None
) -> Judged:
    """The choice of a TDI.toml, a target imaged with it, and an image of signals opened."""
    import time
    from dataclasses import replace

    from sightline.applications.expected_cost import tdi_cost
    from sightline.applications.tdi_choice import choose_tdi
    from sightline.applications.tdi_lines import SignalLines, check_columns
    from sightline.cli.terminal import announce
    from sightline.errors import InputError
    from sightline.evaluation.tdi_pictures import strip_pictures
    from sightline.io.results.tdi_settings import open_signals
    from sightline.io.tdi.load import load_tdi, tdi_inputs

    begun = time.perf_counter()
    image = None if signals is None else open_signals(signals)
    problem = load_tdi(file, motion)
    if image is not None:
        check_columns(image, problem.columns)
    announce(tdi_cost(problem))
    report(f"choosing among {len(problem.grid)} settings")
    result = choose_tdi(problem)
    target = None
    # the target drifts steadily: under a motion it would look as sharp as it is not
    if pictures and problem.motion is None:
        report("imaging a target")
        try:
            target = strip_pictures(result.choice, aperture=problem.aperture)
        except InputError as reason:  # the choice stands without them
            said = f"no pictures of a target: {reason}"
            result = replace(result, warnings=(*result.warnings, said))
    lines = None if image is None else SignalLines(result, image)
    inputs = (*tdi_inputs(file, motion), *([] if signals is None else [signals]))
    return Judged(result, target, lines, inputs, begun)


def write_judged(folder: Path, chosen: Judged, report: Progress) -> dict[str, Any]:
    """Every file of the result; gives the summary."""
    import time
    from functools import partial

    from sightline.io.results.tdi import write_choice, write_tdi_summary
    from sightline.io.results.tdi_settings import write_signal_lines
    from sightline.io.results.tdi_table import write_table
    from sightline.report.tdi_page import tdi_page

    write_choice(folder / "choice.csv", chosen.result.choice)
    write_table(folder, chosen.result.table)
    more: dict[str, Any] = {}
    warnings = list(chosen.result.warnings)
    if chosen.lines is not None:
        more["signal_image"] = write_signal_lines(
            folder, chosen.lines, partial(report, "settings of the lines")
        )
        warnings += chosen.lines.counts.warnings(chosen.result.table)
    seconds = time.perf_counter() - chosen.begun
    summary = write_tdi_summary(
        folder / "summary.json", chosen.result, chosen.inputs, wall_seconds=seconds, warnings=warnings, **more
    )
    tdi_page(chosen.result, summary, chosen.pictures).write(folder / "report.html")
    return summary


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
