"""TOML files against their schema: one clear message for a wrong key or value.

Not here: what the keys mean (``io/acquisition/schema.py``), opening the files they name
(``io/acquisition/load.py``).
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from sightline.access import SMALL, read_text
from sightline.errors import FormatError, foreign_errors
from sightline.io.acquisition.schema import AcquisitionFile
from sightline.io.layout.schema import InstrumentFile
from sightline.io.quantities import shown
from sightline.io.results.schema import summary_schema
from sightline.io.scene.schema import SceneFile
from sightline.io.sequence.schema import SequenceFile
from sightline.io.stereo.schema import StereoFile
from sightline.io.tdi.schema import TdiFile

Model = TypeVar("Model", bound=BaseModel)

#: The files that have a schema, by the name given to ``sightline schema``.
SCHEMAS: dict[str, type[BaseModel]] = {
    "acquisition": AcquisitionFile,
    "instrument": InstrumentFile,
    "scene": SceneFile,
    "sequence": SequenceFile,
    "stereo": StereoFile,
    "tdi": TdiFile,
}

#: The command that reads each of them.
COMMANDS = {
    "acquisition": "recover",
    "instrument": "layout",
    "scene": "simulate",
    "sequence": "georeference",
    "stereo": "orient",
    "tdi": "tdi",
}
#: Keys that a focal length in mm is given by, which none of the files takes.
_IN_MM = ("focal_length_mm", "focal_mm", "focal", "f_mm", "f")
#: Numbers of values in words.
_COUNTS = {1: "one", 2: "two", 3: "three", 4: "four"}
#: Keys that are listed in a message.
_LISTED = 8
#: Tables that a key is said to belong to: what more have, as a name, belongs to none.
_OWNERS = 2
#: Characters of a key that a message repeats.
_LONGEST_KEY = 80

#: SI units and rad in those that stand behind numbers.
UNITS = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "\u00b5s": 1e-6, "m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3,
    "um": 1e-6, "\u00b5m": 1e-6, "Hz": 1.0, "kHz": 1e3, "rad": 1.0,
    "mrad": 1e-3, "urad": 1e-6, "\u00b5rad": 1e-6,
    "deg": math.pi / 180.0, "\u00b0": math.pi / 180.0, "arcsec": math.pi / 648000.0,
}  # fmt: skip

#: Values of ``kind`` by table: pydantic names the one it tried in the place of a mistake.
KINDS = {
    "platform": ("camera-model", "ephemeris", "level-flight", "spin"),
    "pointing": ("fixed", "scan-mirror"),
}


def json_schema(name: str) -> dict[str, Any]:
    """JSON Schema of one of our TOML files, or of every ``summary.json``.

    Parameters
    ----------
    name : str
        ``"acquisition"``, ``"instrument"``, ``"scene"``, ``"sequence"``, ``"stereo"``,
        ``"summary"`` or ``"tdi"``.

    Returns
    -------
    dict
        Ready for ``json.dumps``.

    Raises
    ------
    FormatError
        If there is no such schema; the message lists them.
    """
    known = sorted([*SCHEMAS, "summary"])
    if name not in known:
        raise FormatError(f"no schema is called {name!r}{_near(name, known)}; there are: {', '.join(known)}")
    if name == "summary":
        return summary_schema()
    if name == "scene":
        from sightline.io.scene.models import scene_schema

        return scene_schema()
    return SCHEMAS[name].model_json_schema()


def schema_of(path: Path) -> str:
    """Which of `SCHEMAS` a TOML file is meant for: the one that knows most of its keys, else acquisition."""
    shared = _shared(read_toml(path))
    return max(shared, key=lambda name: shared[name])


def _shared(data: dict[str, Any]) -> dict[str, int]:
    """How many keys of `data` each of `SCHEMAS` has; those of scenes are all where it names kind or case."""
    shared = {name: len(data.keys() & model.model_fields.keys()) for name, model in SCHEMAS.items()}
    if {"kind", "case"} & data.keys():  # no other file has them at its top
        shared["scene"] = len(data)
    return shared


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; FormatError names the file and the line of a mistake."""
    text = read_text(Path(path), "a TOML file", most=SMALL, advice="give the path of a TOML file")
    try:
        return _parsed(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{path}: not valid TOML: {error}; {_meant(text, error)}") from None
    except (ValueError, RecursionError) as error:
        deep = isinstance(error, RecursionError)
        what = "is nested too deeply" if deep else "holds a number that is none, or has too many digits"
        place = _longest(text, r"[\[{]+" if deep else r"\d+")
        raise FormatError(f"{path}: not valid TOML: {place} {what}; correct it there") from None


def _meant(text: str, error: tomllib.TOMLDecodeError) -> str:
    """What to do about a line that is no TOML: keys that stand twice, paths of Windows, numbers with decimal
    commas or units are recognised."""
    place = re.search(r"line (\d+)", str(error))
    lines = text.splitlines()
    number = min(int(place[1]), len(lines)) if place else 0
    line = lines[number - 1] if number else ""
    if "overwrite a value" in str(error):
        return (
            f"{line.partition('=')[0].strip()[:_LONGEST_KEY]} stands twice in its table: keep one of the two"
        )
    if "twice" in str(error):
        return f"{line.strip()[:_LONGEST_KEY]} stands twice: put all of its keys under one"
    if "\\" in line and re.search(r"\\|hex", str(error)):
        return (
            r"in quotation marks \ begins a special character: write a path with / or \\, or in single quotes"
        )
    value = re.search(r"[=\[,]\s*([-+]?\d+),(\d+(?:[eE][-+]?\d+)?)\s*(?:#.*)?$", line)
    if value is not None:
        given, right = f"{value[1]},{value[2]}", f"{value[1]}.{value[2]}"
        return f"{given!r} has a decimal comma: numbers are written with a decimal point, {right}"
    size = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![eE][-+]?\d)"
    value = re.search(rf"=\s*{size}\s*([A-Za-z%\u00b0\u00b5]+\S*)\s*(?:#.*)?$", line)
    if value is not None:
        given, unit = f"{value[1]} {value[2]}", UNITS.get(value[2])
        instead = f"; {given} is {float(value[1]) * unit:.9g}" if unit else ""
        return (
            f"{given}: numbers are written without units, in SI units and rad unless the name of the key "
            f"says otherwise{instead}"
        )
    return "correct it there"


