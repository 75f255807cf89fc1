"""``sightline init``: a first TOML file: of products, as a template, or for images of a known instrument."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sightline.cli.options import AllowNetwork, Out, Overwrite

if TYPE_CHECKING:
    from sightline.io.init.bands import FirstAcquisition


def init(
    out: Out,
    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[PRODUCT]...",
            help="Metadata of a product, or its folder; several are bands of one strip. With --preset: "
            "images of the bands of one scene.",
        ),
    ] = None,
    template: Annotated[
        str | None,
        typer.Option(
            "--template", metavar="NAME", help="A commented example: strip, stereo, flight, tdi or layout."
        ),
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            "--preset",
            metavar="NAME",
            help="Instrument of images without metadata: sentinel-2-msi, zy-3-mux, pleiades.",
        ),
    ] = None,
    bands: Annotated[
        str | None,
        typer.Option(
            "--bands",
            metavar="NAME,NAME,...",
            help="Which bands the images hold, in their order, - for one to leave out; without it by "
            "the names of the files.",
        ),
    ] = None,
    lag_sign: Annotated[
        str | None,
        typer.Option(
            "--lag-sign",
            metavar="+|-",
            help="Whether bands are exposed after the first band of the preset (+, assumed if not given) or "
            "before it (-).",
        ),
    ] = None,
    overwrite: Overwrite = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Write a first TOML file: the acquisition of a product, of images without metadata, or a template."""
    if template is not None:
        given = {"images": images, "--preset": preset, "--bands": bands, "--lag-sign": lag_sign}
        _alone("--template", given)
        _of_template(template, out, overwrite)
    elif preset is None and images:
        _alone("a product (give --preset NAME for bare images)", {"--lag-sign": lag_sign})
        _of_products(images, bands.split(",") if bands is not None else (), out, overwrite)
    else:
        _of_images(images or [], preset, bands, lag_sign, out, overwrite)


def _alone(option: str, others: Mapping[str, object]) -> None:
    from sightline.errors import InputError

    for name, value in others.items():
        if value:
            raise InputError(f"{option} takes no {name}; leave one of the two out")


def _of_template(name: str, out: Path, overwrite: bool) -> None:
    """A commented example file."""
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import say
    from sightline.io.init.templates import template
    from sightline.writing import whole_text

    file, text = template(name)
    with output_folder(out, overwrite=overwrite) as folder:
        whole_text(folder / file, text)
    say(f"{out / file}: every number and name in it is an example; put your own")
    _next("check", out / file)


def _of_products(products: list[Path], names: Sequence[str], out: Path, overwrite: bool) -> None:
    """The acquisition of a product, of several of one strip, or of raw bands beside a product's metadata."""
    from sightline.cli.output import output_folder
    from sightline.io.init.products import acquisition_of_products
    from sightline.writing import whole_text

    with output_folder(out, overwrite=overwrite) as folder:
        begun = acquisition_of_products(products, out, names)
        begun.write(folder)
        whole_text(folder / "acquisition.toml", begun.text)
    _say(begun, out / "acquisition.toml")


def _say(begun: FirstAcquisition, file: Path) -> None:
    """What a first acquisition rests on, and how to go on."""
    from sightline.cli.terminal import say

    for title, lines in (
        ("found", begun.found),
        ("assumed", begun.assumed),
        ("not known", begun.unknown),
        ("before `recover`", begun.lacking),
    ):
        if lines:
            say(f"{title}:")
        for line in lines:
            say(f"  {line}")
    if begun.lacking:
        _next("check", file)
    else:
        _next("recover", file, "--out", "result")


def _of_images(
    images: list[Path],
    preset: str | None,
    bands: str | None,
    lag_sign: str | None,
    out: Path,
    overwrite: bool,
) -> None:
    """The acquisition of images of a known instrument."""
    from sightline.cli.output import output_folder
    from sightline.errors import InputError
    from sightline.io.init.bands import acquisition_of_bands, band_images
    from sightline.io.init.presets import PRESETS
    from sightline.io.init.presets import preset as preset_of
    from sightline.io.init.templates import TEMPLATES
    from sightline.writing import whole_text

    if preset is None or not images:
        raise InputError(
            f"give a product, --template NAME ({', '.join(TEMPLATES)}), or images with --preset NAME "
            f"({', '.join(PRESETS)})"
        )
    if lag_sign not in (None, "+", "-"):
        raise InputError(f"--lag-sign is {lag_sign!r}; allowed: +, -")
    known = preset_of(preset)
    names = bands.split(",") if bands is not None else ()
    sign = {"+": 1, "-": -1}[lag_sign] if lag_sign is not None else None
    with output_folder(out, overwrite=overwrite) as folder:
        begun = acquisition_of_bands(known, band_images(known, images, names), out, sign)
        whole_text(folder / "acquisition.toml", begun.text)
    _say(begun, out / "acquisition.toml")


def _next(command: str, file: Path, *options: str) -> None:
    """The command that goes on from here, as it can be typed."""
    import shlex

    from sightline.cli.terminal import say

    say(f"next: sightline {shlex.join([command, str(file), *options])}")
