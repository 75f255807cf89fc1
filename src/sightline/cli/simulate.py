"""``sightline simulate``: scenes with known truth, in the files of the command they are made for."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sightline.cli.options import FRAMES_CASE, ORBIT_CASES, STRIP_CASES, Json, Out, Overwrite, Seed
from sightline.cli.output import output_folder
from sightline.cli.simulate_frames import frames
from sightline.cli.simulate_stereo import stereo
from sightline.cli.terminal import print_json, say
from sightline.cli.usable import MOST_COLUMNS, MOST_LINES, refuse_useless_scene, refuse_useless_strip

if TYPE_CHECKING:
    from sightline.geometry.camera import PushbroomCamera

app = typer.Typer(help="Render a scene whose truth is known.", no_args_is_help=True)
app.command("stereo")(stereo)
app.command("frames")(frames)

# Said in --help, which must not wait for the import of the cases.
_LINES, _COLUMNS = "3000; real: 2400; instruments: 1500", "1000; real: 640; instruments: 640"
_MOTIONS = "nominal, late-tone, step, curve, real, other-family, ck, isd, none"


@app.command("line-of-sight")
def line_of_sight(
    out: Out,
    case: Annotated[
        str,
        typer.Option(
            "--case",
            metavar="CASE",
            help=f"One of: {', '.join(STRIP_CASES)}; over a real orbit: {', '.join(ORBIT_CASES)}; "
            f"photographs of a matrix instrument: {FRAMES_CASE}. Made of real data, in the folder that "
            "SIGHTLINE_DATA names: real, other-family.",
        ),
    ] = "nominal",
    seed: Seed = 0,
    lines: Annotated[
        int | None,
        typer.Option("--lines", min=16, max=MOST_LINES, help="Lines of every band.", show_default=_LINES),
    ] = None,
    columns: Annotated[
        int | None,
        typer.Option(
            "--columns", min=16, max=MOST_COLUMNS, help="Columns of every band.", show_default=_COLUMNS
        ),
    ] = None,
    motion: Annotated[
        str | None, typer.Option("--motion", metavar="NAME", help=f"In place of the case's: {_MOTIONS}.")
    ] = None,
    off_nadir: Annotated[
        float | None, typer.Option("--off-nadir", help="Degrees, of the instruments over a real orbit.")
    ] = None,
    dem: Annotated[
        bool, typer.Option("--dem/--no-dem", help="Write the relief, or only how rough it is.")
    ] = True,
    star_tracker: Annotated[bool, typer.Option("--star-tracker", help="Also write its table.")] = False,
    gyro: Annotated[bool, typer.Option("--gyro", help="Also write its table.")] = False,
    control_points: Annotated[
        int,
        typer.Option("--control-points", min=0, max=100_000, help="Also write so many, known to a metre."),
    ] = 0,
    count: Annotated[
        int | None,
        typer.Option("--count", min=2, max=10_000, help="Frames, of case frames.", show_default="10"),
    ] = None,
    interval: Annotated[
        float | None,
        typer.Option("--interval", min=0.0, help="Seconds between frames, of case frames.", show_default="6"),
    ] = None,
    relief_rms: Annotated[
        float | None,
        typer.Option("--relief-rms", min=0.0, help="Metres, of case frames.", show_default="0"),
    ] = None,
    estimate_camera: Annotated[
        bool,
        typer.Option(
            "--estimate-camera", help="Of case frames: leave focal length and distortion to be estimated."
        ),
    ] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Bands of one pushbroom strip: ACQUISITION.toml for `recover`, and truth.csv for `score`."""
    from sightline.errors import InputError
    from sightline.geometry.surface import Plane
    from sightline.simulate.files import write_strip
    from sightline.simulate.scenarios import line_of_sight_case, planned_cameras
    from sightline.simulate.strip_options import CASE_OPTIONS, StripOptions

    begin = time.perf_counter()
    cases = (*STRIP_CASES, *ORBIT_CASES, FRAMES_CASE)
    if case not in cases:
        raise InputError(f"unknown case: got {case!r}; allowed are {', '.join(cases)}")
    options: dict[str, Any] = {"lines": lines, "columns": columns, "motion": motion}
    given = {k: v for k, v in options.items() if v is not None}
    photographs = {"count": count, "interval": interval, "relief_rms": relief_rms}
    asked = {k: v for k, v in photographs.items() if v is not None}
    if case == FRAMES_CASE:
        others = {f"--{name}": True for name in given}
        others |= {"--off-nadir": off_nadir is not None, "--no-dem": not dem, "--gyro": gyro}
        others |= {"--star-tracker": star_tracker, "--control-points": control_points > 0}
        _refuse(others, f"case {case!r}")
        names = _photographs(seed, asked, estimate_camera, out, overwrite)
        _say(out, names, time.perf_counter() - begin, as_json)
        return
    others = {f"--{name.replace('_', '-')}": True for name in asked}
    _refuse(others | {"--estimate-camera": estimate_camera}, f"case {case!r}; it is for: {FRAMES_CASE}")
    if case in ORBIT_CASES:
        others = {"--no-dem": not dem, "--star-tracker": star_tracker, "--gyro": gyro}
        others["--control-points"] = control_points > 0
        _refuse(others, f"case {case!r}, which has no relief and no sensors")
        if off_nadir is not None:
            given["off_nadir"] = math.radians(off_nadir)
        names = _instrument(case, seed, given, out, overwrite)
        _say(out, names, time.perf_counter() - begin, as_json)
        return
    if off_nadir is not None:
        raise InputError(f"--off-nadir is not for case {case!r}; it is for: {', '.join(ORBIT_CASES)}")
    defaults = StripOptions(**CASE_OPTIONS[case])
    size = lines or defaults.lines, columns or defaults.columns

    def cameras_of(lines: int, columns: int) -> tuple[PushbroomCamera, ...]:
        return planned_cameras(case, seed, lines=lines, columns=columns)

    with output_folder(out, overwrite=overwrite) as folder:
        refuse_useless_strip(cameras_of, Plane(0.0), size)
        scenario = line_of_sight_case(case, seed, **given)
        written = write_strip(
            scenario, folder, dem=dem, star_tracker=star_tracker, gyro=gyro, control_points=control_points
        )
        names = list(written)
    _say(out, names, time.perf_counter() - begin, as_json)


