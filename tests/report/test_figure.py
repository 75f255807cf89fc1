"""Figures as SVG: what is drawn is what is given, whatever it holds; axes, keys, maps."""

from __future__ import annotations

import base64
import re
import warnings
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio

from sightline.report.axes import Axis, linear_ticks, log_ticks, number
from sightline.report.figure import Figure
from sightline.report.marks import FINE, Bars, Between, Line, Map, Note, Points, Rules, Spans
from sightline.report.style import AFTER, AXIS_COLOURS, BEFORE, BLIND, DOUBT, INK, MUTED

HOSTILE = "<script>alert(1)</script>\"'&\x1b[31m\u202e\nx"


def drawn(figure):
    """The drawing as XML, which it has to be."""
    return ElementTree.fromstring(str(figure.html("figure-a")))


def points(path):
    """Places (px) that the ``d`` of a line goes through."""
    out = []
    for letter, body in re.findall(r"([Ml])([^A-Za-z]*)", path.get("d")):
        for x, y in np.array(re.findall(r"-?\d+", body), dtype=float).reshape(-1, 2) / FINE:
            out.append([x, y] if letter == "M" else [out[-1][0] + x, out[-1][1] + y])
    return np.array(out)


def named(root, name):
    return [path for path in root.iter() if path.get("data-n") == name]


def back(root, places):
    """Places (px) as values of the one panel."""
    panel = next(g for g in root.iter() if g.get("class") == "panel")
    left, top, width, height = map(float, panel.get("data-box").split())
    share = (places - [left, top]) / [width, height] * [1.0, -1.0] + [0.0, 1.0]
    out = []
    for k, axis in enumerate((panel.get("data-x"), panel.get("data-y"))):
        low, high, log, _ = map(float, axis.split())
        out.append(low * (high / low) ** share[:, k] if log else low + (high - low) * share[:, k])
    return np.array(out).T


@pytest.mark.parametrize("log", [False, True])
def test_a_line_goes_through_its_points(log):
    x, y = np.linspace(2.0, 7.0, 40), np.geomspace(0.01, 3.0, 40)
    figure = Figure()
    figure[0].add(Line(x=x, y=y, name="a"))
    figure[0].y.log = log
    root = drawn(figure)
    found = back(root, points(named(root, "a")[0]))
    # paths are in tenths of a px of some 180 px
    np.testing.assert_allclose(found[:, 0], x, atol=5.0 * 0.1 / 900)
    np.testing.assert_allclose(found[:, 1], y, atol=3.0 * 0.1 / 180, rtol=0.01 if log else 0.0)


def test_what_is_not_finite_is_left_out_and_no_line_is_drawn_across_it():
    y = np.array([1.0, 2.0, np.nan, 3.0, np.inf, 4.0, 5.0])
    figure = Figure(2)
    t = np.arange(7.0)
    look = {"sigma": np.where(np.isfinite(y), 0.1, np.inf), "symbol": "ring", "name": "dots"}
    figure[0].add(
        Line(x=t, y=y, name="a"), Points(x=t, y=y, **look), Between(x=t, low=y - 1, high=y, name="b")
    )
    figure[1].add(Line(x=t, y=np.full(7, np.nan), name="none"), Rules(y=[np.inf]))
    figure[1].add(Bars(place=t, length=y, thick=1.0))
    text = str(figure.html("figure-a"))
    assert not re.search(r"nan|inf", re.sub(r"info\w*", "", text.lower()))
    root = ElementTree.fromstring(text)
    assert named(root, "a")[0].get("d").count("M") == 3
    assert named(root, "dots")[0].get("d").count("M") == 5


def test_figures_of_nothing_are_drawn():
    figure = Figure(1, 2, shared=False)
    figure[0, 0].add(Line(x=[], y=[], name="none"), Points(x=[], y=[]), Note(words="nothing"))
    assert "nothing" in "".join(drawn(figure).itertext())


def test_a_curve_of_very_many_points_keeps_its_spikes_and_becomes_small():
    y = np.random.default_rng(0).normal(size=200_000)
    y[[777, 150_001]] = 40.0, -40.0
    figure = Figure()
    t = np.arange(200_000.0)
    figure[0].add(Between(x=t, low=y - 1.0, high=y + 1.0), Line(x=t, y=y, name="a"))
    root = drawn(figure)
    assert len(str(figure.html("figure-a"))) < 80_000
    found = back(root, points(named(root, "a")[0]))
    assert [found[:, 1].min(), found[:, 1].max()] == pytest.approx([-40.0, 40.0], abs=0.1)
    assert found[found[:, 1].argmax(), 0] == pytest.approx(777.0, abs=200_000 / 900)


def test_names_are_text_whatever_they_hold():
    figure = Figure()
    figure[0].add(
        Points(x=[1.0, 2.0], y=[1.0, 2.0], name=HOSTILE, says=[HOSTILE, "b"], texts=[HOSTILE, ""]),
        Map(x=[1.0, 2.0], y=[1.0, 2.0], z=np.eye(2), names=[(HOSTILE, "#ff0000"), ("b", "#0000ff")]),
        Note(words=HOSTILE),
    )
    panel = figure[0]
    panel.title = panel.x.title = panel.y.title = HOSTILE
    panel.x.ticks = [(1.0, HOSTILE)]
    root = drawn(figure)
    assert not any("script" in element.tag for element in root.iter())
    assert "<script>alert(1)" in "".join(root.itertext()) and "\x1b" not in "".join(root.itertext())