@lru_cache(maxsize=2)
def _parsed(text: str) -> dict[str, Any]:
    # a file is asked for its kind before it is read; nothing writes into what was parsed
    return tomllib.loads(text)


def _longest(text: str, pattern: str) -> str:
    """Line and key with the longest match, which is what a parser that gives up stumbles over."""
    found = max(re.finditer(pattern, text), key=lambda match: len(match[0]), default=None)
    if found is None:
        return "it"
    number = text.count("\n", 0, found.start())
    key, equals, _ = text.split("\n")[number].partition("=")
    return f"line {number + 1}" + (f": {key.strip()[:_LONGEST_KEY]}" if equals else "")


def validate(
    model: type[Model],
    data: dict[str, Any],
    path: Path,
    elsewhere: Mapping[str, str] = MappingProxyType({}),
) -> Model:
    """`data` as a `model`; FormatError names file, key, value and what is allowed.

    Parameters
    ----------
    model : type
        A pydantic model that forbids extra keys.
    data : dict
        Tables of the file.
    path : Path
        Named in messages.
    elsewhere : mapping, optional
        Keys that it does not have, with whose they are.

    Returns
    -------
    Model
    """
    with foreign_errors(path, "its keys cannot be checked", "look for values that are very long or deep"):
        return _validated(model, data, path, elsewhere)


