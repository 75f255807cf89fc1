"""``sightline layout``: where to put the detectors, or which lines of one to use, for a band of jitter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sightline.cli.options import AllowNetwork, Json, Overwrite, Workers

if TYPE_CHECKING:
    from sightline.applications.focal_plane import LayoutChoice

#: What it always writes.
_WRITES = ("layouts.csv", "summary.json", "report.html")


def layout(
    instrument: Annotated[Path, typer.Argument(metavar="INSTRUMENT.toml", help="What is known of it.")],
    passband: Annotated[
        tuple[float, float],
        typer.Option("--passband", metavar="F1 F2", help="Hz; the band of jitter to be seen."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder for layouts.csv, summary.json and report.html; without it only a table is printed.",
        ),
    ] = None,
    count: Annotated[
        int,
        typer.Option("--count", min=1, max=1000, help="Best layouts listed, besides those that stand out."),
    ] = 10,
    workers: Workers = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Rank layouts of the focal plane by how well they see the motion in a band, beside other layouts."""
    import time
    from contextlib import nullcontext

    from sightline.applications.focal_plane import choose_layout, layout_cost
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import announce, complain, print_json, progress
    from sightline.errors import naming
    from sightline.io.layout.load import load_instrument
    from sightline.io.results.layouts import summarize_layouts
    from sightline.kinds.layouts import Layouts
    from sightline.motion.layout.information import checked_passband

    begin = time.perf_counter()
    place = nullcontext() if out is None else output_folder(out, overwrite=overwrite, writes=_WRITES)
    with place as folder, progress() as report:
        plane = load_instrument(instrument)
        checked_passband(passband)
        with naming(instrument):  # what the file asks for in this band
            announce(layout_cost(plane, passband))
            choice = choose_layout(plane, passband, count=count, progress=report)
        if folder is None:
            summary = summarize_layouts(choice, instrument, wall_seconds=time.perf_counter() - begin)
        else:
            summary = Layouts().render(choice, folder, report, begin)
    if as_json:
        print_json(summary)
        return
    for warning in choice.warnings:
        complain("warning", warning)
    _tell(choice, out)


def _tell(choice: LayoutChoice, out: Path | None) -> None:
    """The ranked layouts as a table, the others below, and how much better the best is."""
    from sightline.cli.terminal import say

    low, high = choice.passband
    say(f"worst case over {low:g}-{high:g} Hz in images' worth, posterior sigma of all and in the band (px):")
    say(f"{'rank':>4}  {'worst':>7} at Hz    sigma  in band  positions (ms)")
    names = {layout.name: "" for layout in choice.compared}
    for rank, layout in enumerate((*choice.ranked, *choice.compared), 1):
        number = str(rank) if layout.name not in names else "-"
        places = " ".join(f"{1e3 * t:.2f}" for t in layout.positions)
        say(
            f"{number:>4}  {layout.worst_images:7.4f} {layout.worst_frequency:5.4g}  {layout.sigma_px:7.4f}"
            f"  {layout.band_sigma_px:7.4f}  {places}" + (f"  ({layout.name})" if layout.name else "")
        )
    for other in choice.compared:
        if other.blind_in_band:
            say(f"{other.name} is blind at {other.worst_frequency:.4g} Hz")
        else:
            gain = choice.best.worst_images / other.worst_images
            say(f"the best sees its worst frequency {gain:.3g} times as well as {other.name} its own")
    if out is not None:
        say(f"{out / 'layouts.csv'}, {out / 'report.html'}")
