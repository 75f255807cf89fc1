"""The report as a whole: it renders in a browser, alone, and says what it shows."""

from __future__ import annotations

import re

import pytest
from plotly.offline import get_plotlyjs

from sightline.report import page


@pytest.fixture(scope="module")
def text(recovery):
    return (recovery.folder / "report.html").read_text(encoding="utf-8")


def test_the_page_opens_without_an_error_and_asks_nobody_for_anything(recovery, open_page):
    opened, problems = open_page(recovery.folder / "report.html")
    opened.wait_for_timeout(500)
    assert problems == []
    figures = opened.locator(".js-plotly-plot")
    assert figures.count() == 10
    # Each figure has been drawn: it has the drawing, of a size that can be seen.
    for k in range(figures.count()):
        box = figures.nth(k).locator("svg.main-svg").first.bounding_box()
        assert box["width"] > 600 and box["height"] > 200
    loaded = "Array.from(document.images).map(i => i.complete && i.naturalWidth > 50)"
    assert opened.evaluate(loaded) == [True, True]


@pytest.mark.parametrize("width", [1200, 700])
def test_nothing_sticks_out_of_the_window(recovery, open_page, width):
    opened, _ = open_page(recovery.folder / "report.html")
    opened.set_viewport_size({"width": width, "height": 900})
    opened.wait_for_timeout(300)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width


def test_the_library_is_inside_once_and_nothing_else_is_loaded(text):
    library = get_plotlyjs()
    assert text.count(library) == 1
    rest = text.replace(library, "")
    addresses = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)["']""", rest)
    assert addresses and all(address.startswith(("#", "data:")) for address in addresses)
    assert not re.search(r"@import|url\(|fetch\(|https?://", rest)
    # What the figures of a small strip add to the library's 5 MB.
    assert len(rest) < 3e6


def test_the_page_says_in_words_what_was_found(text, recovery):
    for words in ("In plain words", "Roll moved by", "cannot tell", *recovery.summary["images"]):
        assert words in text
    for warning in recovery.summary["warnings"]:
        assert warning in text
    assert recovery.summary["inputs"]["PAN.tif"] in text


def test_every_figure_has_a_heading_a_caption_and_axes_with_units(recovery):
    sections = page.sections(recovery.result, recovery.summary)
    assert [section.name for section in sections] == [
        "attitude", "close", "sigma", "spectrum", "seen", "tones", "smear", "residuals", "histogram",
        "matches",
    ]  # fmt: skip
    for section in sections:
        assert section.title and section.caption.endswith(".")
        layout = section.figure.layout
        axes = [layout[key] for key in layout.to_plotly_json() if re.match(r"[xy]axis\d*$", key)]
        titles = [axis.title.text for axis in axes if axis.showticklabels is not False]
        assert all(titles), (section.name, titles)
        plain = {"blind alone", "µrad", "mrad"}
        assert all("(" in title or "per px" in title or title in plain for title in titles), titles


def test_what_a_user_named_is_shown_as_text_not_as_html(recovery):
    summary = recovery.summary | {"name": "<b>strip</b> & co", "warnings": ["<script>alert(1)</script>"]}
    text = page.report_html(recovery.result, recovery.acquisition, summary)
    assert "&lt;b&gt;strip&lt;/b&gt; &amp; co" in text and "<script>alert" not in text


def test_a_page_that_cannot_be_made_leaves_no_file(recovery, tmp_path, monkeypatch):
    def breaks(*_):
        raise RuntimeError("no picture")

    monkeypatch.setattr(page, "composite", breaks)
    with pytest.raises(RuntimeError, match="no picture"):
        page.write_report(tmp_path / "report.html", recovery.result, recovery.acquisition, recovery.summary)
    assert list(tmp_path.iterdir()) == []
