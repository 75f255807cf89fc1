"""Names that would be code, markup or commands are shown as they are on every page, and do nothing anywhere.

Each case is a small problem whose every name (title, bands, cameras, frames, files, folders) is hostile,
taken through the commands. What a page holds is read with a parser, then by a browser where there is one.
"""

from __future__ import annotations

import csv
import json
import re
from html.parser import HTMLParser
from importlib.resources import files

import pytest
from tests.test_cli_layout import BAND
from tests.test_cli_layout import TEXT as LAYOUT
from tests.test_cli_orient import write_strips
from tests.test_cli_spin import write_acquisition
from tests.test_cli_tdi import TEXT as TDI

from sightline.cli.main import run
from sightline.io.formats.colmap import read_colmap_model
from sightline.io.formats.opensfm import read_opensfm
from sightline.io.names import printable, toml_string
from sightline.io.results.poses import read_pose_covariance, read_pose_table

SCRIPT = "<script>document.title='pwned';window.pwned=1</script>{{7*7}}"
IMAGE = '"><img src=x onerror=window.pwned=1>../../outside'
CLOSING = "</script><script>window.pwned=1</script><a href='javascript:window.pwned=1'>x</a> $x^2$ %{x} &lt;"
#: Codes of a terminal, a line like one of our own, cells of a table, marks that turn writing round.
STEERING = '\x1b[31mred\x07\x9b1m, "quoted"\nsightline: error: forged\r\n\u202eleft\u2066'
#: The longest that a TOML file may give, and one of a table.
LONG, ENDLESS = "n" * 500, "n" * 5000
NAMES = (SCRIPT, IMAGE + STEERING, CLOSING, LONG)
TITLE = (SCRIPT + STEERING + LONG)[:500]
#: What a file system takes, and a TOML file; a file "script>" in a folder of such a name makes </script>.
PLAIN = "<script>window.pwned=1<{{7*7}},\"'"
FILE = PLAIN + "\n\x1b[31m"


def hostile_folder(base):
    folder = base / FILE / "script>"
    folder.mkdir(parents=True)
    return folder


def renamed(toml, names, files):
    """A TOML file whose title, names and files of images are hostile; its files are renamed beside it."""
    title = re.compile(r'(\[(?:acquisition|sequence|stereo)\]\n|^\n)name = ".*"')
    text = title.sub(lambda found: f"{found[1]}name = {toml_string(TITLE)}", toml.read_text(), count=1)
    for old, new in names.items():
        text = text.replace(f'name = "{old}"', f"name = {toml_string(new)}")
    for number, old in enumerate(files):
        new = f"{PLAIN}{number}{old[-4:]}"
        (toml.parent / old).rename(toml.parent / new)
        text = text.replace(f'"{old}"', toml_string(new))
    toml.write_text(text, encoding="utf-8")
    return toml


def with_cells(path, changes):
    """A table with other words in some columns: from column to old word to new word."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        row.update({name: new[row[name]] for name, new in changes.items() if name in row})
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, rows[0], quoting=csv.QUOTE_ALL)
        table.writeheader()
        table.writerows(rows)


def strip(base, command):
    """A strip, its bands registered, and a TDI detector set by it."""
    folder = hostile_folder(base)
    size = ["--lines", "340", "--columns", "144"]
    command("simulate", "line-of-sight", "--seed", "3", *size, "--out", folder / "strip")
    bands = dict(zip(("PAN", "B1", "B0", "B2"), NAMES, strict=True))
    toml = renamed(folder / "strip" / "acquisition.toml", bands, [f"{band}.tif" for band in bands])
    toml.write_text(toml.read_text() + "\n[matching]\npasses = 1\n")
    command("check", toml)
    command("recover", toml, "--out", base / "recovered")
    command("register", toml, "--motion", base / "recovered", "--out", base / "registered")
    made = sorted(entry.name for entry in (base / "registered").iterdir())
    assert len(made) == 6 and sum(name.endswith(".tif") for name in made) == 4
    tdi = folder / "tdi.toml"
    tdi.write_text(
        TDI.replace('table = "columns.csv"', 'acquisition = "strip/acquisition.toml"\nband = "PAN"')
    )
    tdi.write_text(tdi.read_text().replace('"PAN"', toml_string(SCRIPT)).replace("to = 64", "to = 32"))
    renamed(tdi, {}, [])
    command("tdi", tdi, "--motion", base / "recovered", "--no-pictures", "--out", base / "tdi")
    shown = [SCRIPT, CLOSING, IMAGE + STEERING]
    return {"recovered": shown, "registered": shown, "tdi": []}


def frames(base, command):
    """Photographs of a matrix instrument."""
    folder = hostile_folder(base) / "photographs"
    few = ["--frames", "2", "--set", "interval=4"]
    command("simulate", "line-of-sight", "--case", "frames", *few, "--out", folder)
    toml = renamed(folder / "acquisition.toml", {}, ["frame-000.tif", "frame-001.tif"])
    names = iter((CLOSING, IMAGE + STEERING))
    toml.write_text(
        re.sub(r"(?<=\[\[frame\]\]\n)", lambda _: f"name = {toml_string(next(names))}\n", toml.read_text())
    )
    command("recover", toml, "--out", base / "recovered")
    return {"recovered": [CLOSING, IMAGE + STEERING]}


def spin(base, command):
    """Frames of a camera that spins, with strips of filters."""
    toml = write_acquisition(
        hostile_folder(base), (SCRIPT, CLOSING + STEERING, LONG), PLAIN.replace("{{7*7}}", "") + "{}.npy"
    )
    toml.write_text(toml.read_text().replace('"turning"', toml_string(TITLE)))
    command("recover", toml, "--out", base / "recovered")
    return {"recovered": [SCRIPT, CLOSING + STEERING]}


def layout(base, command):
    """Places of detectors, beside one of the user's."""
    toml = hostile_folder(base) / f"{FILE}.toml"
    text = LAYOUT.replace('"<b>three</b> lines"', toml_string(TITLE)).replace("= 3\n", "= 2\n")
    text = text.replace('"ours"', toml_string(CLOSING + STEERING))
    toml.write_text(f'{text}\n[[layout]]\nname = "{LONG}"\npositions_px = [0, 10]\n')
    command("layout", toml, *BAND, "--count", "2", "--out", base / "layouts")
    return {"layouts": [CLOSING + STEERING]}


