"""``sightline tie``: control points between images whose cameras are rough and a reference orthoimage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sightline.cli.options import (
    AllowNetwork,
    Json,
    Out,
    Overwrite,
    Workers,
    farthest_shift,
    file_of_mask,
    size_of_window,
)


def tie(
    acquisition: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.toml",
            help="An ACQUISITION ([\\[band]] or [\\[frame]]), a STEREO (images) or a SEQUENCE.toml.",
        ),
    ],
    reference: Annotated[
        Path,
        typer.Option("--reference", metavar="ORTHO", help="Georeferenced orthoimage of the same ground."),
    ],
    dem: Annotated[Path, typer.Option("--dem", metavar="DEM", help="Heights of the ground, m.")],
    out: Out,
    image: Annotated[
        list[str] | None,
        typer.Option(
            "--image",
            metavar="NAME",
            help="Band or frame to tie; may be given several times. Without it the first band, or frames "
            "evenly spread.",
        ),
    ] = None,
    band: Annotated[
        int, typer.Option("--band", metavar="N", min=1, help="Band of the reference, from 1.")
    ] = 1,
    mask: Annotated[Path | None, file_of_mask("--mask", "the reference's")] = None,
    geoid: Annotated[
        str | None,
        typer.Option(
            "--geoid",
            metavar="FILE|METRES",
            help="Height of the geoid above the ellipsoid, where the DEM counts from the geoid.",
        ),
    ] = None,
    reference_sigma: Annotated[
        float,
        typer.Option(
            "--reference-sigma", metavar="M", min=0.0, help="1-sigma of each place of the reference, m (0)."
        ),
    ] = 0.0,
    dem_sigma: Annotated[
        float, typer.Option("--dem-sigma", metavar="M", min=0.0, help="1-sigma of heights of the DEM, m (0).")
    ] = 0.0,
    search: Annotated[
        float | None,
        farthest_shift("Furthest that cameras may be off, px (200)."),
    ] = None,
    window: Annotated[
        tuple[int, int] | None,
        size_of_window("Of a window, px: 4 100 of bands, 32 32 of frames."),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            metavar="N",
            min=1,
            help="Control points of an image, at most: 100 of a band, 2000 where it is the only one, 30 of a "
            "frame.",
        ),
    ] = None,
    workers: Workers = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Find control points, with sigma, between images and a reference orthoimage."""
    import time

    from sightline.applications.reference_tie import ALONE_POINTS, IMAGES, SEARCH, tie_to_reference
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import answered, progress, say
    from sightline.errors import naming
    from sightline.inputs import will_write
    from sightline.io.formats.images import load_raster
    from sightline.io.tied import chosen_images, files_with_control_points, load_tied, read_ground
    from sightline.kinds.tie import ReferenceTies

    begun = time.perf_counter()
    writes = ["summary.json", "control_points.csv", "report.html"]
    with output_folder(out, overwrite=overwrite, writes=writes) as folder, progress() as report:
        report("reading the images, the reference and the DEM")
        tied = load_tied(acquisition)
        will_write([f"{tied.kind}.toml"])
        chosen = chosen_images(tied, image or [], IMAGES)
        if points is None and tied.kind == "acquisition" and len(tied.names) == 1:
            points = ALONE_POINTS
        ortho = load_raster(reference, band, mask)
        ground = read_ground(dem, tied, geoid)
        with naming(acquisition):
            found = tie_to_reference(
                [tied.images[k] for k in chosen], [tied.cameras[k] for k in chosen], ortho, ground,
                names=[tied.names[k] for k in chosen], search_px=SEARCH if search is None else search,
                window=window, points=points, to_table=tied.to_table,
                reference_sigma=reference_sigma, dem_sigma=dem_sigma, progress=report,
            )  # fmt: skip
        more = files_with_control_points(tied, out, found.control_sigma_px)
        used = [*tied.inputs, *(path for path in (reference, dem, mask) if path is not None)]
        summary = ReferenceTies().render(
            found, folder, report, begun, name=tied.name, more=more, inputs=list(dict.fromkeys(used))
        )
    if answered(summary, as_json):
        return
    for one in summary["images"]:
        line, column = one["offset_px"]
        say(
            f"{one['name']:16}  {one['points']} control points; the camera is off by {line:+.2f} lines, "
            f"{column:+.2f} columns (median), a match is known to {one['sigma_px'][0]:.3f}, "
            f"{one['sigma_px'][1]:.3f} px"
        )
    command = {"acquisition": "recover", "stereo": "orient", "sequence": "georeference"}[tied.kind]
    say(f"next: sightline {command} {out / next(iter(more))} --out DIR")
