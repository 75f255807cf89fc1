"""``sightline simulate stereo``: a pass of synchronous cameras with known truth, in the files of `orient`."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from sightline.cli.options import STEREO_CASES, Json, Out, Overwrite, Seed
from sightline.cli.output import output_folder
from sightline.cli.terminal import print_json, say
from sightline.cli.usable import least_points, refuse_useless_pass, refuse_useless_scene
from sightline.geometry.units import ARCSEC

_DEGREE = math.pi / 180.0
#: What an angle on the command line is multiplied by, by the name of the option.
_UNITS = {
    **dict.fromkeys(
        ("inclination", "latitude", "longitude", "node_offset", "inclination_offset", "fov"), _DEGREE
    ),
    **dict.fromkeys(("sigma_attitude", "error", "drift"), ARCSEC),
}
#: m; side of the ground under frames: those that look obliquely reach far beyond the scene.
_FRAMED_GROUND = 60e3


def _option(flag: str, text: str) -> Any:
    """An option that is the case's own unless it is given."""
    return typer.Option(flag, help=text, show_default="the case's")


Number: TypeAlias = float | None
Count: TypeAlias = int | None
Word: TypeAlias = str | None


def stereo(
    out: Out,
    case: Annotated[
        str, typer.Option("--case", metavar="CASE", help=f"One of: {', '.join(STEREO_CASES)}.")
    ] = STEREO_CASES[0],
    seed: Seed = 0,
    altitude: Annotated[Number, _option("--altitude", "Metres above the equatorial radius.")] = None,
    inclination: Annotated[Number, _option("--inclination", "Degrees.")] = None,
    latitude: Annotated[Number, _option("--latitude", "Degrees, passed at the middle of the pass.")] = None,
    longitude: Annotated[Number, _option("--longitude", "Degrees, likewise.")] = None,
    separation: Annotated[Number, _option("--separation", "Seconds from the first to the last.")] = None,
    cameras: Annotated[Count, _option("--cameras", "Two or more.")] = None,
    leader: Annotated[Count, _option("--leader", "Camera that flies ahead: 1, or the last.")] = None,
    node_offset: Annotated[
        Number, _option("--node-offset", "Degrees between the nodes of the first and the last orbit.")
    ] = None,
    inclination_offset: Annotated[
        Number, _option("--inclination-offset", "Degrees between their inclinations.")
    ] = None,
    cross_track: Annotated[
        Number, _option("--cross-track", "Metres, of the aim point to the left of the track.")
    ] = None,
    window: Annotated[Number, _option("--window", "Seconds of imaging.")] = None,
    shots: Annotated[Count, _option("--shots", "Of each camera.")] = None,
    offset: Annotated[Number, _option("--offset", "Seconds of the window after the middle.")] = None,
    earth: Annotated[Word, _option("--earth", "sphere or wgs84.")] = None,
    fov: Annotated[Number, _option("--fov", "Degrees across the columns.")] = None,
    columns: Annotated[Count, _option("--columns", "Of a frame.")] = None,
    lines: Annotated[Count, _option("--lines", "Of a frame; 0: as many as columns.")] = None,
    focal_error: Annotated[
        Number, _option("--focal-error", "Relative error of the focal length told, to be estimated.")
    ] = None,
    points: Annotated[Count, _option("--points", "On the ground.")] = None,
    scene_size: Annotated[Number, _option("--scene-size", "Metres, side of their square.")] = None,
    relief: Annotated[Word, _option("--relief", "none, smooth, white, spectrum or dem.")] = None,
    relief_range: Annotated[Number, _option("--relief-range", "Metres from lowest to highest.")] = None,
    dem_file: Annotated[
        Word,
        _option("--dem-file", "Raster of heights for relief dem; else Mont Ventoux, from SIGHTLINE_DATA."),
    ] = None,
    dem_sigma: Annotated[
        Number, _option("--dem-sigma", "Metres; above 0 the relief is written as a DEM, that far wrong.")
    ] = None,
    control_points: Annotated[
        int,
        typer.Option("--control-points", min=0, max=100_000, help="Also write so many, known to a metre."),
    ] = 0,
    sigma_px: Annotated[Number, _option("--sigma-px", "Noise of matches.")] = None,
    sigma_position: Annotated[Number, _option("--sigma-position", "Metres.")] = None,
    sigma_attitude: Annotated[Number, _option("--sigma-attitude", "Arcseconds, shot to shot.")] = None,
    noise_scale: Annotated[Number, _option("--noise-scale", "Noise drawn over noise told.")] = None,
    attitude_knowledge: Annotated[
        Word, _option("--attitude-knowledge", "independent or from-position.")
    ] = None,
    jitter: Annotated[Word, _option("--jitter", "white or harmonic.")] = None,
    jitter_frequency: Annotated[Number, _option("--jitter-frequency", "Hz, of harmonic jitter.")] = None,
    jitter_shared: Annotated[
        bool | None,
        _option("--jitter-shared/--jitter-apart", "Whether the mirrors of all cameras swing together."),
    ] = None,
    error: Annotated[Number, _option("--error", "Arcseconds, constant errors about each axis.")] = None,
    signs: Annotated[Word, _option("--signs", "Of the constant errors: s2 or random.")] = None,
    drift: Annotated[Number, _option("--drift", "Arcseconds per second, of the errors.")] = None,
    mismatch_share: Annotated[Number, _option("--mismatch-share", "Share of gross mismatches.")] = None,
    match_share: Annotated[Number, _option("--match-share", "Share of points found in a shot.")] = None,
    track_shots: Annotated[
        tuple[int, int] | None, _option("--track-shots", "Fewest and most shots a point is tracked over.")
    ] = None,
    missing_images: Annotated[Number, _option("--missing-images", "Share never taken.")] = None,
    unpaired: Annotated[
        bool | None, _option("--unpaired/--paired", "Tell sightings one by one, those of one camera too.")
    ] = None,
    scene_seed: Annotated[
        Count, _option("--scene-seed", "Of ground and errors; below 0: the same as the seed.")
    ] = None,
    images: Annotated[
        bool,
        typer.Option("--images", help="Write rendered frames, in which points are yet to be found."),
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Shots of synchronous cameras and points found in them: STEREO.toml for `orient`, and the truth."""
    given = {name: value for name, value in locals().items() if value is not None}
    own = ("out", "case", "seed", "control_points", "images", "overwrite", "as_json")
    options = {name: _si(name, value) for name, value in given.items() if name not in own}
    from sightline.simulate.stereo import stereo_case, stereo_options
    from sightline.simulate.stereo_files import write_stereo

    def fewest() -> str:
        """More points, where those are too few."""

        def write(place: Path, count: int) -> None:
            more = stereo_case(case, seed, **{**options, "points": count})
            write_stereo(more, place, control_points=control_points, images=False)

        return "" if images else least_points(folder, write, stereo_options(case, **options).points)

    begin = time.perf_counter()
    if images:
        options.setdefault("ground_size", _FRAMED_GROUND)
    with output_folder(out, overwrite=overwrite) as folder:
        refuse_useless_pass(stereo_options(case, **options), images=images)
        scenario = stereo_case(case, seed, **options)
        names = list(write_stereo(scenario, folder, control_points=control_points, images=images))
        refuse_useless_scene(folder / "stereo.toml", "these options", fewest)
    seconds = time.perf_counter() - begin
    if as_json:
        print_json({"folder": out, "files": names, "wall_seconds": round(seconds, 3)})
    else:
        say(f"written in {seconds:.1f} s: {out / 'stereo.toml'}")
        say(f"next: sightline orient {out / 'stereo.toml'} --out RESULT")


def _si(name: str, value: Any) -> Any:
    """An option in SI units and radians."""
    return value * _UNITS[name] if name in _UNITS else value
