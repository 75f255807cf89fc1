"""``sightline match``: where one raster shows what another does, window by window; or the bands of one."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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

if TYPE_CHECKING:
    from sightline.imaging.source import ImageSource


class Geometry(StrEnum):
    """How one image is laid on the other."""

    AUTO = "auto"
    MAP = "map"
    PIXELS = "pixels"


class Pairs(StrEnum):
    """Which bands of a file are compared."""

    FIRST = "first"
    ALL = "all"


def match(
    a: Annotated[Path, typer.Argument(metavar="A", help="A raster, or a .npy file (lines, columns).")],
    out: Out,
    b: Annotated[
        Path | None,
        typer.Argument(metavar="[B]", help="The one that is compared with it; not with --bands."),
    ] = None,
    bands: Annotated[
        Pairs | None,
        typer.Option("--bands", help="Compare the bands of A: each with the first, or all pairs."),
    ] = None,
    band: Annotated[
        list[int] | None,
        typer.Option(
            "--band",
            metavar="N",
            help="Band of both rasters, from 1 (the first); given twice, that of A, then that of B. With "
            "--bands: one of the bands to compare.",
        ),
    ] = None,
    mask: Annotated[Path | None, file_of_mask("--mask", "A's")] = None,
    mask_b: Annotated[Path | None, file_of_mask("--mask-b", "B's")] = None,
    geometry: Annotated[
        Geometry,
        typer.Option(
            "--geometry",
            help="Lay B on A by their places on the map, or by their pixels; auto: by the map where both "
            "have one.",
        ),
    ] = Geometry.AUTO,
    window: Annotated[
        tuple[int, int] | None,
        size_of_window("Of a window, in px of A: 10 100 by pixels, 32 32 on a map."),
    ] = None,
    step: Annotated[
        tuple[int, int] | None,
        typer.Option("--step", metavar="LINES COLUMNS", help="From window to window; the window's own size."),
    ] = None,
    search: Annotated[
        float | None,
        farthest_shift("Furthest shift that is looked for, in px of A (64); 0: under 4 px."),
    ] = None,
    workers: Workers = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Find where raster B shows what raster A shows: dense shifts, each with its covariance."""
    import time

    from sightline.cli.output import output_folder
    from sightline.cli.terminal import answered, progress, say
    from sightline.kinds.open import kind_of

    begun = time.perf_counter()
    options = {
        "geometry": geometry.value,
        "window": window,
        "step": step,
        "search_px": search,
    }
    writes = ["summary.json", "report.html", "pairs.csv" if bands is not None else "shifts.tif"]
    with output_folder(out, overwrite=overwrite, writes=writes) as folder, progress() as report:
        report("opening the images")
        if bands is not None:
            result = _of_bands(a, b, bands.value, band, mask, mask_b, report, options)
        else:
            result = _of_two(a, b, band, mask, mask_b, report, options)
        used = [path for path in (a, b, mask, mask_b) if path is not None]
        summary = kind_of(result).render(result, folder, report, begun, inputs=list(dict.fromkeys(used)))
    if answered(summary, as_json):
        return
    for one in summary.get("pairs", [summary]):
        say(f"{' - '.join(one['images']):16}  {_shift(one)}")
    say(f"{out / 'summary.json'}, {out / 'report.html'}")


def _shift(one: dict[str, Any]) -> str:
    """What two images are apart, in words."""
    (line, column), scatter, sigma = one["median_px"], one["scatter_px"], one["sigma_px"]
    return (
        f"{line:+.4f} lines, {column:+.4f} columns (median); windows scatter by {scatter[0]:.4f}, "
        f"{scatter[1]:.4f} px, sigma {sigma[0]:.4f}, {sigma[1]:.4f} px; {one['windows']['kept']} of "
        f"{one['windows']['tried']} kept"
    )


def _of_two(
    a: Path,
    b: Path | None,
    band: list[int] | None,
    mask: Path | None,
    mask_b: Path | None,
    report: Any,
    options: dict[str, Any],
) -> Any:
    """Matches of two files."""
    from sightline.applications.raster_matches import match_rasters
    from sightline.errors import InputError

    if b is None:
        raise InputError("one raster is given; give a second, or --bands first to compare the bands of one")
    numbers = band or [1]
    if len(numbers) > 2:
        raise InputError(
            f"--band is given {len(numbers)} times; once for both rasters, or twice: A's, then B's"
        )
    images = [
        _opened(path, number, hidden)
        for path, number, hidden in ((a, numbers[0], mask), (b, numbers[-1], mask_b))
    ]
    return match_rasters(images[0], images[1], progress=report, **options)


def _of_bands(
    a: Path,
    b: Path | None,
    pairs: str,
    band: list[int] | None,
    mask: Path | None,
    mask_b: Path | None,
    report: Any,
    options: dict[str, Any],
) -> Any:
    """Matches of the bands of a file."""
    from sightline.applications.raster_matches import match_bands
    from sightline.errors import InputError
    from sightline.io.formats.images import open_image

    if b is not None or mask_b is not None:
        raise InputError("--bands compares the bands of one raster; leave the second, or --bands, out")
    probe = open_image(a)
    count = getattr(probe, "count", 1)
    numbers = list(dict.fromkeys(band or range(1, count + 1)))
    beyond = [number for number in numbers if not 1 <= number <= count]
    if beyond:
        raise InputError(f"{a}: --band {beyond[0]} does not exist; the file has {count}; choose 1 to {count}")
    if len(numbers) < 2:
        raise InputError(f"{a}: {len(numbers)} band is to be compared; two are needed at least")
    images = [_opened(a, number, mask) for number in numbers]
    names = [
        getattr(getattr(image, "source", image), "description", None) or f"band {number}"
        for image, number in zip(images, numbers, strict=True)
    ]
    if len(set(names)) < len(names):
        names = [f"band {number}" for number in numbers]
    return match_bands(images, names, pairs=pairs, progress=report, **options)


def _opened(path: Path, band: int, mask: Path | None) -> ImageSource:
    """An image that has something to match in it."""
    from sightline.imaging.placed import PlacedImage
    from sightline.io.formats.images import check_content, load_raster

    image = load_raster(path, band, mask)
    check_content(image.source if isinstance(image, PlacedImage) else image)  # type: ignore[arg-type]
    return image
