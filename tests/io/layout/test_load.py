"""INSTRUMENT.toml: what it means, and one clear message for what it may not say."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import FormatError
from sightline.estimation.prior import Matern, Tone
from sightline.io.config import json_schema, schema_of
from sightline.io.layout.load import describe_instrument, load_instrument

TEXT = """
name = "four lines"
focal_length_px = 2e5
line_period = 5e-4
ground_rate_px = 2000.0
match_sigma_px = 0.03
detectors = 4
span_px = 344.4
min_spacing_px = 2.0

[[prior]]
sigma_px = 2.0
timescale = 1.0
order = "5/2"

[[prior]]
sigma_px = 0.1
corner = 30.0

[[prior]]
kind = "tone"
sigma_px = 0.3
frequency = 47.0

[[layout]]
name = "ours"
positions_px = [340.0, 0.0, 60.0, 200.0]
"""


@pytest.fixture
def load(tmp_path):
    def read(old="", new=""):
        assert old in TEXT
        path = tmp_path / "instrument.toml"
        path.write_text(TEXT.replace(old, new, 1) if old else TEXT + new)
        return load_instrument(path)

    return read


def test_units_become_seconds_and_pixels(load):
    plane = load()
    assert plane.detectors == 4 and plane.span_px == 344.4 and plane.ground_rate_px == 2000.0
    # a match has the variances of both of its images
    assert plane.image_sigma_px == pytest.approx((0.03 / np.sqrt(2.0),) * 4)
    assert plane.layouts[0].positions == pytest.approx([0.17, 0.0, 0.03, 0.1])
    drift, broadband, tone = plane.prior.components
    assert drift == Matern(2.0, 1.0, "5/2") and tone == Tone(0.3, 47.0, 0.01 * 47.0)
    assert broadband.corner == pytest.approx(30.0) and broadband.order == "3/2"


def test_the_span_may_be_given_in_seconds_and_the_rate_by_the_lines(load):
    plane = load("ground_rate_px = 2000.0\n", "")
    assert plane.ground_rate_px == pytest.approx(2000.0)
    assert load("span_px = 344.4", "span_s = 0.1722").span_px == pytest.approx(344.4)


def test_lines_of_one_detector_are_a_number_or_places(load):
    assert load("span_px = 344.4", "lines = 8").lines == pytest.approx(np.arange(8))
    assert load("span_px = 344.4", "lines = [7, 0, 3, 20.5]").lines == pytest.approx([0, 3, 7, 20.5])


def test_images_may_differ_in_their_noise(load):
    plane = load("match_sigma_px = 0.03\ndetectors = 4", "image_sigma_px = [0.02, 0.02, 0.05]")
    assert plane.image_sigma_px == (0.02, 0.02, 0.05)


def test_tdi_stages_are_of_all_images_or_of_each(load):
    assert load().stages == () and load().noise.tdi == ()
    plane = load("detectors = 4", "detectors = 4\nstages = 16")
    assert plane.stages == (16,) * 4 and plane.noise.tdi == pytest.approx((8e-3,) * 4)
    plane = load("detectors = 4", "detectors = 4\nstages = [16, 32, 1, 16]")
    assert plane.noise.tdi == pytest.approx((8e-3, 16e-3, 0.0, 8e-3))
    said = " ".join(describe_instrument(plane)["observable"])
    assert "TDI of 16, 32 stages averages motion away at 125, 62.5 Hz and its multiples" in said


def test_it_is_described_in_words(load):
    said = describe_instrument(load())
    text = " ".join(said["understood"] + said["observable"])
    for words in (
        "4 detectors",
        "one pixel is 5 urad",
        "0.5 ms of lag",
        "344.4 px (172.2 ms)",
        "up to 1000 Hz",
    ):
        assert words in text
    assert "ours: all pairs blind at 100, 200," in text and said["missing"] == []
    bare = load('\n[[layout]]\nname = "ours"\npositions_px = [340.0, 0.0, 60.0, 200.0]\n', "")
    assert any("[[layout]]" in words for words in describe_instrument(bare)["missing"])
    odd = describe_instrument(load("ground_rate_px = 2000.0", "ground_rate_px = 1000.0"))["missing"]
    assert any("0.5 px in a line period" in words for words in odd)


BAD = [
    ("focal_length_px = 2e5", "focal_lenght_px = 2e5", "did you mean focal_length_px"),
    ("focal_length_px = 2e5\n", "", "'focal_length_px' is missing"),
    ("line_period = 5e-4", "line_period = -5e-4", "line_period = -0.0005 is not allowed"),
    ("match_sigma_px = 0.03", "match_sigma_px = 0", "match_sigma_px = 0 is not allowed"),
    ("match_sigma_px = 0.03", "match_sigma_px = nan", "match_sigma_px = nan is not allowed"),
    ("match_sigma_px = 0.03\n", "", "either match_sigma_px, or image_sigma_px"),
    ("match_sigma_px = 0.03", "image_sigma_px = [0.1, 0.1]", "holds 2 values, but there are detectors = 4"),
    ("match_sigma_px = 0.03\ndetectors = 4", "image_sigma_px = [0.1]", "holds 1 values"),
    ("detectors = 4\n", "", "'detectors' is missing"),
    ("detectors = 4", "detectors = 4\nstages = 0", "stages = 0 is not allowed"),
    (
        "detectors = 4",
        "detectors = 4\nstages = [16, 32]",
        "stages holds 2 values, but there are detectors = 4",
    ),
    ("detectors = 4", 'detectors = 4\nstages = "many"', "stages = 'many' is not allowed"),
    ("detectors = 4", "detectors = 1", "detectors = 1 is not allowed"),
    ("detectors = 4", "detectors = 200", "detectors = 200 is not allowed"),
    ("detectors = 4", "detectors = 64\nstep_px = 6.0", "do not fit: there is room for 58"),
    ("span_px = 344.4\n", "", "either span_px or span_s"),
    ("span_px = 344.4", "span_px = 344.4\nspan_s = 0.2", "either span_px or span_s"),
    ("span_px = 344.4", "span_px = 344.4\nlines = 12", "span_px is then not taken"),
    ("span_px = 344.4", "lines = 3\n", "room for 2"),
    ("span_px = 344.4", "lines = [0, 3, 3, 8]\n", "holds a place twice"),
    ("span_px = 344.4", 'lines = "all"\n', "lines = 'all' is not allowed"),
    ("timescale = 1.0", "timescale = 1.0\ncorner = 2.0", "either timescale"),
    ("timescale = 1.0", "frequency = 1.0", 'kind = "matern" takes no frequency'),
    ("frequency = 47.0", "", "needs frequency"),
    ('kind = "tone"', 'kind = "sine"', "prior[3].kind = 'sine' is not known"),
    ('order = "5/2"', 'order = "2"', "prior[1].order = '2' is not known"),
    ("positions_px = [340.0, 0.0, 60.0, 200.0]", "positions_px = [1.0]", "two or more positions"),
    ("positions_px = [340.0, 0.0, 60.0, 200.0]", "positions_px = [1.0, 1.0]", "same place"),
    ("positions_px = [340.0, 0.0, 60.0, 200.0]", "", "either positions_px or positions_s"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=[message for *_, message in BAD])
def test_the_error_of_a_wrong_file_says_what_is_allowed(load, old, new, message):
    with pytest.raises(FormatError) as caught:
        load(old, new)
    assert "instrument.toml: " in str(caught.value) and message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_kind_of_a_file_is_known_from_its_keys(tmp_path, load):
    load()
    assert schema_of(tmp_path / "instrument.toml") == "instrument"
    for text in ("", "[platform]\nkind = 'x'\n", "colour = 1\n"):
        (tmp_path / "other.toml").write_text(text)
        assert schema_of(tmp_path / "other.toml") == "acquisition"


def test_the_schema_describes_every_key():
    schema = json_schema("instrument")
    assert {"focal_length_px", "prior", "layout", "lines"} <= set(schema["properties"])
    assert all("description" in key for key in schema["properties"].values())
