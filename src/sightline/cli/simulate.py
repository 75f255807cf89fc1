"""``sightline simulate``: scenes with known truth, in the files of the command they are made for."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand

from sightline.cli.options import (
    ACQUISITION_CASE,
    FRAMES_CASE,
    ORBIT_CASES,
    SEQUENCE_CASES,
    SPINNING_CASES,
    STEREO_CASES,
    STRIP_CASES,
    Json,
    Out,
    Overwrite,
    examples,
)
from sightline.cli.output import output_folder
from sightline.cli.terminal import announce, complain, print_json, progress, say
from sightline.cli.usable import (
    least_points,
    refuse_useless_flight,
    refuse_useless_pass,
    refuse_useless_scene,
    refuse_useless_strip,
)
from sightline.execution import Progress, steps_of

if TYPE_CHECKING:
    from sightline.geometry.camera import PushbroomCamera
    from sightline.io.scene.recipe import SceneRecipe
    from sightline.simulate.strip_options import StripOptions

# Named through typer, because its newer versions carry a click of their own.
_UsageError: Any = typer.BadParameter.__base__


class _Command(TyperCommand):
    """A command that says of an option that it does not have whether it is a key of its scenes."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As click does; an option that is a key is answered with how a key is given."""
        try:
            return super().parse_args(ctx, args)
        except _UsageError as error:
            option = getattr(error, "option_name", None) or ""
            key = option.lstrip("-").replace("-", "_")
            said = _keys_of(str(self.name))
            for name in (key, key.removeprefix("no_")):
                if name in said:
                    error.message = f"{option} is a key of the scene: --set {name}=VALUE ({said[name]})"
                    error.possibilities = ()
                    break
            raise


def _keys_of(kind: str) -> dict[str, str]:
    """Keys of the scenes of a kind, with what they mean."""
    from sightline.io.scene.models import FAMILIES, scene_model

    return {
        name: field.description or ""
        for family in FAMILIES
        if family.kind == kind
        for name, field in scene_model(family.name).model_fields.items()
    }


app = typer.Typer(help="Render a scene whose truth is known.", no_args_is_help=True)

#: Said in --help, which must not wait for the import of the cases.
_LINES, _COLUMNS = (
    "3000; real: 2400; instruments, --acquisition: 1500",
    "1000; real: 640; instruments, --acquisition: 640",
)
_CASE_OWN = "the case's"

SceneFlag = Annotated[
    Path | None,
    typer.Option(
        "--scene",
        metavar="SCENE.toml",
        help="Keys in place of the case's options, as the scene.toml that every scene has beside it.",
    ),
]
SeedFlag = Annotated[
    int | None,
    typer.Option(
        "--seed", min=0, max=2**63 - 1, help="Same seed, same scene, bit for bit.", show_default="0"
    ),
]


def _case(*cases: str, more: str = "") -> Any:
    """The option --case, whose first is the default."""
    return typer.Option(
        "--case", metavar="CASE", help=f"One of: {', '.join(cases)}{more}.", show_default=cases[0]
    )


def _size(flag: str, text: str, default: str = _CASE_OWN) -> Any:
    """A number that is the case's own unless it is given."""
    return typer.Option(flag, help=text, show_default=default)


def _settings(example: str) -> Any:
    """The option --set, with keys that scenes of the kind have."""
    return typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help=f"Any key of SCENE.toml, such as {example}; may be repeated. `sightline schema scene` "
        "describes them.",
    )


Settings: TypeAlias = list[str] | None
Count: TypeAlias = int | None
Word: TypeAlias = str | None