def test_the_key_has_every_name_once_and_says_what_is_drawn():
    figure = Figure(2)
    for panel in figure.panels:
        panel.add(Line(x=[0.0, 1.0], y=[1.0, 2.0], name="a"), Spans(spans=[(0.2, 0.4)], name="shade"))
        panel.add(Line(x=[0.0, 1.0], y=[1.0, 2.0], name="silent", key=False))
        panel.y.title = "height (m)"
    assert list(figure.keys()) == ["a", "shade"]
    root = drawn(figure)
    svg = next(e for e in root.iter("svg") if e.get("class") == "drawn")
    assert svg.get("role") == "img" and svg.get("aria-labelledby") == "figure-a-title"
    assert "height (m) against" in root.find(".//desc").text and "a; shade" in root.find(".//desc").text


@pytest.mark.parametrize(
    ("low", "high", "room", "expected"),
    [
        (0.0, 1.0, 5, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-3.0, 3.0, 4, [-2.0, 0.0, 2.0]),
        (0.0, 7e5, 4, [0.0, 2e5, 4e5, 6e5]),
    ],
)
def test_ticks_are_round(low, high, room, expected):
    np.testing.assert_allclose(linear_ticks(low, high, room), expected, atol=1e-12)


def test_ticks_of_a_logarithmic_axis_are_decades_or_more():
    np.testing.assert_allclose(log_ticks(1e-9, 1e3, 6)[:2], [1e-9, 1e-7])
    np.testing.assert_allclose(log_ticks(0.09, 11.0, 6), [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
    # within less than a decade as on any axis: there are several
    assert len(log_ticks(3.0, 7.0, 5)) >= 4
    assert all(len(log_ticks(1.0, 1.5 * k, 5)) >= 2 for k in range(1, 2000))


def test_numbers_beside_an_axis_are_short():
    said = [number(v) for v in (0.0, -0.25, 20_000.0, 1e-7, 2.5e9)]
    assert said == ["0", "−0.25", "20,000", "10⁻⁷", "2.5×10⁹"]


def test_an_axis_of_one_value_has_a_length():
    for value in (0.0, 5.0, -5.0):
        low, high = Axis().range([np.array([value])])
        assert low < value < high
    assert Axis(from_zero=True).range([np.zeros(3)]) == (0.0, pytest.approx(0.5, rel=0.1))
    # nothing that a logarithm could show
    assert Axis(log=True).range([np.array([-1.0, 0.0])]) == pytest.approx((0.1, 1.0), rel=0.2)


def decoded(address):
    """Numbers of the colours of a palette PNG, read by GDAL."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.MemoryFile(base64.b64decode(address.split(",")[1])) as file, file.open() as picture:
            return picture.read(1)


@pytest.mark.parametrize("downward", [False, True])
def test_a_map_runs_as_its_axes_do(downward):
    figure = Figure()
    figure[0].y.downward = downward
    figure[0].add(Map(x=[0.0, 1.0], y=[0.0, 1.0], z=np.array([[0.0, 1.0], [2.0, np.nan]]), high=2.0, bar="v"))
    found = decoded(next(e for e in drawn(figure).iter("image") if e.get("data-stops")).get("href"))
    # the first row is the least y: at the bottom, unless the axis runs down; the last code is no value
    rows = [[0, 127], [254, 255]]
    assert found.tolist() == (rows if downward else rows[::-1])


@pytest.mark.parametrize("height", [60, 235, 600])
def test_the_scale_beside_a_map_stays_on_the_drawing(height):
    figure = Figure(height=height)
    figure[0].add(Map(x=[0.0, 1.0], y=[0.0, 1.0], z=np.eye(2), high=0.5, bar="merit lost (%)"))
    texts = [text for text in drawn(figure).iter("text") if text.text == "merit lost (%)"]
    assert [float(text.get("x")) < 1080.0 - 4.0 for text in texts] == [True]


def test_cells_of_a_logarithmic_axis_are_as_wide_as_they_are():
    figure = Figure(height=300)
    figure[0].y.log = figure[0].y.tight = True
    y = np.array([1.0, 10.0, 1000.0])
    figure[0].add(Map(x=[0.0, 1.0], y=y, z=np.arange(6.0).reshape(3, 2), high=5.0, bar="v"))
    image = next(e for e in drawn(figure).iter("image") if e.get("data-stops"))
    # from half a decade below 1 to a decade above 1000
    assert float(image.get("height")) / FINE == pytest.approx(300.0, abs=0.2)
    assert image.get("data-range") == "0 5 0"


def luminance(colour):
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_colours_stand_out_from_the_paper():
    # 3 to 1 is what lines need, 4.5 to 1 what text does
    for colour in (*AXIS_COLOURS, BEFORE, AFTER, DOUBT):
        assert 1.05 / (luminance(colour) + 0.05) > 3.0, colour
    for colour in (INK, MUTED):
        assert 1.05 / (luminance(colour) + 0.05) > 4.5, colour
    assert BLIND
