"""``sightline noise``: the noise law and the columns of a detector, from its raw images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json, Out, Overwrite
from sightline.execution import Progress

if TYPE_CHECKING:
    from sightline.applications.detector_noise import DetectorNoise

#: What it always writes.
_WRITES = ("noise.toml", "columns.csv", "tdi.toml", "summary.json")


def noise(
    raw: Annotated[
        list[Path],
        typer.Argument(
            metavar="RAW...",
            help="Raw images of one detector: HiRISE EDRs with what was read beside them, or plain rasters "
            "or .npy files, neither resampled nor filtered; frames of even light, two or more of an "
            "exposure, are compared with one another (photon transfer).",
        ),
    ],
    out: Out,
    dark: Annotated[
        list[Path] | None,
        typer.Option(
            "--dark",
            metavar="FILE",
            help="Frame without light, for plain images; may be given several times, also as a pattern in "
            "quotes. As many as RAW: each of the exposure of its image.",
        ),
    ] = None,
    dark_level: Annotated[
        float | None,
        typer.Option(
            "--dark-level", metavar="DN", help="In its place: the level without light of all columns."
        ),
    ] = None,
    electrons_per_dn: Annotated[
        float | None,
        typer.Option(
            "--electrons-per-dn",
            metavar="GAIN",
            help="The conversion gain, from somewhere else: noise in electrons. Without it in DN, but of "
            "photon transfer, which measures it.",
        ),
    ] = None,
    stages: Annotated[
        int | None,
        typer.Option("--stages", metavar="N", help="TDI stages summed in plain images (1); EDRs say theirs."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    r"""Estimate a detector's noise law and its columns from raw images, as the \[noise] that `tdi` reads."""
    import time

    from sightline.cli.output import output_folder
    from sightline.cli.terminal import answered, progress, say
    from sightline.kinds.noise import Noise

    _check(dark_level, electrons_per_dn, stages)
    dark = [path for one in dark or [] for path in _matching(one)]
    begun = time.perf_counter()
    with (
        output_folder(out, overwrite=overwrite, writes=_WRITES) as folder,
        progress() as report,
    ):
        found = estimate(raw, dark, report, dark_level, electrons_per_dn, stages)
        inputs = [*raw, *dark]
        summary = Noise().render(found, folder, report, begun, inputs=inputs)
    if answered(summary, as_json):
        return
    tell(found, summary)
    say(f"{out / 'noise.toml'}, {out / 'columns.csv'}, {out / 'tdi.toml'}")


def _matching(path: Path) -> list[Path]:
    """The files that a pattern names, in order; any other path itself."""
    import glob

    from sightline.access import remote_name
    from sightline.errors import InputError

    if remote_name(path) is not None or path.exists() or not glob.has_magic(str(path)):
        return [path]
    found = sorted(glob.glob(str(path)))
    if not found:
        raise InputError(f"--dark {path}: no file has such a name; give frames without light")
    return [Path(one) for one in found]


def _check(dark_level: float | None, electrons_per_dn: float | None, stages: int | None) -> None:
    """Refuse numbers that cannot be, before anything is read."""
    import math

    from sightline.errors import InputError

    if dark_level is not None and not abs(dark_level) <= 1e9:
        raise InputError(f"--dark-level is {dark_level:g}; a number of DN from -1e9 to 1e9 is allowed")
    if electrons_per_dn is not None and not 0.0 < electrons_per_dn < math.inf:
        raise InputError(f"--electrons-per-dn is {electrons_per_dn:g}; a number above 0 is allowed")
    if stages is not None and stages < 1:
        raise InputError(f"--stages is {stages}; 1 or more are allowed")


