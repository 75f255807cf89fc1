"""TDI stages of a band: numbers, tables, choices, tags, and what does not go together."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.imaging.tdi_transfer import Exposure
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.schema import BandSection
from sightline.io.acquisition.stages import read_stages, read_tag_stages, stages_of
from sightline.io.results.tdi_tags import tags_as_bytes
from sightline.tdi.tagging import TdiTags

SHAPE = (40, 6)


def given(tmp_path, **keys):
    """Stages of a band with some keys, its image being of SHAPE."""
    band = BandSection(name="PAN", image="PAN.tif", **keys)
    return stages_of(band, SHAPE, "strip.toml: [[band]] number 1 (PAN)", InputFolder(tmp_path / "strip.toml"))


def table(tmp_path, text, name="stages.csv"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def tags(tmp_path, lines=40, columns=6):
    stages = np.arange(lines)[:, None] % 5 + np.array([[1, 9]])
    zero = np.zeros(stages.shape)
    file = TdiTags(
        np.array([0, 4]), columns, np.array([1.0]), Exposure(0, 1.0, "centre"), 1.0, stages, zero, zero,
        zero, zero, zero, zero, zero, zero, zero,
    )  # fmt: skip
    (tmp_path / "tags.bin").write_bytes(tags_as_bytes(file))
    return stages


def test_one_number_is_of_all_pixels_and_needs_no_reference(tmp_path):
    assert given(tmp_path) is None
    assert given(tmp_path, stages=8).tolist() == [[8] * 6]


def test_a_table_gives_each_column_its_own_in_any_order(tmp_path):
    table(tmp_path, "column,stages\n" + "".join(f"{k},{4 + k}\n" for k in (3, 0, 1, 2, 5, 4)))
    assert given(tmp_path, stages="stages.csv", time_reference="centre").tolist() == [[4, 5, 6, 7, 8, 9]]


def test_a_choice_is_read_for_the_nearest_signal(tmp_path):
    rows = "".join(f"{k},{s},{n}\n" for k in range(6) for s, n in ((10.0, 32), (1000.0, 4)))
    table(tmp_path, "column,signal,stages\n" + rows, "choice.csv")
    assert given(tmp_path, stages="choice.csv", stages_signal=800.0).tolist() == [[4] * 6]
    with pytest.raises(FormatError, match=r"give stages_signal.*differ also time_reference = \"centre\""):
        given(tmp_path, stages="choice.csv")  # one message for both keys that are missing
    with pytest.raises(FormatError, match=r"give stages_signal.*of every line$"):
        given(tmp_path, stages="choice.csv", time_reference="centre")
    with pytest.raises(FormatError, match="beyond its signals, 10 to 1000 electrons"):
        given(tmp_path, stages="choice.csv", stages_signal=5000.0)


def test_tags_give_every_line_its_own(tmp_path):
    stages = tags(tmp_path)
    found = given(tmp_path, stages="tags.bin", time_reference="first-stage")
    assert np.array_equal(found, np.repeat(stages, [4, 2], axis=1))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"stages": 64}, "64 stages are more than the 40 lines of PAN.tif"),
        ({"stages": "stages.csv"}, "time_reference is missing: stages are from 4 to 5"),
        ({"stages": 8, "stages_signal": 10.0}, "leave it out"),
        ({"stages_signal": 10.0}, "without stages"),
        ({"time_reference": "first-stage"}, "time_reference = 'first-stage' is given without stages"),
        ({"stages": "stages.csv", "stages_signal": 10.0}, "has no column 'signal'"),
    ],
)
def test_keys_that_do_not_go_together_are_named(tmp_path, keys, message):
    table(tmp_path, "column,stages\n" + "".join(f"{k},{4 + k // 3}\n" for k in range(6)))
    with pytest.raises(FormatError, match=message):
        given(tmp_path, **keys)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("column,stages\n0,4\n1,4\n", "2 rows are of columns 0 to 1; the image has the columns 0 to 5"),
        ("column,stages\n" + "".join(f"{k + 1},4\n" for k in range(6)), "of columns 1 to 6"),
        ("column,stages\n" + "".join(f"{k},4\n" for k in (0, 1, 2, 2, 3, 4, 5)), "column 2 has two rows"),
        ("column,stages\n0,4.5\n", "stages = 4.5 at column 0; whole numbers from 1"),
        ("column,stages\n0,0\n", "stages = 0 at column 0"),
        ("column,steps\n0,4\n", "column 'stages' is missing"),
    ],
)
def test_wrong_tables_are_named(tmp_path, text, message):
    with pytest.raises(FormatError, match=message):
        read_stages(table(tmp_path, text), 6)


def test_a_table_with_other_separators_is_called_that_also_where_a_signal_is_given(tmp_path):
    path = table(tmp_path, "column;signal;stages\n0;60;4\n")
    with pytest.raises(FormatError, match="values are parted by commas, not by ';'"):
        read_stages(path, 6, 60.0)


def test_tags_of_another_image_are_refused(tmp_path):
    tags(tmp_path, lines=30)
    with pytest.raises(FormatError, match=r"tags of 30 lines x 6 columns, the image has 40 x 6"):
        read_tag_stages(tmp_path / "tags.bin", SHAPE)
