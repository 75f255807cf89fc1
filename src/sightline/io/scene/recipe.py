"""A SCENE.toml, and what replaces its keys, as the recipe of a scene; and a recipe as a SCENE.toml.

Not here: keys and allowed values (``models.py``), how a scene is made (``simulate/``).
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
from pydantic import BaseModel

from sightline.errors import FormatError, InputError
from sightline.io.acquisition.stages import read_stages
from sightline.io.config import read_toml, validate
from sightline.io.formats.tables import header_of, read_columns
from sightline.io.names import toml_value
from sightline.io.quantities import shown
from sightline.io.scene.models import FAMILIES, Family, plain_options, scene_model
from sightline.io.scene.schema import KINDS, SceneFile
from sightline.simulate.instruments import DetectorOptions
from sightline.version import VERSION
from sightline.writing import whole_text

#: Name of the file in the folder of a scene.
SCENE = "scene.toml"
#: Options that name a file: seen from the folder of the SCENE.toml.
_NAMED = ("dem_file", "acquisition")
#: m; side of the ground under rendered frames: those that look obliquely reach far beyond the scene.
_FRAMED_GROUND = 60e3


@dataclass(frozen=True)
class SceneRecipe:
    """Everything that a scene is made of.

    Attributes
    ----------
    family : Family
    case : str
    seed : int
    given : mapping
        Options in place of those of the case.
    files : mapping
        What is written, by key.
    """

    family: Family
    case: str
    seed: int
    given: Mapping[str, Any]
    files: Mapping[str, Any]

    @cached_property
    def options(self) -> Any:
        """All options."""
        return self.family.options_of(self.case, self.given)


def read_recipe(
    kind: str | None, file: Path | None, settings: Sequence[str] = (), flags: Mapping[str, Any] | None = None
) -> SceneRecipe:
    """The recipe that a file gives, with what is given in place of its keys.

    Parameters
    ----------
    kind : str or None
        One of `KINDS`; None: that of the file, which must name one.
    file : Path or None
        A SCENE.toml; None: the first case of the kind.
    settings : sequence of str
        ``key=value``, the value as in TOML; texts need no quotation marks, lists no brackets.
    flags : mapping, optional
        Keys by name, None: not given. They and `settings` replace keys of the file; a key is given by one of
        both.

    Returns
    -------
    SceneRecipe

    Raises
    ------
    FormatError
        Names the file (or ``--set``), key, value and what is allowed.
    InputError
        Unknown case; options that do not go together.
    """
    asked = {name: value for name, value in (flags or {}).items() if value is not None}
    tables = {} if file is None else read_toml(file)
    kind = kind or tables.get("kind")
    if kind not in KINDS:
        raise FormatError(
            f"{file}: kind = {shown(kind)} is not known; allowed: {', '.join(KINDS)}"
            if "kind" in tables
            else f"{file}: key 'kind' is missing; allowed: {', '.join(KINDS)}"
        )
    case = _case(kind, file, tables, asked.pop("case", None))
    family = next(one for one in FAMILIES if one.kind == kind and case in one.cases)
    model = scene_model(family.name)
    parsed = _parsed(model, settings)
    folder, chosen = Path() if file is None else file.parent, None
    if isinstance(tables.get("stages"), str) and "stages" in model.model_fields:
        tables["stages"] = chosen = _stages_of(folder / tables["stages"])
    if _is_file(parsed.get("stages")) and "stages" in model.model_fields:
        parsed["stages"] = chosen = _stages_of(Path(parsed["stages"][0]))
    given = _checked(model, tables, file) if file else {}
    for key in _NAMED:
        if given.get(key) and file is not None:
            given[key] = str(file.parent / given[key])
    given |= _checked(model, parsed, Path("--set"))
    for name, value in asked.items():
        _refuse_twice(model, parsed, name)
        given |= _flag(model, family, case, given, name, value)
    seed = given.pop("seed", 0)
    options = {key: value for key, value in given.items() if key not in (*family.files, "kind", "case")}
    written = {key: model.model_fields[key].default for key in family.files}
    written |= {key: given[key] for key in family.files if key in given}
    if written.get("images"):
        options.setdefault("ground_size", _FRAMED_GROUND)
    recipe = SceneRecipe(family, case, seed, options, dict(sorted(written.items())))
    try:
        options_made = recipe.options
        _refuse_beyond(options_made, parsed)
        if chosen is not None and options_made.columns != len(chosen):
            raise InputError(
                f"the table of stages is of {len(chosen)} columns, the strip has {options_made.columns}; "
                f"set columns = {len(chosen)}, or give the table of this strip"
            )
    except InputError as error:
        raise (FormatError(f"{file}: {error}") if file else error) from None
    return recipe


def _is_file(value: Any) -> bool:
    """Whether `stages` of ``--set`` is one text: the name of a table."""
    return isinstance(value, list) and len(value) == 1 and isinstance(value[0], str)


def _stages_of(path: Path) -> list[int]:
    """TDI stages of every column: of a table ``column,stages``, or of a ``choice.csv`` of one signal."""
    signal = None
    if "signal" in header_of(path):
        signals = np.asarray(read_columns(path, ("signal",))["signal"], dtype=np.float64)
        if (signals != signals[0]).any():
            raise FormatError(
                f"{path}: has stages for each of several signals; a strip is imaged with those of one: keep "
                "the rows of one signal"
            )
        signal = float(signals[0])
    count = len(read_columns(path, ("column",))["column"])
    return [int(stages) for stages in read_stages(path, count, signal)[0]]


def _case(kind: str, file: Path | None, tables: Mapping[str, Any], asked: str | None) -> str:
    """The case that is meant."""
    own, named = tables.get("kind", kind), tables.get("case")
    if own != kind and own in KINDS:
        raise FormatError(
            f"{file}: kind = {shown(own)}: a scene for `sightline simulate {own}`; give it to that command"
        )
    if asked is not None and named not in (None, asked):
        raise InputError(
            f"--case {asked}: the scene of {file} is of case {shown(named)}, with options that are its own; "
            "leave --case out, or change the file"
        )
    cases = [case for family in FAMILIES if family.kind == kind for case in family.cases]
    case = asked or named or cases[0]
    if case not in cases:
        place = f"{file}: " if asked is None else ""
        error = FormatError if asked is None else InputError
        raise error(f"{place}unknown case: got {shown(case)}; allowed are {', '.join(cases)}")
    return str(case)


def _checked(model: type[SceneFile], tables: dict[str, Any], place: Path) -> dict[str, Any]:
    """What was given, of the types of the options."""
    found = validate(model, tables, place, elsewhere(model))
    return {name: _as_option(getattr(found, name)) for name in found.model_fields_set}


def _as_option(value: Any) -> Any:
    """A value of a file as that of an option."""
    if isinstance(value, tuple | list):
        return tuple(_as_option(part) for part in value)
    if isinstance(value, BaseModel):  # the only tables of a scene
        return DetectorOptions(**{name: getattr(value, name) for name in value.model_fields_set})
    return value


def elsewhere(model: type[SceneFile]) -> dict[str, str]:
    """Keys that `model` does not have, with whose they are."""
    found: dict[str, str] = {}
    for family in FAMILIES:
        cases = list(family.cases)
        few = f"{', '.join(cases[:3])}{', ...' if len(cases) > 3 else ''}"
        for name in scene_model(family.name).model_fields:
            if name not in model.model_fields:
                found.setdefault(name, f"`simulate {family.kind}`, case {few}")
    if "shape" in model.model_fields:
        found |= dict.fromkeys(("lines", "columns"), "shape = [lines, columns]")
    return found


def _flag(
    model: type[SceneFile], family: Family, case: str, given: Mapping[str, Any], name: str, value: Any
) -> dict[str, Any]:
    """What a flag of its own sets."""
    place = Path(f"--{name}")
    if name in ("lines", "columns") and "shape" in model.model_fields:
        shape = list(given.get("shape", family.cases[case].get("shape", model.model_fields["shape"].default)))
        shape[("lines", "columns").index(name)] = value
        return _checked(model, {"shape": shape}, place)
    if name not in model.model_fields:
        raise InputError(f"--{name} is not for case {case!r}; it belongs to {elsewhere(model)[name]}")
    return _checked(model, {name: value}, place)


def _refuse_twice(model: type[SceneFile], parsed: Mapping[str, Any], name: str) -> None:
    """InputError where a key that a flag sets is also given after --set."""
    key = "shape" if name in ("lines", "columns") and "shape" in model.model_fields else name
    if key in parsed:
        raise InputError(f"--{name} and --set {key} are both given; keep one of them")


def _refuse_beyond(options: Any, parsed: Mapping[str, Any]) -> None:
    """InputError where a stretch of lines that is asked for begins where the strip has ended.

    Cases and files hold stretches of longer strips, of which less was asked for.
    """
    for name in ("cloud_banks", "blank"):
        for first, count in getattr(options, name) if name in parsed else ():
            if first >= options.lines:
                raise InputError(
                    f"--set: {name} holds [{first}, {count}], {count} lines from line {first} on; the strip "
                    f"has lines 0 to {options.lines - 1}: begin there, or give more --lines"
                )


def _parsed(model: type[SceneFile], settings: Sequence[str]) -> dict[str, Any]:
    """``key=value`` words as the tables of a file."""
    tables: dict[str, Any] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        key = key.strip()
        if not equals or not key:
            raise InputError(f"--set {setting}: give a key and its value, as --set snr=40")
        if key in ("kind", "case", "seed"):
            there = "the word after `sightline simulate`" if key == "kind" else f"--{key}"
            raise InputError(f"--set {setting}: {key} is given by {there}")
        # the name of a file may hold one
        listed = text.lstrip().startswith("[") or text.rstrip().endswith("]")
        if listed and text.count("[") != text.count("]"):
            raise InputError(
                f"--set {setting}: a bracket is not closed, or not opened; pair them as [[1, 2], [3, 4]]"
            )
        value = _value(text)
        field = model.model_fields.get(key)
        if field is not None and not isinstance(value, list) and _is_list(field.annotation):
            value = [value]
        tables[key] = value
    return tables


def _value(text: str) -> Any:
    """A value of TOML; of what is none, a list where commas part it, and else the text itself."""
    try:
        (value,) = tomllib.loads(f"value = {text}").values()
    except (ValueError, RecursionError):
        inner = text.strip()
        # [1, 2], [3, 4] begins and ends with brackets that are not each other's
        listed = inner.startswith("[") and inner.endswith("]") and len(_items(inner)) == 1
        parts = _items(inner[1:-1] if listed else inner)
        if listed or len(parts) > 1:
            return [_value(part) for part in parts if part]
        # numbers that TOML does not have: .3
        return float(text) if re.fullmatch(r"[+-]?(\d+\.?|\d*\.\d+)(e[+-]?\d+)?", text, re.I) else text
    return value


def _items(text: str) -> list[str]:
    """What commas part that stand in no brackets."""
    items, depth = [""], 0
    for letter in text:
        depth += (letter == "[") - (letter == "]")
        if letter == "," and depth == 0:
            items.append("")
        else:
            items[-1] += letter
    return [item.strip() for item in items]


def _is_list(annotation: Any) -> bool:
    """Whether a key holds a list."""
    origin = get_origin(annotation)
    return origin is tuple or any(_is_list(part) for part in get_args(annotation) if origin is not None)


def describe_recipe(recipe: SceneRecipe) -> dict[str, Any]:
    """A scene in words: `understood`, `missing` and `observable`, and the same as data.

    Returns
    -------
    dict
        As of the other files that `check` reads, with `kind`, `case`, `seed`, and `given`: options in place
        of those of the case.
    """
    kind, given = recipe.family.kind, plain_options(recipe.options)
    changed = {name: given[name] for name in given if name in recipe.given}
    understood = [f"a scene for `sightline simulate {kind} --scene`: case {recipe.case}, seed {recipe.seed}"]
    understood += [f"{name} = {toml_value(value)}" for name, value in changed.items() if name != "detectors"]
    understood += [f"detector {detector['name']}" for detector in changed.get("detectors", ())]
    understood += [f"{name} = {toml_value(value)}" for name, value in recipe.files.items()]
    return {
        "understood": understood,
        "missing": [],
        "observable": [f"make it, then check what `simulate {kind}` wrote"],
        **{"kind": kind, "case": recipe.case, "seed": recipe.seed, "given": changed},
    }


def write_recipe(path: Path, recipe: SceneRecipe) -> Path:
    """The file from which the same scene is made again, every option in it; the file."""
    whole_text(path, recipe_toml(recipe))
    return path


def recipe_toml(recipe: SceneRecipe) -> str:
    """The text of that file."""
    options = plain_options(recipe.options)
    for key in _NAMED:
        if options.get(key):
            options[key] = str(Path(options[key]).resolve())
    keys = {"kind": recipe.family.kind, "case": recipe.case, "seed": recipe.seed, **options, **recipe.files}
    detectors = keys.pop("detectors", [])
    return "\n".join([
        f"# A scene of sightline {VERSION}. To make it again, bit for bit:",
        f"#     sightline simulate {recipe.family.kind} --scene {SCENE} --out DIR",
        "# Units are SI and radians unless a name says otherwise; `sightline schema scene` says more.",
        *_lines(keys),
        *(line for detector in detectors for line in ("", "[[detectors]]", *_lines(detector))),
        "",
    ])  # fmt: skip


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    """Keys and values of a table; what is None is left out, as TOML has no such value."""
    return (f"{key} = {toml_value(value)}" for key, value in table.items() if value is not None)