def stereo(base, command):
    """Cameras of two spacecraft, and what they would give."""
    folder = hostile_folder(base) / "pass"
    command("simulate", "stereo", "--seed", "1", "--shots", "6", "--points", "40", "--out", folder)
    cameras = {"camera": {"1": SCRIPT + STEERING, "2": CLOSING + ENDLESS}}
    with_cells(folder / "cameras.csv", cameras)
    with_cells(folder / "orientation-truth.csv", cameras)
    toml = renamed(folder / "stereo.toml", {}, ["cameras.csv", "matches.csv"])
    command("check", toml)
    command("orient", toml, "--out", base / "oriented")
    command("score", base / "oriented", folder / "orientation-truth.csv")
    command("orient", toml, "--predict", "--out", base / "predicted")
    assert len(list((base / "oriented").glob("attitude_*.aem"))) == 2
    for path in (base / "oriented").glob("attitude_*.aem"):
        assert all(len(line) < 255 for line in path.read_text(encoding="utf-8").splitlines())
    return {"oriented": [SCRIPT + STEERING, CLOSING], "predicted": [SCRIPT + STEERING, CLOSING]}


def stereo_strips(base, command):
    """Strips of push-broom cameras, whose names become names of files: of one and the same file, here."""
    folder = hostile_folder(base)
    write_strips(folder, names := ("../<img src=x>{{7*7}}", ".._<img src=x>{{7*7}}"))
    toml = folder / "stereo.toml"
    toml.write_text(f'{toml.read_text()}\n[stereo]\nname = "pair"\n')
    renamed(toml, {}, ["observations.csv", "control.csv"])
    command("orient", toml, "--out", base / "oriented")
    assert len(list((base / "oriented").glob("attitude_*.csv"))) == 2
    return {"oriented": list(names)}


def flight(base, command):
    """Frames of a flight, with maps and all that is written for other programs."""
    folder = hostile_folder(base) / "flight"
    size = ["--frames", "12", "--set", "truth_bands=0", "--set", "unreadable=5"]
    command("simulate", "frames", "--case", "small", *size, "--seed", "1", "--out", folder)
    odd = (*NAMES[:3], ENDLESS, "=1+1", "#comment", "a b", "a_b", "../x", "CON", ".hidden", "'q'")
    names = {str(k): f"{name}{k}" for k, name in enumerate(odd)}
    pictures = {f"frames/frame-{k:05d}.tif": f"{FILE}/{k}{FILE}.tif" for k in range(12)}
    (folder / FILE).mkdir()
    for old, new in pictures.items():
        (folder / old).rename(folder / new)
    for table in ("frames", "positions", "attitudes", "poses-truth"):
        with_cells(folder / f"{table}.csv", {"frame": names, "image": pictures})
    toml = renamed(folder / "sequence.toml", {}, ["frames.csv", "positions.csv"])
    toml.write_text(toml.read_text().replace("[world]\n", "[world]\norigin = [5.0, 44.0, 0.0]\n"))
    command("check", toml)
    command("georeference", toml, "--out", out := base / "located")
    command("score", out, folder / "poses-truth.csv")
    assert {entry.suffix for entry in (out / "bands").iterdir()} == {".tif"}
    given = tuple(names.values())
    assert read_pose_table(out / "poses.csv").frames == given
    assert read_pose_covariance(out / "covariance.npz").frames == given
    places = json.loads((out / "footprints.geojson").read_text())["features"]
    assert {place["properties"]["frame"] for place in places} <= set(given)
    for model in (read_colmap_model(out / "colmap"), read_opensfm(out / "reconstruction.json")[0]):
        assert len(set(model.names)) == 12
    assert len((out / "geo.txt").read_text(encoding="utf-8").splitlines()) == 13
    return {"located": ["#comment5"]}