def _validated(model: type[Model], data: dict[str, Any], path: Path, elsewhere: Mapping[str, str]) -> Model:
    unknown = next(_unknown_keys(model, data, (), elsewhere, _tables_with(model)), None)
    if unknown is not None:
        raise FormatError(f"{path}: {_meant_for_another(model, data, elsewhere) or unknown}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first, *others = error.errors()
        length = _wrong_length(model, first)
        if length:  # each value that a list lacks is complained of
            others = [one for one in others if _list_of(one) != _list_of(first)]
        said = length or f"{_explain(first, model)}{_held(model, first)}"
        raise FormatError(f"{path}: {said}{_others(_place(first), others)}") from None


def _meant_for_another(model: type[BaseModel], data: dict[str, Any], known: Mapping[str, str]) -> str:
    """Which command a file is for that holds more tables of another schema than of `model`; else empty."""
    own = len(data.keys() & {*model.model_fields, *known})
    shared = _shared(data)
    best = max(shared, key=lambda name: shared[name])
    name = next((name for name, other in SCHEMAS.items() if issubclass(model, other)), None)
    if name is None or shared[best] <= own:
        return ""
    return (
        f"this looks like a file for `sightline {COMMANDS[best]}` ({best.upper()}.toml: it holds "
        f"{', '.join(key for key in data if key in SCHEMAS[best].model_fields)}); give it to that command; "
        f"here {name.upper()}.toml is read"
    )


def _held(model: type[BaseModel], error: Any) -> str:
    """What a missing table of `model` holds, in words; empty for other mistakes."""
    if error["type"] != "missing" or len(error["loc"]) != 1:
        return ""
    inner = list(dict.fromkeys(_models_in(model.model_fields[str(error["loc"][0])].annotation)))
    if len(inner) != 1:
        return ""
    fields = inner[0].model_fields
    names = {name: field.alias or name for name, field in fields.items()}  # as they are written in a file
    needed = [names[name] for name, field in fields.items() if field.is_required()]
    optional = [name for name in names.values() if name not in needed]
    if not needed:
        return f": it may hold {', '.join(optional)}"
    return f": it holds {', '.join(needed)}" + (f"; if wanted also {', '.join(optional)}" if optional else "")


def _others(first: str, errors: Sequence[Any]) -> str:
    """Further mistakes by the names of their keys; a key of several types is complained of by each."""
    missing = [_place(error) for error in errors if error["type"] == "missing"]
    wrong = [place for place in map(_place, (e for e in errors if e["type"] != "missing")) if place != first]
    said = [f"also missing: {_few(missing)}"] if missing else []
    said += [f"also wrong: {_few(wrong)}"] if wrong else []
    return f" ({'; '.join(said)})" if said else ""


def _few(keys: Sequence[str]) -> str:
    """Names of keys, each once; how many more there are than a message should list."""
    names = list(dict.fromkeys(keys))
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _near(word: str, allowed: Sequence[str] | dict[str, Any]) -> str:
    """``"; did you mean X?"`` when something allowed looks like `word`."""
    close = difflib.get_close_matches(word.lower(), list(allowed), n=1, cutoff=0.6)
    return f"; did you mean {close[0]}?" if close else ""


def _unknown_keys(
    model: type[BaseModel],
    data: dict[str, Any],
    where: tuple[str | int, ...],
    others: Mapping[str, str] = MappingProxyType({}),
    tables: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[str]:
    """Every key of `data` that `model` does not have, in words.

    `others` names the kinds of this table that have it, `tables` the tables of the file.
    """
    fields = {field.alias or name: field for name, field in model.model_fields.items()}
    for key, value in data.items():
        if key not in fields:
            owner = _table(where) or "the file"
            if key in _IN_MM and "focal_length_px" in fields:
                yield f"unknown key {_key((*where, key))!r}; {_focal_hint(value)}"
                continue
            hint = _near(key, list(fields)) or ";"
            if key in others or key in tables:
                hint = f"; it belongs to {others.get(key) or tables[key]};"
            yield f"unknown key {_key((*where, key))!r}{hint} {owner} takes: {', '.join(fields)}"
            continue
        items = value if isinstance(value, list) else [value]
        for index, item in enumerate(items):
            if isinstance(item, dict):
                annotation = _as_given(fields[key].annotation, listed=isinstance(value, list))
                inner = _model_of(annotation, item)
                if inner is not None:
                    place = (*where, key, index) if isinstance(value, list) else (*where, key)
                    yield from _unknown_keys(inner, item, place, _other_kinds(annotation), tables)


def _as_given(annotation: Any, *, listed: bool) -> Any:
    """Of a type that takes one table or several of other keys, the part for what is given."""
    parts = {get_origin(part) is list: part for part in _parts(annotation) if list(_models_in(part))}
    return parts.get(listed, annotation) if len(parts) == 2 else annotation


def _parts(annotation: Any) -> Iterator[Any]:
    """The types that a union takes, without what is annotated of them."""
    if get_origin(annotation) is Annotated:
        yield from _parts(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, UnionType):
        for part in get_args(annotation):
            yield from _parts(part)
    else:
        yield annotation


def _other_kinds(annotation: Any) -> dict[str, str]:
    """Keys of a table that comes in several kinds, with the kinds that have them."""
    models = list(dict.fromkeys(_models_in(annotation)))
    if len(models) < 2:
        return {}
    having: dict[str, list[str]] = {}
    for model in models:
        for key in model.model_fields:
            having.setdefault(key, []).append(f'"{get_args(model.model_fields["kind"].annotation)[0]}"')
    return {key: f"kind = {' or '.join(kinds)}" for key, kinds in having.items()}


def _tables_with(model: type[BaseModel]) -> dict[str, str]:
    """Keys of the tables of a file, with the tables that have them; none that most tables have."""
    having: dict[str, dict[str, None]] = {}
    for name, field in model.model_fields.items():
        for part in _parts(field.annotation):
            table = f"[[{name}]]" if get_origin(part) is list else f"[{name}]"
            for inner in _models_in(part):
                for key, of_table in inner.model_fields.items():
                    having.setdefault(of_table.alias or key, {})[table] = None
    return {key: " or ".join(tables) for key, tables in having.items() if len(tables) <= _OWNERS}


def _focal_hint(value: Any) -> str:
    """What to give in place of a focal length in mm."""
    given = f"{value:g} mm" if isinstance(value, int | float) and not isinstance(value, bool) else "mm"
    return (
        f"give focal_length_px = {given} / pixel pitch in mm: in pixels, as 8 mm and pixels of 0.005 mm make "
        "1600.0"
    )


def _model_of(annotation: Any, item: dict[str, Any]) -> type[BaseModel] | None:
    """The pydantic model that a table is checked against; of several, the one whose `kind` it names."""
    models = list(dict.fromkeys(_models_in(annotation)))
    if len(models) <= 1:
        return models[0] if models else None
    for model in models:
        if item.get("kind") in get_args(model.model_fields["kind"].annotation):
            return model
    return None


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Pydantic models inside a type such as ``list[X]`` or ``Annotated[X | Y, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def _table(where: Sequence[str | int]) -> str:
    """``("band", 1)`` as ``[[band]] number 2``."""
    words = ""
    for part in where:
        if isinstance(part, int):
            words = f"[[{words.strip('[]')}]] number {part + 1}"
        else:
            words = f"{words} {part}" if words.endswith(tuple("0123456789")) else f"[{part}]"
    return words


def _key(where: Sequence[str | int]) -> str:
    """``("band", 1, "ifov")`` as ``band[2].ifov`` (counted from one, as a reader counts)."""
    text = ""
    for part in where:
        text += f"[{part + 1}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def _list_of(error: Any) -> tuple[str | int, ...]:
    """Place of the list that a complaint is about, or about a value of which."""
    where = _where(error)
    return where[:-1] if where and isinstance(where[-1], int) else where


def _wrong_length(model: type[BaseModel], error: Any) -> str:
    """What a list of a fixed number of values should hold, where it holds fewer or more; else empty."""
    if error["type"] not in ("missing", "too_long"):
        return ""
    where = _list_of(error)
    if error["type"] == "missing" and where == _where(error):
        return ""
    words = _tuple_words(model, where)
    given = error["input"]
    return f"{_key(where)} = {shown(given)} is not allowed: {words}" if words else ""


def _at(model: type[BaseModel], where: Sequence[str | int]) -> tuple[Any, str]:
    """Type and description of a key, or of the values of a list at that place; None where there is none."""
    annotation: Any = model
    description = ""
    for part in where:
        if isinstance(part, str):
            fields = [
                field
                for inner in _models_in(annotation)
                for name, field in inner.model_fields.items()
                if part == (field.alias or name)
            ]
            if not fields:
                return None, ""
            annotation, description = fields[0].annotation, fields[0].description or ""
        elif (several := _list_type(annotation)) is not None:
            annotation, description = get_args(several)[0], ""
    return annotation, description


def _list_type(annotation: Any) -> Any:
    """The list or tuple among the types that are taken; None without one."""
    return next((part for part in _parts(annotation) if get_origin(part) in (list, tuple)), None)


def _tuple_words(model: type[BaseModel], where: Sequence[str | int]) -> str:
    """``two numbers [lines, columns] are`` of a list of so many values; empty for any other."""
    annotation, description = _at(model, where)
    several = _list_type(annotation)
    if several is None or get_origin(several) is list or Ellipsis in get_args(several):
        return ""
    count = len(get_args(several))
    number = _COUNTS.get(count, str(count))
    # what they are stands in the first brackets of the description that name as many
    named = re.findall(r"[(\[]([^()\[\]]+(?:\([^()]*\)[^()\[\]]*)*)[)\]]", description)
    parts = [(words, [part.strip()[:1] for part in words.split(",")]) for words in named]
    meaning = next(
        (f" [{words}]" for words, begin in parts if len(begin) == count and "".join(begin).isalpha()), ""
    )
    if _leaf(several) is not float:
        return f"{number} words in quotation marks, {['a', 'b'][:count]}, are".replace("'", '"')
    return f"{number} numbers{meaning or ' in brackets'} are"


def _leaf(annotation: Any) -> type:
    """What the values of a list are, however deep: text, numbers or tables."""
    several = _list_type(annotation)
    if several is not None:
        return _leaf(get_args(several)[0])
    if next(_models_in(annotation), None) is not None:
        return dict
    return str if str in _parts(annotation) else float


def _list_words(model: type[BaseModel], where: Sequence[str | int], given: Any) -> str:
    """How a list is written that belongs at a place."""
    words = _tuple_words(model, where)
    if words:
        return words
    several = _list_type(_at(model, where)[0])
    inner = None if several is None else _list_type(get_args(several)[0])
    leaf = float if several is None else _leaf(several)
    if leaf is dict:
        return f"tables are, each headed [[{where[-1]}]]"
    if leaf is str:
        example = '["a", "b"]' if not isinstance(given, str) or inner is not None else f'["{given}"]'
    else:
        example = "[1.0, 2.0]" if inner is None else "[1, 2]"
    return f"a list is, its values in brackets, as {example if inner is None else f'[{example}, ...]'}"


def _explain(error: Any, model: type[BaseModel]) -> str:
    """One pydantic complaint in our form: key, value, what is allowed."""
    where = _where(error)
    key, kind, given = _key(where), error["type"], error["input"]
    context = error.get("ctx", {})
    if kind == "missing":
        return f"key {key!r} is missing; add it"
    if kind == "union_tag_not_found":
        return f"key {_key((*where, 'kind'))!r} is missing; allowed: {', '.join(KINDS[str(where[-1])])}"
    if kind == "union_tag_invalid":
        tag, allowed = str(context["tag"]), str(context["expected_tags"])
        options = [word.strip(" '") for word in allowed.split(",")]
        kinds = ", ".join(options)
        return f"{_key((*where, 'kind'))} = {shown(tag)} is not known{_near(tag, options)}; allowed: {kinds}"
    if kind == "value_error":
        place = f"{key}: " if key else ""
        return f"{place}{context['error']}"
    if (
        kind == "literal_error"
        and where[-1:] == ("focal_length",)
        and not isinstance(given, str | dict | list)
    ):
        return (
            f"{key} = {shown(given)} is not allowed: {_focal_hint(given)}; or focal_length = "
            f"{context['expected']}"
        )
    if kind == "literal_error":
        return f"{key} = {shown(given)} is not known; allowed: {context['expected']}"
    if kind in ("tuple_type", "list_type"):
        if isinstance(where[-1], int) and len(where) == 2:
            return f"{key} = {shown(given)} is not allowed: a list is, as {where[0]} = [[1, 2], [3, 4]]"
        return f"{key} = {shown(given)} is not allowed: {_list_words(model, where, given)}"
    if kind in ("model_type", "model_attributes_type"):
        head = f"[[{where[-2]}]]" if isinstance(where[-1], int) else _table(where)
        return f"{key} = {shown(given)} is not allowed: a table is, {head} with its keys below"
    if kind in ("bool_type", "bool_parsing"):
        return f"{key} = {shown(given)} is not allowed: true or false is"
    if kind == "string_type":
        return f"{key} = {shown(given)} is not allowed: text in quotation marks is"
    if kind == "string_too_short":
        return f"{key} = {shown(given)} is not allowed: text that is not empty is; or leave it out"
    if kind == "too_long":
        return f"{key} holds more values than the {context['max_length']} that are allowed; leave some out"
    if kind == "too_short":
        least = context["min_length"]
        return f"{key} = {shown(given)} is not allowed: {least} or more values are; or leave it out"
    return f"{key} = {shown(given)} is not allowed: {error['msg'][0].lower()}{error['msg'][1:]}"


def _where(error: Any) -> tuple[str | int, ...]:
    """Place of a complaint in the file, without the tags of the types that were tried."""
    tags = {tag for kinds in KINDS.values() for tag in kinds}
    return tuple(part for part in error["loc"] if part not in tags and not _is_type_tag(part))


def _place(error: Any) -> str:
    """The key a complaint is about."""
    return _key(_where(error)) or "the file as a whole"


def _is_type_tag(part: object) -> bool:
    """Pydantic adds the tried type of a union to the place (``float``, ``literal['estimate']``, ...)."""
    return isinstance(part, str) and (
        part
        in {
            "as-list",
            "as-range",
            "as-header",
            "as-table",
            "float",
            "int",
            "str",
            "constrained-float",
            "constrained-int",
            "constrained-str",
        }
        or part.startswith(("literal[", "tuple[", "list[", "function-"))
    )
