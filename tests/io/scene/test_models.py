from __future__ import annotations

import dataclasses
import json
import re
from typing import get_args, get_type_hints

import pytest

from sightline.io.config import json_schema
from sightline.io.scene.models import FAMILIES, scene_model
from sightline.io.scene.schema import KINDS, MOST_SEED
from sightline.simulate import option_checks
from sightline.simulate.instruments import DetectorOptions
from sightline.simulate.option_checks import descriptions

OPTIONS = [*(family.options for family in FAMILIES), DetectorOptions]


def parts(hint):
    inner = get_args(hint)
    return [part for one in inner for part in parts(one)] if inner else [hint]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda kind: kind.__name__)
def test_every_number_has_a_range_every_option_a_description_and_no_case_leaves_them(options):
    hints, fields = get_type_hints(options), dataclasses.fields(options)
    numbers = {field.name for field in fields if {int, float} & set(parts(hints[field.name]))}
    assert numbers == set(options.RANGES)
    words = {field.name for field in fields if hints[field.name] is str} - {"acquisition", "dem_file", "name"}
    assert words == set(options.WORDS)
    said = descriptions(options)
    assert list(said) == [field.name for field in fields] or set(said) == {field.name for field in fields}
    assert all(said.values())


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.name)
def test_keys_have_the_defaults_ranges_and_units_of_the_options(family):
    schema = scene_model(family.name).model_json_schema()
    listed = {"missing", "unreadable", "blurred", "water"}  # may hold text too
    for name, (low, high) in family.options.RANGES.items():
        if name in listed:
            continue
        text = json.dumps(schema["properties"][name])
        assert f'"minimum": {float(low)}' in text or f'"minimum": {int(low)}' in text, name
        assert f'"maximum": {float(high)}' in text or f'"maximum": {int(high)}' in text, name
    for name, words in family.options.WORDS.items():
        assert schema["properties"][name]["enum"] == list(words)
    assert schema["properties"]["case"]["anyOf"][0].get("enum", list(family.cases)) == list(family.cases)
    for field in dataclasses.fields(family.options):
        default = schema["properties"][field.name].get("default")
        if isinstance(field.default, int | float | str):
            assert default == field.default, field.name


def test_the_printed_schema_holds_every_family_and_kind():
    schema = json_schema("scene")
    assert len(schema["anyOf"]) == len(FAMILIES)
    assert {family.kind for family in FAMILIES} == set(KINDS)
    assert option_checks.MOST_SEED == MOST_SEED
    described = [key for part in schema["$defs"].values() for key in part["properties"].values()]
    assert all(re.search(r"\w", key["description"]) for key in described)