CASES = (strip, frames, spin, layout, stereo, stereo_strips, flight)


@pytest.fixture
def command(tmp_path, capsys):
    """Runs a command that has to succeed, and looks at its lines: a terminal only shows them."""

    def call(*words):
        assert run([str(word) for word in words]) == 0, capsys.readouterr().err
        said = capsys.readouterr()
        lines = said.out.split("\n") + said.err.split("\n")
        assert all(line.isprintable() or printable(line) == line for line in lines)
        assert all(line.startswith("sightline: ") for line in said.err.split("\n")[:-1])
        assert not any(line.startswith("sightline: error") for line in lines)

    return call


#: The one script of all pages.
OURS = (files("sightline.report") / "page.js").read_text(encoding="utf-8")


class Page(HTMLParser):
    """What an HTML file holds: elements with their attributes, scripts, and text outside them."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.scripts, self.words, self._inside = [], [], [], ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self._inside = tag

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside in ("script", "style"):
            self.scripts.append(data)
        else:
            self.words.append(data)


def on_one_page(name):
    """How a page shows a name: on one line, a word of thousands of letters without its middle."""
    return [word for word in printable(name).split() if len(word) < 160]


def check_text(path, shown):
    """Our script and no other, no handler, nothing from elsewhere, names in the text."""
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    style, script = page.scripts
    assert "--ink" in style and script.strip() == OURS.strip()
    assert len(text) < 1e6
    for tag, attributes in page.elements:
        assert tag in TAGS, tag
        assert not any(name.startswith("on") for name in attributes)
        for name in ("href", "src", "action", "srcset"):
            assert attributes.get(name, "#").startswith(("#", "data:image/png;base64,", "data:,"))
    words = re.sub(r"\s+", " ", "".join(page.words))
    for name in [SCRIPT + "\x1b[31mred", *shown]:
        for word in on_one_page(name):
            assert word in words, word
    # names are in tags as values that are shown alone: under the pointer, and to who hears the page
    bare = re.sub(r' (?:data-[a-z]+|aria-label|alt)="[^"<>]*"', "", text)
    assert "pwned" not in "".join(re.findall(r"<(?!/?title)[^>]*pwned[^>]*>", bare))


TAGS = set(
    "html head meta title link style script body header h1 h2 h3 p nav a main section div span strong small "
    "ul li dl dt dd table thead tbody tr th td figure img figcaption details summary input footer h3 "
    "svg g path text tspan image circle desc clippath".split()
)


#: Moves a pointer over the first point of each curve and over each map.
HOVER = """
for (const mark of document.querySelectorAll("svg.drawn [data-n], svg.drawn [data-stops]")) {
    const box = mark.getBoundingClientRect();
    for (const [x, y] of [[box.x + 1, box.y + 1], [box.x + box.width / 2, box.y + box.height / 2]])
        mark.dispatchEvent(new PointerEvent("pointermove", {bubbles: true, clientX: x, clientY: y}));
}
"""


#: Is there once the page is laid out at its new size and drawn.
DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_names_are_shown_and_do_nothing(case, tmp_path, command, request):
    before = {entry.name for entry in tmp_path.iterdir()}
    shown = case(tmp_path, command)
    assert {entry.name for entry in tmp_path.iterdir()} - before == {FILE, *shown}
    for folder, names in shown.items():
        check_text(tmp_path / folder / "report.html", names)
    open_page = request.getfixturevalue("open_page")  # left out from here on where there is no browser
    for folder in shown:
        check_opened(*open_page(tmp_path / folder / "report.html"))


def check_opened(page, problems):
    """No script of a name runs, no width breaks the layout, no label of a point is markup."""
    for width in (400, 900, 1600):
        page.set_viewport_size({"width": width, "height": 900})
        page.evaluate(DRAWN)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    for _ in range(2):  # maps are read once their pictures are there
        page.evaluate(HOVER)
        page.wait_for_timeout(50)
    assert problems == []
    assert page.evaluate("window.pwned") is None and page.title() != "pwned"
    assert page.evaluate("document.querySelectorAll('a[href^=javascript], svg a').length") == 0