def estimate(
    raw: list[Path],
    dark: list[Path],
    report: Progress,
    dark_level: float | None = None,
    electrons_per_dn: float | None = None,
    stages: int | None = None,
) -> DetectorNoise:
    """The noise of the detector that `raw` are images of."""
    from sightline.access import check_file, remote_name
    from sightline.errors import InputError
    from sightline.io.formats.hirise_edr import is_hirise

    for path in (*raw, *dark):
        if remote_name(path) is None:
            check_file(path, "give raw images of the detector")
    for number, path in enumerate(raw):
        if path in raw[:number]:
            raise InputError(f"{path} is given twice: the same noise would count as more of it")
    edr = [remote_name(path) is None and is_hirise(path) for path in raw]
    if not any(edr):
        return _of_plain(raw, dark, report, dark_level, electrons_per_dn, stages or 1)
    if not all(edr):
        raise InputError(
            f"{raw[edr.index(False)]} is no HiRISE EDR, {raw[edr.index(True)]} is one; give images of one "
            "detector"
        )
    if dark or dark_level is not None or stages is not None:
        raise InputError(
            "--dark, --dark-level and --stages are for plain images; HiRISE EDRs say them: leave them out"
        )
    return _of_edrs(raw, report, electrons_per_dn)


def _of_edrs(raw: list[Path], report: Progress, electrons_per_dn: float | None) -> DetectorNoise:
    """Noise of HiRISE channels."""
    from sightline.applications.detector_noise import detector_noise, strip_image_noise
    from sightline.errors import InputError, naming
    from sightline.io.formats.hirise_edr import read_hirise_edr

    images, settings = [], {}
    for number, path in enumerate(raw):
        report("reading and estimating", number, len(raw))
        edr = read_hirise_edr(path)
        settings[edr.stages, edr.binning] = path
        if len(settings) > 1:
            said = "; ".join(f"{p}: {n} stages, binning {b}" for (n, b), p in settings.items())
            raise InputError(f"the images are of different settings ({said}); give those of one at a time")
        with naming(path):
            images.append(strip_image_noise(edr.product, edr.pixels(), edr.stages, electrons_per_dn))
    ((number_of_stages, _),) = settings
    return detector_noise(images, stages=number_of_stages, electrons_per_dn=electrons_per_dn)


def _of_plain(
    raw: list[Path],
    dark: list[Path],
    report: Progress,
    dark_level: float | None,
    electrons_per_dn: float | None,
    stages: int,
) -> DetectorNoise:
    """Noise of plain images."""
    from sightline.applications.detector_noise import dark_noise, detector_noise, plain_image_noise
    from sightline.applications.photon_transfer import even_exposures, photon_transfer
    from sightline.errors import InputError, naming
    from sightline.io.formats.images import open_image

    if dark and dark_level is not None:
        raise InputError("--dark and --dark-level both say the level without light; give one of them")
    sources = [open_image(path) for path in raw]
    without = [open_image(path) for path in dark]
    names = [path.name for path in raw]
    even = even_exposures(names, sources, without, dark_level)
    if even is not None:
        return photon_transfer(
            names,
            sources,
            even,
            without,
            dark_level,
            report,
            stages=stages,
            electrons_per_dn=electrons_per_dn,
        )
    frames = None
    if dark:
        report("frames without light")
        with naming(dark[0]):
            frames = dark_noise(without)
    images = []
    for number, path in enumerate(raw):
        report("reading and estimating", number, len(raw))
        with naming(path):
            images.append(plain_image_noise(path.name, sources[number], frames, dark_level))
    return detector_noise(images, frames, stages=stages, electrons_per_dn=electrons_per_dn)


def tell(found: DetectorNoise, summary: dict[str, Any]) -> None:
    """The law in a few lines."""
    from sightline.cli.terminal import say

    for figure in found.figures:
        say(str(figure))
    law = ", ".join(f"{key} {value:.4g}" for key, value in summary["noise"].items())
    say(f"[noise] of a TDI line, signals in {found.unit}: {law}")
    for name, one in found.transfer.alike.items() if found.transfer is not None else ():
        unit = {"conversion": "DN/e-", "gain": "", "offset": "DN"}[name]
        compared = f"chi-square {one.chi_square:.0f} of {one.freedom}"
        if one.alike:
            said = f"columns alike in {name}: {compared}; they differ by less than {one.upper:.2g} {unit}"
        else:
            said = f"columns differ in {name}: {compared}; by {one.scatter:.2g} {unit}"
        say(f"{said.rstrip()} rms")
    flagged = ", ".join(
        f"{count} {name.replace('_', ' ')}" for name, count in summary["columns"]["flagged"].items() if count
    )
    say(f"{summary['columns']['count']} columns, {flagged or 'none flagged'}")