def _instrument(case: str, seed: int, given: dict[str, Any], out: Path, overwrite: bool) -> list[str]:
    """Render a strip of one of the instruments over a real orbit; the names of its files."""
    from sightline.geometry.earth import WGS84
    from sightline.geometry.surface import Ellipsoid
    from sightline.simulate.instrument_files import write_instrument
    from sightline.simulate.instruments import INSTRUMENT_OPTIONS, InstrumentOptions, instrument_case

    options = InstrumentOptions(**{**INSTRUMENT_OPTIONS[case], **given})

    def cameras_of(lines: int, columns: int) -> tuple[PushbroomCamera, ...]:
        return instrument_case(case, seed, **{**given, "lines": lines, "columns": columns}).nominal_cameras

    with output_folder(out, overwrite=overwrite) as folder:
        size = options.lines, options.columns
        refuse_useless_strip(cameras_of, Ellipsoid(*WGS84, 0.0), size, options.pairs)
        return list(write_instrument(instrument_case(case, seed, **given), folder))


def _photographs(
    seed: int, given: dict[str, Any], estimate_camera: bool, out: Path, overwrite: bool
) -> list[str]:
    """Render frames of a matrix instrument; the names of their files."""
    from sightline.simulate.files import write_frames
    from sightline.simulate.frames import frames_case

    with output_folder(out, overwrite=overwrite) as folder:
        written = write_frames(frames_case(seed, **given), folder, estimate_camera=estimate_camera)
        asked = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in given.items())
        refuse_useless_scene(folder / "acquisition.toml", asked or "these options")
        return list(written)


def _refuse(asked: dict[str, bool], case: str) -> None:
    """Refuse the first option that was `asked` for and is not for this `case`."""
    from sightline.errors import InputError

    for name, given in asked.items():
        if given:
            raise InputError(f"{name} is not for {case}")


def _say(out: Path, names: list[str], seconds: float, as_json: bool) -> None:
    if as_json:
        print_json({"folder": out, "files": names, "wall_seconds": round(seconds, 3)})
    else:
        say(f"rendered in {seconds:.1f} s: {out / 'acquisition.toml'}")
        say(f"next: sightline recover {out / 'acquisition.toml'} --out RESULT")
