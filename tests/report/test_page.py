"""The report as a whole: it renders in a browser, alone, and says what it shows."""

from __future__ import annotations

import re

import numpy as np
import pytest

from sightline.io.formats.tables import read_motion
from sightline.report import line_of_sight_page
from sightline.report.page import LONGEST_WORD, Page, Section, Table


@pytest.fixture(scope="module")
def text(recovery):
    return (recovery.folder / "report.html").read_text(encoding="utf-8")


def test_the_page_opens_without_an_error_and_asks_nobody_for_anything(recovery, open_page):
    opened, problems = open_page(recovery.folder / "report.html")
    opened.wait_for_timeout(500)
    assert problems == []
    figures = opened.locator("svg.drawn")
    assert figures.count() == 10
    for k in range(figures.count()):
        box = figures.nth(k).bounding_box()
        assert box["width"] > 600 and box["height"] > 200
    loaded = "Array.from(document.images).map(i => i.complete && i.naturalWidth > 50)"
    assert opened.evaluate(loaded) == [True, True]


def test_the_pointer_reads_values_off_curves_and_maps(recovery, open_page):
    opened, problems = open_page(recovery.folder / "report.html")
    said = []
    for section in ("attitude", "residuals"):
        box = opened.locator(f"#{section} svg.drawn").bounding_box()
        opened.evaluate(f"document.getElementById('{section}').scrollIntoView()")
        box = opened.locator(f"#{section} svg.drawn").bounding_box()
        for part in range(10, 120, 4):
            opened.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + part)
            opened.wait_for_timeout(10)
            said.append(opened.locator("#tip").inner_text())
    assert problems == []
    curve = next(text for text in said if text.startswith("roll"))
    assert re.fullmatch(r"roll\ntime from the epoch \(s\): −?[\d.e−]+\nroll \(px\): −?[\d.e−]+", curve)
    cell = next(text for text in said if text.startswith("px: "))
    assert re.search(r"px: −?[\d.e−]+\nline of PAN \(px\): \d+", cell)


@pytest.mark.parametrize("width", [1200, 700])
def test_nothing_sticks_out_of_the_window(recovery, open_page, width):
    opened, _ = open_page(recovery.folder / "report.html")
    opened.set_viewport_size({"width": width, "height": 900})
    opened.wait_for_timeout(300)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize(("width", "fits"), [(900, True), (390, False)])
def test_what_goes_on_to_the_right_says_so_until_its_end_is_seen(recovery, open_page, width, fits):
    opened, problems = open_page(recovery.folder / "report.html")
    opened.set_viewport_size({"width": width, "height": 900})
    opened.wait_for_timeout(300)
    cut = "Array.from(document.querySelectorAll('.scroll')).filter(e => e.scrollWidth > e.clientWidth + 2)"
    count = opened.evaluate(f"{cut}.length")
    hints = opened.locator("p.more:visible")
    assert (count == 0) == fits and hints.count() == count
    if not fits:
        opened.evaluate(f"{cut}.forEach(e => e.scrollLeft = e.scrollWidth)")
        opened.wait_for_timeout(300)
        assert hints.count() == 0
    assert problems == []


def test_the_page_is_small_and_loads_nothing(text):
    addresses = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)["']""", text)
    assert addresses and all(address.startswith(("#", "data:")) for address in addresses)
    assert not re.search(r"@import|fetch\(|https?://|url\((?!#)", text)
    assert text.count("<script>") == 1 and len(text) < 1e6


def test_the_page_says_in_words_what_was_found(text, recovery):
    for words in ("In plain words", "Roll moved by", "cannot show", *recovery.summary["images"]):
        assert words in text
    for warning in recovery.summary["warnings"]:
        assert warning in text
    assert recovery.summary["inputs"]["PAN.tif"] in text


def test_every_figure_has_a_heading_a_caption_and_axes_with_units(recovery):
    sections = line_of_sight_page.figure_sections(recovery.result, recovery.summary)
    assert [section.name for section in sections] == [
        "attitude", "close", "sigma", "spectrum", "seen", "tones", "smear", "residuals", "histogram",
        "matches",
    ]  # fmt: skip
    for section in sections:
        assert section.title and section.parts[0].endswith(".")
        titles = [title for panel in section.figure.panels for title in (panel.x.title, panel.y.title)]
        assert all("(" in title or title in ("share per px", "blind alone") for title in titles), titles


def test_the_truth_is_drawn_over_the_estimate(recovery):
    truth = read_motion(recovery.scene / "truth.csv")
    sections = line_of_sight_page.figure_sections(recovery.result, recovery.summary, truth)
    assert "which the estimate never saw" in sections[0].parts[0]
    for panel in sections[0].figure.panels:
        true, found = panel.named("truth"), next(m for m in panel.marks if m.name in ("roll", "pitch", "yaw"))
        # as well as the page says it is known, and better than the motion is large
        assert np.std(true.y - found.y) < 0.1 * np.std(found.y)


def test_what_a_user_named_is_shown_as_text_not_as_html(recovery):
    summary = recovery.summary | {"name": "<b>strip</b> & co", "warnings": ["<script>alert(1)</script>"]}
    text = line_of_sight_page.line_of_sight_page(recovery.result, recovery.acquisition, summary).html
    assert "&lt;b&gt;strip&lt;/b&gt; &amp; co" in text and "<script>alert" not in text


def test_every_part_of_a_page_is_escaped_and_shortened():
    hostile = "<i>x</i> " + "w" * 500
    table = Table([hostile], [[hostile]], folded=hostile)
    section = Section("a", hostile, [hostile, [hostile], table])
    text = Page(hostile, hostile, hostile, [hostile], [hostile], [section], hostile, mind=hostile).html
    assert "<i>" not in text and text.count("&lt;i&gt;") >= 12
    assert max(map(len, re.findall(r"w+", text))) <= LONGEST_WORD


def test_a_page_that_cannot_be_made_leaves_no_file(tmp_path):
    page = Page("a", "b", "c", [], [], [Section("d", "e", [Table(["f"], [[object]])])], "g")
    object.__setattr__(page, "sections", None)
    with pytest.raises(TypeError):
        page.write(tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []
