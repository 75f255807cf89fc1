"""``sightline export``: a result in the forms that other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite

#: Forms, as ``io/results/exports.py`` writes them: said in --help, which must not wait for its import.
FORMS = (
    "csm",
    "isd",
    "aem",
    "oem",
    "rpc",
    "quaternions",
    "shifts",
    "ck",
    "isis",
    "stac",
    "geoparquet",
    "igm",
)


def export(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="Folder that `recover`, `georeference`, `register` or `orient` wrote; or an "
            "ACQUISITION.toml, for its cameras as they are given.",
        ),
    ],
    to: Annotated[str, typer.Option("--to", metavar="FORM", help=f"One of {', '.join(FORMS)}.")],
    out: Out,
    acquisition: Annotated[
        Path | None,
        typer.Option(
            "--acquisition",
            metavar="FILE",
            help="ACQUISITION.toml that the result was recovered or registered from, STEREO.toml of "
            "`orient`; forms that hold a camera need it.",
        ),
    ] = None,
    kernel: Annotated[
        list[Path] | None,
        typer.Option("--kernel", metavar="FILE", help="SPICE kernel, for forms of SPICE; may be repeated."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Write a result as CSM state, ISD, RPC, CCSDS message, C kernel, IGM with GLT, item of STAC, ..."""
    from sightline.cli.output import output_folder
    from sightline.cli.terminal import answered, progress, say
    from sightline.errors import InputError, failing_numbers
    from sightline.kinds.kind import earlier_export
    from sightline.kinds.open import kind_of, open_result

    if to not in FORMS:
        raise InputError(f"--to is {to!r}; allowed are {', '.join(FORMS)}")
    with (
        output_folder(out, overwrite=overwrite, earlier=earlier_export) as folder,
        progress() as report,
        failing_numbers(f"{result}"),
    ):
        if result.suffix == ".toml" and not result.is_dir():
            if acquisition is not None:
                raise InputError(f"{result} is an acquisition itself; leave --acquisition out")
            report("reading the acquisition")
            summary = _of_cameras(result, to, folder, tuple(kernel or ()))
        else:
            report("reading the result")
            opened = open_result(result)
            report(f"writing {to}")
            summary = kind_of(opened).export_into(opened, to, folder, acquisition, kernel or ())
    if answered(summary, as_json):
        return
    for band in summary.get("bands", ()):
        say(f"{band['name']:16}  {_how_near(band)}")
    say(", ".join(str(out / name) for name in summary["files"]))


def _of_cameras(acquisition: Path, to: str, folder: Path, kernels: tuple[Path, ...]) -> dict[str, Any]:
    """The cameras of an acquisition as they are given; of images only the size is asked for."""
    from sightline.errors import InputError
    from sightline.io.acquisition.load import load_acquisition
    from sightline.io.formats.json_text import json_text
    from sightline.io.results.exports import OF_MOTION, of_cameras, write_export
    from sightline.kinds.kind import EXPORT
    from sightline.writing import whole_text

    if to in OF_MOTION:
        raise InputError(
            f"--to {to} holds what a recovered motion did; give the folder that `recover` wrote for "
            f"{acquisition}"
        )
    exported = of_cameras(load_acquisition(acquisition, look=False, describe=True))
    summary = write_export(to, folder, exported, kernels)
    whole_text(folder / EXPORT, json_text(summary))
    return summary


def _how_near(band: dict[str, Any]) -> str:
    """How far what was written is from the result, in words."""
    if "frame" in band:
        return f"frame {band['frame']}, {band['id']}"
    if "gsd" in band:
        return f"map of {band['gsd']:g} m, {band['crs']}"
    if "lens_px" in band:
        return f"detector line met to {band['lens_px']:.1e} px"
    line, column = band["rms_px"]
    most = max(band["max_px"])
    what = "moved by" if "file" in band else "left"
    return f"{what} {line:.4f} px in lines, {column:.4f} px in columns (rms), {most:.3f} px at most"
