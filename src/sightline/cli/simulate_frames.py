"""``sightline simulate frames``: a flight of a filter camera with known truth."""

from __future__ import annotations

import math
import time
from typing import Annotated, Any, TypeAlias

import typer

from sightline.cli.options import SEQUENCE_CASES, Json, Out, Overwrite, Seed
from sightline.cli.output import output_folder
from sightline.cli.terminal import print_json, progress, say
from sightline.cli.usable import refuse_useless_flight, refuse_useless_scene

#: Options in degrees on the command line.
_DEGREES = ("jitter", "attitude_sigma", "attitude_bias_sigma")
#: Options that name frames, and those that name stretches of them.
_LISTS, _STRETCHES = ("missing", "unreadable", "blurred"), ("water",)
_MOST_FRAMES = 1_000_000


def _option(flag: str, text: str) -> Any:
    """An option that is the case's own unless it is given."""
    return typer.Option(flag, help=text, show_default="the case's")


Number: TypeAlias = float | None
Count: TypeAlias = int | None
Word: TypeAlias = str | None


def frames(
    out: Out,
    case: Annotated[
        str, typer.Option("--case", metavar="CASE", help=f"One of: {', '.join(SEQUENCE_CASES)}.")
    ] = SEQUENCE_CASES[0],
    seed: Seed = 0,
    frames: Annotated[Count, _option("--frames", "Of every flight line.")] = None,
    shape: Annotated[tuple[int, int] | None, _option("--shape", "Lines and columns of a frame.")] = None,
    focal_length_px: Annotated[Number, _option("--focal-length-px", "Pixels.")] = None,
    principal_point_px: Annotated[
        tuple[float, float] | None, _option("--principal-point-px", "Line and column.")
    ] = None,
    distortion: Annotated[
        Word, _option("--distortion", "k1,k2,p1,p2,k3 in normalised coordinates, as many as wanted.")
    ] = None,
    focal_error: Annotated[
        Number,
        _option("--focal-error", "Relative error of the focal length told, with a sigma of that size."),
    ] = None,
    altitude: Annotated[Number, _option("--altitude", "Metres above the mean ground.")] = None,
    frame_rate: Annotated[Number, _option("--frame-rate", "Frames per second.")] = None,
    overlap: Annotated[Number, _option("--overlap", "Of successive frames, 0-1.")] = None,
    flight_lines: Annotated[Count, _option("--flight-lines", "Flown to and fro.")] = None,
    cross_lines: Annotated[Count, _option("--cross-lines", "Flown afterwards, across the others.")] = None,
    side_overlap: Annotated[Number, _option("--side-overlap", "Of neighbouring lines, 0-1.")] = None,
    readout_time: Annotated[
        Number, _option("--readout-time", "Seconds, of a rolling shutter; 0: none.")
    ] = None,
    filter: Annotated[Word, _option("--filter", "lvf, stepwise, mosaic, rgb or pan.")] = None,
    wavelengths_nm: Annotated[
        tuple[float, float] | None, _option("--wavelengths-nm", "Shortest and longest.")
    ] = None,
    fwhm_nm: Annotated[Number, _option("--fwhm-nm", "Width of a filter's pass-band.")] = None,
    bands: Annotated[
        Count, _option("--bands", "Groups of lines that are told one wavelength; 0: a wavelength per line.")
    ] = None,
    pattern: Annotated[Count, _option("--pattern", "Side of the mosaic's pattern, px.")] = None,
    jitter: Annotated[
        Number,
        _option("--jitter", "Degrees about each axis, that slerp leaves between every 20th attitude."),
    ] = None,
    position_jitter: Annotated[Number, _option("--position-jitter", "Metres rms per axis.")] = None,
    position_sigma: Annotated[
        Number,
        _option(
            "--position-sigma", "Metres, noise of positions; 0: none told (control points are needed then)."
        ),
    ] = None,
    position_bias_sigma: Annotated[
        Number, _option("--position-bias-sigma", "Metres, of their constant error.")
    ] = None,
    attitude_sigma: Annotated[
        Number, _option("--attitude-sigma", "Degrees, noise of attitudes; 0: none told.")
    ] = None,
    attitude_bias_sigma: Annotated[
        Number, _option("--attitude-bias-sigma", "Degrees, of their constant error.")
    ] = None,
    relief: Annotated[Number, _option("--relief", "Half its range over the altitude.")] = None,
    relief_scale: Annotated[
        Number, _option("--relief-scale", "Altitudes, beyond which hills grow no more.")
    ] = None,
    spectra: Annotated[
        Word,
        _option(
            "--spectra",
            "Of the ground: law, rededge or landsat (real), or auto (of a real texture, else law).",
        ),
    ] = None,
    texture: Annotated[Word, _option("--texture", "spectrum, or a real scene: rededge, landsat.")] = None,
    contrast: Annotated[
        Number, _option("--contrast", "Of the brightness that all wavelengths share.")
    ] = None,
    mtf_nyquist: Annotated[Number, _option("--mtf-nyquist", "At half a cycle per pixel.")] = None,
    snr: Annotated[Number, _option("--snr", "Of the mean ground.")] = None,
    bits: Annotated[Count, _option("--bits", "Of a pixel; up to 8 are written in 8.")] = None,
    water: Annotated[
        Word, _option("--water", "Frames of the first line that see but water, as 20-40,90-99.")
    ] = None,
    missing: Annotated[Word, _option("--missing", "Frames never delivered, as 3,20-40.")] = None,
    unreadable: Annotated[Word, _option("--unreadable", "Frames whose files are cut short.")] = None,
    blurred: Annotated[Word, _option("--blurred", "Frames out of focus.")] = None,
    blur_px: Annotated[Number, _option("--blur-px", "Sigma of their blur.")] = None,
    dem: Annotated[
        bool, typer.Option("--dem/--no-dem", help="Tell the relief, or only its mean and scatter.")
    ] = False,
    image_format: Annotated[str, typer.Option("--format", help="Of the images: tif or png.")] = "tif",
    truth_bands: Annotated[
        int, typer.Option("--truth-bands", min=0, max=200, help="Bands of truth-bands.tif; 0: not written.")
    ] = 5,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Frames of an area detector behind a filter: SEQUENCE.toml, and the truth."""
    given = {name: value for name, value in locals().items() if value is not None}
    own = ("out", "case", "seed", "dem", "image_format", "truth_bands", "overwrite", "as_json")
    options = {name: _parsed(name, value) for name, value in given.items() if name not in own}
    from sightline.errors import InputError
    from sightline.simulate.sequence import sequence_case, sequence_options
    from sightline.simulate.sequence_files import FORMATS, write_sequence

    if image_format not in FORMATS:
        raise InputError(f"--format must be one of {', '.join(FORMATS)}, got {image_format!r}")
    begin = time.perf_counter()
    with output_folder(out, overwrite=overwrite) as folder, progress() as report:
        report("drawing the flight and the ground")
        refuse_useless_flight(sequence_options(case, **options))
        scenario = sequence_case(case, seed, **options)
        report(f"rendering {len(scenario.frames)} frames, and the truth")
        written = write_sequence(
            scenario, folder, image_format=image_format, dem=dem, truth_bands=truth_bands
        )
        if scenario.options.position_sigma > 0.0:  # else it is the user who will add control points
            refuse_useless_scene(folder / "sequence.toml", "these options")
    seconds = time.perf_counter() - begin
    if as_json:
        print_json({"folder": out, "files": list(written), "wall_seconds": round(seconds, 3)})
    else:
        say(f"rendered {len(scenario.frames)} frames in {seconds:.1f} s: {out / 'sequence.toml'}")
        say(f"next: sightline georeference {out / 'sequence.toml'} --out DIR")


def _parsed(name: str, value: Any) -> Any:
    """An option in SI units, radians and numbers of frames."""
    if name in _DEGREES:
        return math.radians(value)
    if name == "distortion":
        return _numbers(name, value)
    if name in _STRETCHES:
        return tuple(_stretches(name, value))
    if name in _LISTS:
        return tuple(frame for a, b in _stretches(name, value) for frame in range(a, b + 1))
    return value


def _numbers(name: str, text: str) -> tuple[float, ...]:
    """The numbers of "-0.1,0.02"."""
    from sightline.errors import InputError

    try:
        return tuple(float(part) for part in filter(None, text.split(",")))
    except ValueError:
        raise InputError(f"--{name} must be numbers as -0.1,0.02, got {text!r}") from None


def _stretches(name: str, text: str) -> list[tuple[int, int]]:
    """First and last of each part of "3,20-40"."""
    from sightline.errors import InputError

    out = []
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        try:
            stretch = int(first), int(last or first)
        except ValueError:
            stretch = 1, 0
        if not 0 <= stretch[0] <= stretch[1] < _MOST_FRAMES:
            raise InputError(f"--{name} must list frames as 3,20-40, got {text!r}")
        out.append(stretch)
    return out
