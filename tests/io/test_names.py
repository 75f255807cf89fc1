"""Names that hold anything: as text, as names of files, as strings of TOML."""

from __future__ import annotations

import json
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.errors import printable, shortened
from sightline.io.formats.json_text import json_text
from sightline.io.names import file_stem, file_stems, single_words, toml_string
from sightline.report.style import labels, wrapped

ANY = st.text(st.characters(), max_size=40)


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("strip 7, ‘blue’ – אב 波 é", "strip 7, ‘blue’ – אב 波 é"),
        ("\x1b[31mred\x9b0m\x07", "\\x1b[31mred\\x9b0m\\x07"),
        ("two\nlines\r\n\tand\u2028more", "two\\nlines\\r\\n\\tand\\u2028more"),
        ("\u202egnp.txt\u2066", "\\u202egnp.txt\\u2066"),
        ("byte \udcff", "byte \\udcff"),
    ],
)
def test_what_steers_is_shown_as_its_number(name, shown):
    assert printable(name) == shown


@given(ANY)
def test_text_is_one_line_that_can_be_written(name):
    text = printable(name)
    assert len(text.splitlines()) <= 1 and text.encode().decode() == text == printable(text)


@given(ANY)
def test_json_says_the_same_and_steers_nothing(name):
    text = json_text({"name": name})
    assert json.loads(text) == {"name": name} and printable(text.replace("\n", "")) == text.replace("\n", "")


@given(st.text(max_size=40))
def test_a_toml_string_says_the_name(name):
    assert tomllib.loads(f"name = {toml_string(name)}") == {"name": name}


def test_halves_of_characters_have_no_place_in_toml():
    assert tomllib.loads(f"name = {toml_string(chr(0xDCFF))}") == {"name": "\\udcff"}


@pytest.mark.parametrize(
    ("name", "stem"),
    [
        ("PAN", "PAN"), ("B 1/2", "B_1_2"), ("../x", "_x"), ("..", "_"), ("", "_"), (".hidden", "hidden"),
        ("CON", "_CON"), ("nul.tif", "_nul.tif"), ("Console", "Console"), ("a\0b\n", "a_b_"),
        ("波長", "波長"), ("C:\\x", "C__x"), ("e" * 5000, "e" * 120), ("é" * 5000, "é" * 60),
        ("x" + "é" * 99, "x" + "é" * 59),
    ],
)  # fmt: skip
def test_names_as_names_of_files(name, stem):
    assert file_stem(name) == stem


@given(st.lists(ANY, max_size=8))
def test_files_of_names_lie_in_one_folder_each_by_itself(names):
    stems = file_stems(names)
    assert len({stem.casefold() for stem in stems}) == len(names)
    for stem in stems:
        assert stem and not stem.startswith(".") and not set('/\\:*?"<>|\0\n') & set(stem)
        assert len(stem.encode()) < 130


def test_names_of_one_file_get_numbers():
    assert file_stems(["a/b", "a_b", "A b", "c", "a_b_2"]) == ("a_b", "a_b_2", "A_b_3", "c", "a_b_2_2")


def test_names_as_single_words():
    assert single_words(["a b", "a_b", "a\nb", " "]) == ("a_b", "a_b_2", "a\\nb", "_")


def test_the_middle_of_long_text_is_left_out():
    assert shortened("abcdefghij", 10) == "abcdefghij"
    assert shortened("abcdefghijk", 10) == "abcdef…ijk"


def test_labels_of_figures_are_literal_short_and_apart():
    assert labels(["<b>\n\x1b"]) == ["<b>\\n\\x1b"]
    long = labels([f"{'a' * 50}{middle}{'z' * 50}" for middle in "123"])
    assert len(set(long)) == 3 and max(map(len, long)) <= 30
    assert wrapped(f"yaw of camera <i> against camera {'n' * 5000}").count("\n") in (1, 2)
