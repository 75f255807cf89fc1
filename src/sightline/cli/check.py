"""``sightline check``: what a file says, what is missing, what will be observable. Runs nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sightline.cli.options import AllowNetwork, Json


def check(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.toml", help="An ACQUISITION, INSTRUMENT, SCENE, SEQUENCE, STEREO or TDI.toml."
        ),
    ],
    as_json: Json = False,
    allow_network: AllowNetwork = False,
) -> None:
    """Say what was understood of a file, what is missing, and what will be observable; run nothing."""
    from sightline.cli.terminal import complain, print_json, say
    from sightline.errors import failing_numbers

    with failing_numbers(f"{file}"):
        description = describe(file)
    absent, still = description.pop("absent", []), description.pop("still", "")
    if as_json:
        print_json(description)
        _ended(file, absent, still)
        return
    for warning in description["warnings"]:
        complain("warning", warning)
    for title in ("understood", "missing", "observable"):
        say(f"{title}:")
        for line in description[title] or ["nothing"]:
            say(f"  {line}")
    _ended(file, absent, still)


def _ended(file: Path, absent: list[str], still: str) -> None:
    """Status 1 where images are not there or hold no motion: what is described cannot be recovered."""
    from sightline.cli.terminal import complain
    from sightline.io.acquisition.load import few_absent

    said = [few_absent(absent)] if absent else []
    if still:
        said.append(f"`recover` would refuse it: {still}")
    if said:
        complain("error", f"{file}: {'; '.join(said)}")
        raise typer.Exit(1)


def describe(file: Path) -> dict[str, Any]:
    """A file in words, with what its run will take; refused for what the run would refuse it for."""
    from sightline.applications.expected_cost import orientation_cost, prediction_cost, tdi_cost
    from sightline.applications.focal_plane import layout_cost
    from sightline.cli.terminal import with_doubts
    from sightline.io.acquisition.describe import describe_acquisition
    from sightline.io.acquisition.load import load_acquisition, ready_to_recover
    from sightline.io.config import schema_of
    from sightline.io.layout.load import describe_instrument, load_instrument
    from sightline.io.results.cube_summary import ready_to_georeference
    from sightline.io.scene.cost import scene_cost
    from sightline.io.scene.recipe import describe_recipe, read_recipe
    from sightline.io.sequence.describe import describe_sequence
    from sightline.io.sequence.load import read_sequence
    from sightline.io.stereo.describe import describe_stereo
    from sightline.io.stereo.load import read_stereo
    from sightline.io.stereo.plan import describe_plan, has_plan, read_plan
    from sightline.io.tdi.load import describe_tdi, load_tdi

    match schema_of(file):
        case "scene":
            recipe = read_recipe(None, file)
            description, cost = describe_recipe(recipe), scene_cost(recipe)
        case "instrument":
            plane = load_instrument(file)
            description, cost = describe_instrument(plane), layout_cost(plane)
        case "sequence":
            sequence = read_sequence(file)
            cost = ready_to_georeference(sequence)
            description = describe_sequence(sequence)
        case "stereo" if has_plan(file):
            planned = read_plan(file)
            plan = planned.plan
            description = describe_plan(planned)
            cost = prediction_cost(plan.pair.cameras, plan.shots, plan.points)
        case "stereo":
            stereo = read_stereo(file, planned=True, describe=True)
            description, cost = describe_stereo(stereo), orientation_cost(stereo.problem)
            description["missing"] = [*stereo.absent, *description["missing"]]
            description["absent"] = list(stereo.absent)
        case "tdi":
            problem = load_tdi(file)
            description, cost = describe_tdi(problem), tdi_cost(problem)
        case _:
            acquired = load_acquisition(file, describe=True)
            with with_doubts(acquired):
                ready = None if acquired.still else ready_to_recover(acquired)
            description = describe_acquisition(acquired)
            description["missing"] = [*acquired.absent, *description["missing"]]
            description["absent"] = list(acquired.absent)
            if ready is None:
                at = len(acquired.absent)  # images that are not there come first
                description["missing"].insert(at, f"images that hold motion: {acquired.still}")
                return {**description, "warnings": [], "still": acquired.still}
            cost = ready
    description["understood"].append(f"the run will take {cost.words}")
    expected = {"seconds": cost.seconds, "bytes": cost.bytes, "of": cost.of}
    room = cost.lacks_room(Path.cwd())
    return {**description, "expected": expected, "warnings": [*cost.warnings, *([room] if room else [])]}