@app.command("line-of-sight", cls=_Command, epilog=examples("simulate line-of-sight"))
def line_of_sight(
    out: Out,
    case: Annotated[
        Word,
        _case(
            *STRIP_CASES,
            more=" (hard: relief, clouds, SNR 40; pan-xs: a panchromatic band and three of four times its "
            f"pixels); over a real orbit: {', '.join(ORBIT_CASES)}; photographs of a matrix instrument: "
            f"{FRAMES_CASE}; raw images of a spinning camera, for `init`: {', '.join(SPINNING_CASES)}. "
            "Made of real data, in the folder that SIGHTLINE_DATA names: real, other-family",
        ),
    ] = None,
    acquisition: Annotated[
        Path | None,
        typer.Option(
            "--acquisition",
            metavar="ACQUISITION.toml",
            help="In place of a case: render for the cameras of its bands, a random motion on top. --lines, "
            "--columns: the first of larger images.",
        ),
    ] = None,
    seed: SeedFlag = None,
    lines: Annotated[Count, _size("--lines", "Of every band.", _LINES)] = None,
    columns: Annotated[Count, _size("--columns", "Of every band.", _COLUMNS)] = None,
    frames: Annotated[Count, _size("--frames", "Photographs, of case frames.", "10")] = None,
    scene: SceneFlag = None,
    settings: Annotated[Settings, _settings("snr=40 or cloud_banks=[[100,50]]")] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Bands of one pushbroom strip: ACQUISITION.toml for `recover`, and truth.csv for `score`."""
    flags = {"case": case, "seed": seed, "lines": lines, "columns": columns, "frames": frames}
    if acquisition is not None:
        if case is not None:
            raise typer.BadParameter(f"--case {case} and --acquisition are both given; keep one of them")
        flags |= {"case": ACQUISITION_CASE, "acquisition": str(acquisition)}
    _simulate("line-of-sight", out, scene, settings, flags, overwrite, as_json)


@app.command("stereo", cls=_Command, epilog=examples("simulate stereo"))
def stereo(
    out: Out,
    case: Annotated[Word, _case(*STEREO_CASES)] = None,
    seed: SeedFlag = None,
    lines: Annotated[Count, _size("--lines", "Of a frame; 0: as many as columns.")] = None,
    columns: Annotated[Count, _size("--columns", "Of a frame.")] = None,
    shots: Annotated[Count, _size("--shots", "Of each camera.")] = None,
    points: Annotated[Count, _size("--points", "On the ground.")] = None,
    scene: SceneFlag = None,
    settings: Annotated[Settings, _settings("sigma_px=.5 or images=true")] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Shots of synchronous cameras and points found in them: STEREO.toml for `orient`, and the truth."""
    flags = {"case": case, "seed": seed, "lines": lines, "columns": columns, "shots": shots, "points": points}
    _simulate("stereo", out, scene, settings, flags, overwrite, as_json)


@app.command("frames", cls=_Command, epilog=examples("simulate frames"))
def frames(
    out: Out,
    case: Annotated[Word, _case(*SEQUENCE_CASES)] = None,
    seed: SeedFlag = None,
    lines: Annotated[Count, _size("--lines", "Of a frame.")] = None,
    columns: Annotated[Count, _size("--columns", "Of a frame.")] = None,
    frames: Annotated[Count, _size("--frames", "Of every flight line.")] = None,
    scene: SceneFlag = None,
    settings: Annotated[Settings, _settings("snr=40 or missing=3,20-40")] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Frames of an area detector behind a filter: SEQUENCE.toml for `georeference`, and the truth."""
    flags = {"case": case, "seed": seed, "lines": lines, "columns": columns, "frames": frames}
    _simulate("frames", out, scene, settings, flags, overwrite, as_json)


def _simulate(
    kind: str,
    out: Path,
    scene: Path | None,
    settings: list[str] | None,
    flags: dict[str, Any],
    overwrite: bool,
    as_json: bool,
) -> None:
    """Make the scene that is asked for, and write it with the file it can be made again from."""
    from sightline.errors import failing_numbers, naming
    from sightline.io.scene.cost import scene_cost
    from sightline.io.scene.recipe import SCENE, read_recipe, write_recipe
    from sightline.version import VERSION

    begin = time.perf_counter()
    with output_folder(out, overwrite=overwrite, writes=[SCENE]) as folder, progress() as report:
        # read here, that files of the scene are known as inputs and are not replaced
        recipe = read_recipe(kind, scene, settings or (), flags)
        with naming(scene) if scene else nullcontext(), failing_numbers("the scene"):
            cost = scene_cost(recipe)
            cost.check()
            announce(cost)
            names = _made(recipe, folder, out, report)
        names.append(write_recipe(folder / SCENE, recipe).name)
    seconds = round(time.perf_counter() - begin, 3)
    if as_json:
        of = {"kind": kind, "case": recipe.case, "seed": recipe.seed, "version": VERSION}
        print_json({**of, "folder": out, "files": names, "wall_seconds": seconds})
        return
    # a raw image, its metadata and those of another are a product
    command, *files = ("init", *names[:3]) if recipe.family.name == "spinning" else _NEXT[kind]
    say(f"rendered in {seconds:.1f} s: {out / files[0]}")
    say(f"next: sightline {command} {' '.join(str(out / file) for file in files)} --out RESULT")


def _made(recipe: SceneRecipe, folder: Path, out: Path, report: Progress) -> list[str]:
    """The scene in `folder`, whose files will lie in `out`; their names."""
    if recipe.family.name == "acquired":
        return _acquired(recipe, folder, out, report)
    return _MAKERS[recipe.family.name](recipe, folder, report)


#: What reads the scenes of each kind.
_NEXT = {
    "line-of-sight": ("recover", "acquisition.toml"),
    "stereo": ("orient", "stereo.toml"),
    "frames": ("georeference", "sequence.toml"),
}


#: px; beyond it the blur of TDI that is out of step is said: contrast at Nyquist is a tenth less.
_SLIP = 0.5


def _strip(recipe: SceneRecipe, folder: Path, report: Progress) -> list[str]:
    """A strip over a flat world; the names of its files."""
    from sightline.geometry.surface import Plane
    from sightline.simulate.files import write_strip
    from sightline.simulate.scenarios import line_of_sight_case, planned_cameras

    case, seed, options = recipe.case, recipe.seed, recipe.options

    def cameras_of(lines: int, columns: int) -> tuple[PushbroomCamera, ...]:
        return planned_cameras(case, seed, **{**recipe.given, "lines": lines, "columns": columns})

    size = options.lines, options.columns
    refuse_useless_strip(cameras_of, Plane(0.0), size)
    _warn_of_slip(options)
    step = steps_of(report, "rendering the bands, and the truth")
    return list(
        write_strip(line_of_sight_case(case, seed, **recipe.given), folder, **recipe.files, step=step)
    )


def _warn_of_slip(options: StripOptions) -> None:
    """Say where TDI is out of step with the ground: a scene that may be meant, and is blurred."""
    slip, name = max((abs(options.tdi_slip(k)), name) for k, name in enumerate(options.names))
    if slip > _SLIP:
        period = options.altitude * options.ifov / options.ground_speed
        complain(
            "warning",
            f"the TDI of {name!r} is out of step with the ground by {slip:.3g} px over its "
            f"{max(options.stages)} stages, which blurs its lines; in step are line_period = "
            f"{period:.6g} s at this ground_speed, altitude and ifov, and line_ratios that are pixel_ratios",
        )


def _orbit(recipe: SceneRecipe, folder: Path, report: Progress) -> list[str]:
    """A strip of one of the instruments over a real orbit; the names of its files."""
    from sightline.geometry.earth import WGS84
    from sightline.geometry.surface import Ellipsoid
    from sightline.simulate.instrument_files import write_instrument
    from sightline.simulate.instruments import instrument_case

    case, seed, options = recipe.case, recipe.seed, recipe.options

    def cameras_of(lines: int, columns: int) -> tuple[PushbroomCamera, ...]:
        given = {**recipe.given, "lines": lines, "columns": columns}
        return instrument_case(case, seed, **given).nominal_cameras

    size = options.lines, options.columns
    refuse_useless_strip(cameras_of, Ellipsoid(*WGS84, 0.0), size, options.pairs)
    step = steps_of(report, "rendering the bands, and the truth")
    return list(write_instrument(instrument_case(case, seed, **recipe.given), folder, step))


def _acquired(recipe: SceneRecipe, folder: Path, out: Path, report: Progress) -> list[str]:
    """A strip of the cameras of an acquisition; the names of its files."""
    from sightline.inputs import will_write
    from sightline.io.scene.acquired import acquired_files, acquired_scenario, read_acquired, write_acquired

    file = read_acquired(recipe.options)
    will_write(acquired_files(file))
    scenario = acquired_scenario(file, recipe.seed, recipe.options, folder)
    step = steps_of(report, "rendering the bands, and the truth")
    return list(write_acquired(scenario, file, folder, out, step))


def _photographs(recipe: SceneRecipe, folder: Path, report: Progress) -> list[str]:
    """Frames of a matrix instrument; the names of their files."""
    from sightline.simulate.files import write_frames
    from sightline.simulate.frames import frames_case

    step = steps_of(report, "rendering the frames, and the truth")
    written = write_frames(frames_case(recipe.seed, **recipe.given), folder, **recipe.files, step=step)
    refuse_useless_scene(folder / "acquisition.toml", "these options")
    return list(written)


def _spinning(recipe: SceneRecipe, folder: Path, report: Progress) -> list[str]:
    """A raw image of a spinning camera; the names of its files."""
    from sightline.io.scene.spinning import spinning_scenario, write_spinning

    step = steps_of(report, "rendering the exposures, and the truth")
    return list(write_spinning(spinning_scenario(recipe.seed, recipe.options), folder, step))


def _pass(recipe: SceneRecipe, folder: Path, report: Progress) -> list[str]:
    """A pass of synchronous cameras; the names of its files."""
    from sightline.simulate.stereo import stereo_case
    from sightline.simulate.stereo_files import write_stereo

    images = recipe.files["images"]

    def fewest() -> str:
        """More points, where those are too few."""

        def write(place: Path, count: int) -> None:
            more = stereo_case(recipe.case, recipe.seed, **{**recipe.given, "points": count})
            write_stereo(more, place, **recipe.files)

        return "" if images else least_points(folder, write, recipe.options.points)

    if images:
        refuse_useless_pass(recipe.options)
    step = steps_of(report, "drawing the pass, and the truth")
    scenario = stereo_case(recipe.case, recipe.seed, **recipe.given)
    names = list(write_stereo(scenario, folder, **recipe.files, step=step))
    refuse_useless_scene(folder / "stereo.toml", "these options", fewest)
    return names


def _flight(recipe: SceneRecipe, folder: Path, report: Progress) -> list[str]:
    """A flight of a filter camera; the names of its files."""
    from sightline.simulate.sequence import sequence_case
    from sightline.simulate.sequence_files import write_sequence

    report("drawing the flight and the ground")
    refuse_useless_flight(recipe.options)
    scenario = sequence_case(recipe.case, recipe.seed, **recipe.given)
    names = list(write_sequence(scenario, folder, **recipe.files, progress=report))
    if scenario.options.position_sigma > 0.0:  # else it is the user who will add control points
        refuse_useless_scene(folder / "sequence.toml", "these options")
    return names


#: What makes the scenes of each family.
_MAKERS: dict[str, Callable[[SceneRecipe, Path, Progress], list[str]]] = {
    "strip": _strip,
    "orbit": _orbit,
    "photographs": _photographs,
    "spinning": _spinning,
    "pass": _pass,
    "flight": _flight,
}
