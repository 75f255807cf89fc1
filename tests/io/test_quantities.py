from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, get_args

import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError

from sightline.errors import FormatError
from sightline.io.acquisition.schema import MatchingSection
from sightline.io.config import SCHEMAS, json_schema, validate
from sightline.io.layout.schema import LayoutSection
from sightline.io.quantities import Latitude, Within, shown

# what a slip of the keyboard, another program or somebody curious writes in the place of a number
ABSURD = {
    "huge": 1e300,
    "tiny": 1e-300,
    "minus tiny": -1e-300,
    "not a number": math.nan,
    "without end": math.inf,
    "minus without end": -math.inf,
    "whole number of 31 digits": 10**30,
    "whole number of 4,000 digits": 10**4000,
    "a truth value": True,
    "a word": "7",
    "an empty list": [],
    "a list of lists": [[[]]],
    "a table": {"x": 1},
}


def models(model: type[BaseModel], seen: set[type[BaseModel]]) -> Iterator[type[BaseModel]]:
    """A model and all within it, each once."""
    if model in seen:
        return
    seen.add(model)
    yield model
    for field in model.model_fields.values():
        for inner in within(field.annotation):
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                yield from models(inner, seen)


def within(annotation: Any) -> Iterator[Any]:
    """A type and all of which it is made."""
    yield annotation
    for inner in get_args(annotation):
        yield from within(inner)


def numbers() -> list[tuple[type[BaseModel], str]]:
    """Every field of every schema that takes a number, or numbers."""
    seen: set[type[BaseModel]] = set()
    return [
        (model, field.alias or name)
        for schema in SCHEMAS.values()
        for model in models(schema, seen)
        for name, field in model.model_fields.items()
        if {int, float} & {part for part in within(field.annotation) if isinstance(part, type)}
    ]


def unbounded(schema: Any, path: str = "") -> Iterator[str]:
    """Numbers, texts and lists of a JSON Schema that may be as large as one likes."""
    if isinstance(schema, list):
        for number, entry in enumerate(schema):
            yield from unbounded(entry, f"{path}/{number}")
    if not isinstance(schema, dict):
        return
    match schema.get("type"):
        case "number" | "integer":
            low, high = {"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}
            if not (low & schema.keys() and high & schema.keys()):
                yield path
        case "array":
            if "maxItems" not in schema:
                yield path
        case "string":
            if not {"maxLength", "enum", "const"} & schema.keys():
                yield path
    for key, entry in schema.items():
        yield from unbounded(entry, f"{path}/{key}")


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_number_text_and_list_of_a_file_has_bounds(name):
    assert list(unbounded(json_schema(name))) == []


@pytest.mark.parametrize("what", ABSURD)
def test_an_absurd_value_is_refused_for_every_key_that_takes_a_number(what):
    taken, value = set(), ABSURD[what]
    for model, key in numbers():
        for form in (lambda v: v, lambda v: [v, v], lambda v: [v] * 3, lambda v: [v] * 4, lambda v: [[v]]):
            if takes(model, key, form(value)) and not (what in ROUNDING and takes(model, key, form(0.0))):
                taken.add(key)
    assert taken == TAKEN.get(what, set())


#: Where 0 is allowed among numbers of both signs, what is next to it is rounding.
ROUNDING = ("tiny", "minus tiny")
#: Keys that may hold such a value all the same: words, files and lists beside numbers, wells without end.
TAKEN = {
    "without end": {"full_well_line", "full_well_sum"},
    "a word": {"time", "wavelength_nm", "stages"},
    # none of these; or too few, which the whole table or its command says
    "an empty list": {
        "distortion",
        "tones",
        "image_sigma_px",
        "lines",
        "positions_px",
        "positions_s",
        "stages",
    },
}


def takes(model: type[BaseModel], key: str, value: object) -> bool:
    """Whether a table of a file may hold a key with this value, whatever is wrong with its other keys."""
    try:
        model.model_validate({key: value})
    except ValidationError as error:
        return not any(key in place["loc"] or f"{key} " in place["msg"] for place in error.errors())
    return True


def said_of(kind: Any, value: object) -> str:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(kind).validate_python(value)
    return str(caught.value.errors()[0]["msg"])


def test_what_is_allowed_is_said_with_its_unit():
    assert said_of(Annotated[float, Within(0.01, 1e10, "m", "metres")], 0.0) == "0.01 to 1e10 m are; metres"
    assert said_of(Annotated[float, Within(1e-7, 1.0, "px", zero=True)], 2.0) == "0, or 1e-7 to 1 px are"
    assert said_of(Annotated[int, Within(1, 1_000_000, "lines")], 2.5) == "a whole number is"
    assert said_of(Annotated[int, Within(1, 1_000_000, "lines")], 0) == "1 to 1e6 lines are"
    assert said_of(Annotated[float, Within(0.0, 1.0, above=True, below=True)], 1) == "above 0 to below 1 are"
    assert said_of(Annotated[float, Within(0.0, 1.0)], "0.5") == "a number without quotation marks is"
    assert said_of(Annotated[float, Within(0.0, 1.0)], "any") == "0 to 1 are"
    assert "latitude and longitude swapped?" in said_of(Latitude, 122.0)


def test_a_number_keeps_its_bits_and_loses_the_sign_of_zero():
    kind = TypeAdapter(Annotated[float, Within(-1.0, 1.0)])
    assert kind.validate_python(0.1) == 0.1
    assert math.copysign(1.0, kind.validate_python(-0.0)) == 1.0
    assert TypeAdapter(Annotated[int, Within(1, 5)]).validate_python(3.0) == 3


def test_a_message_repeats_the_beginning_of_what_is_long():
    assert shown("x" * 10_000) == f"'{'x' * 79}... (10002 characters)"
    assert shown([0.5] * 1_000_000) == "[0.5, 0.5, 0.5, ...] (1000000 values)"
    assert shown(10**30) == "a number of 31 digits"
    assert shown(-(10**4000)) == "a negative number of 4001 digits"


def test_a_list_of_a_million_is_refused_in_a_line():
    with pytest.raises(FormatError) as caught:
        validate(LayoutSection, {"positions_px": [float(k) for k in range(1_000_000)]}, Path("x.toml"))
    assert "positions_px holds more values than the 64 that are allowed" in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_list_of_none_is_refused_in_our_words():
    with pytest.raises(FormatError, match=r"pairs = \[\] is not allowed: 1 or more values are"):
        validate(MatchingSection, {"pairs": []}, Path("x.toml"))
