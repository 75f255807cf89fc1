"""The documents say what is there: files, keys, commands, tests."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest
from tests.formats_text import FORMATS

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def quoted(page: Path) -> list[str]:
    """Everything between single backticks outside code blocks."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return re.findall(r"`([^`\n]+)`", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_path_that_a_page_names_exists(page):
    roots = (ROOT, ROOT / "src" / "sightline", page.parent)
    ours = re.compile(
        r"^(?:src|tests|docs|examples|benchmarks|validation|changelog\.d|geometry|estimation|imaging|matching|"
        r"motion|photogrammetry|products|tdi|simulate|applications|evaluation|io|report|kinds|output|cli)/"
        r"[\w./-]*$"
    )
    missing = [
        word
        for word in quoted(page)
        if ours.match(word) and not any((root / word).exists() for root in roots)
    ]
    assert not missing, f"{page.name} names what does not exist: {missing}"


#: Numbers that the rows of each page's claims have together.
CLAIMS = {"s1": range(1, 24), "s2": range(1, 14), "s3": range(1, 8), "s4": range(1, 8)}


@pytest.mark.parametrize("name", sorted(CLAIMS))
def test_every_claim_has_a_command_or_key_and_a_test(name):
    text = (ROOT / "docs" / "theory" / f"{name}.md").read_text(encoding="utf-8")
    table = text[text.index("| # | Claim | Command or key | Test | Result |") :].split("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines()[2:]]
    assert all(len(row) == 5 and all(row) for row in rows)
    numbers = set()
    for number, *_ in rows:
        for part in re.sub(r"\(.*\)", "", number).split(","):  # in brackets: boxes of a figure
            first, _, last = part.strip().partition("-")
            if first.isdigit():
                numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(CLAIMS[name])
    for number, _, _, tests, _ in rows:
        paths = re.findall(r"`((?:tests|validation|benchmarks)/[\w./-]+)`", tests)
        assert paths, f"row {number} names no test"
        missing = [path for path in paths if not (ROOT / path).exists()]
        assert not missing, f"row {number} names what does not exist: {missing}"
    used = set(re.findall(r"`(--[a-z-]+)|`\w+ (?:[^`]*?)(--[a-z-]+)", table))
    options = {word for pair in used for word in pair if word}
    known = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "src/sightline/cli").glob("*.py"))
    assert not [option for option in options if f'"{option}"' not in known and option != "--method"]


def test_from_the_readme_to_a_function_there_are_three_files_at_most():
    text = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    table = text[text.index("| What | Page | File | Function |") :].split("\n\n")[0]
    rows = [re.findall(r"`([^`]+)`", line) for line in table.splitlines()[2:]]
    assert len(rows) == 6
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for page, file, function in rows:
        assert f"]({page})" in readme
        assert file in (ROOT / page).read_text(encoding="utf-8"), f"{page} does not name {file}"
        source = ast.parse((ROOT / "src" / "sightline" / file).read_text(encoding="utf-8"))
        assert function in {node.name for node in source.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_inside_the_repository_leads_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    broken = [link for link in links if ":" not in link and not (page.parent / link).exists()]
    assert not broken


def anchors(page: Path) -> set[str]:
    """Where links into a page may lead: its headings as the web shows them, and anchors of its own."""
    text = page.read_text(encoding="utf-8")
    plain = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    headings = re.findall(r"(?m)^#+ (.+)$", plain)
    found = {re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-") for title in headings}
    return found | set(re.findall(r'<a id="([^"]+)">', text))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_to_a_part_of_a_page_leads_there(page):
    links = re.findall(r"\]\(([^)#:]*)#([^)]+)\)", page.read_text(encoding="utf-8"))
    missing = [
        f"{to}#{part}"
        for to, part in links
        if (not to or to.endswith(".md")) and part not in anchors(page.parent / to if to else page)
    ]
    assert not missing


#: What runs the blocks of commands and Python of a page that are not marked as not run.
RUN_BY = {
    "README.md": (".ci/run", "tests/test_examples.py"),
    "CONTRIBUTING.md": (".ci/run",),
    "docs/flights.md": ("tests/test_examples.py",),
    "docs/python.md": ("tests/test_examples.py",),
    "docs/start.md": ("website/check.py",),
    "docs/stereo.md": ("tests/test_examples.py", "docs/tutorials/stereo.py"),
    "docs/tdi.md": ("tests/test_examples.py",),
    "docs/validation.md": ("Makefile",),  # validate and bench
}


def blocks(page: Path) -> list[tuple[str, str, str]]:
    """Why it is not run (or ""), language and text of each block of a page."""
    found = re.findall(
        r"(?ms)^(?:<!-- not run: ([^\n]+?) -->\n)?```(\w+)[^\n]*\n(.*?)^```", page.read_text("utf-8")
    )
    return [(why, language, body) for why, language, body in found]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_block_of_code_is_run_or_says_why_not(page):
    import tomllib

    for why, language, body in blocks(page):
        if language == "toml":
            assert tomllib.loads(body)
        elif language in ("sh", "python") and not why:
            runners = RUN_BY.get(page.relative_to(ROOT).as_posix(), ())
            assert runners and all((ROOT / one).is_file() for one in runners), (
                f"not run and not marked: {body}"
            )


def test_the_band_that_a_choice_was_set_for_is_one_that_an_acquisition_takes():
    import tomllib

    from sightline.io.acquisition.schema import BandSection

    page = ROOT / "docs" / "tdi.md"
    shown = [tomllib.loads(body) for _, language, body in blocks(page) if language == "toml"]
    (band,) = next(one["band"] for one in shown if "band" in one)
    found = BandSection(**band)
    assert None not in (found.stages, found.stages_signal, found.time_reference)


def test_every_command_of_a_page_has_its_options():
    import shlex

    import click
    from typer.main import get_command

    from sightline.cli.main import app

    def parse(command: click.Command, words: list[str], parent: click.Context | None = None) -> None:
        context = click.Context(command, parent, info_name=command.name)
        values, rest, _ = command.make_parser(context).parse_args(words)
        if isinstance(command, click.Group) and rest and not values.get("help"):
            inner = command.get_command(context, rest[0])
            assert inner is not None, f"there is no command {rest[0]}"
            parse(inner, rest[1:], context)

    lines = [
        line.strip()
        for page in PAGES
        for _, language, body in blocks(page)
        if language == "sh"
        for line in body.splitlines()
        if line.strip().startswith("sightline ")
    ]
    assert len(lines) > 20
    for line in lines:
        words = shlex.split(line, comments=True)
        try:
            parse(get_command(app), words[1:])
        except click.UsageError as error:
            raise AssertionError(f"{line}: {error.format_message()}") from None


def test_directions_point_where_their_page_draws_them():
    import numpy as np

    from sightline.geometry.instrument import LineDetector

    drawn = "x = (c - (columns - 1)/2) ifov,  y = tan(look_ahead),  z = 1"
    assert drawn in FORMATS and "x <---" in FORMATS
    columns, ifov, ahead = 5, 1e-3, 0.1
    line = LineDetector.from_ifov("PAN", columns=columns, ifov=ifov, line_period=1e-4, look_ahead=ahead)
    c = np.arange(columns)
    expected = np.stack(
        [(c - (columns - 1) / 2) * ifov, np.full(columns, np.tan(ahead)), np.ones(columns)], axis=1
    )
    assert np.allclose(line.directions / line.directions[:, 2:], expected, atol=1e-12)
    # x is left and y forward: body axes are x forward, y right (tests/test_conventions.py)


def test_every_page_of_files_is_in_their_contents():
    listed = re.findall(r"\]\(formats/([\w-]+\.md)\)", FORMATS)
    there = {page.name for page in (ROOT / "docs" / "formats").iterdir()}
    assert set(listed) == there and len(listed) == len(there)


def test_every_convention_names_a_test_and_every_test_of_conventions_is_named():
    named = set(re.findall(r"`(test_\w+)`", (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")))
    tree = ast.parse((ROOT / "tests" / "test_conventions.py").read_text(encoding="utf-8"))
    there = {
        node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }
    assert named == there
    rows = [
        line for line in (ROOT / "docs" / "conventions.md").read_text().splitlines() if line.startswith("| ")
    ]
    assert all("test_" in row for row in rows[1:]), "a line of the table names no test"


@pytest.mark.parametrize("name", ["acquisition", "instrument", "sequence", "stereo", "tdi"])
def test_every_key_of_a_file_is_described(name):
    from sightline.io.config import json_schema

    text = FORMATS
    start = text.index(f"## {name.upper()}.toml")
    text = text[start : text.index("\n## ", start + 1)]
    schema = json_schema(name)
    sections = [schema, *schema["$defs"].values()]
    keys = {key for section in sections for key in section.get("properties", {})}
    undescribed = sorted(key for key in keys if not re.search(rf"[`\[.]{key}[`\] ]", text))
    assert not undescribed


def test_the_tables_of_scenes_are_those_of_their_schema():
    from typing import get_args

    from sightline.io.scene.models import FAMILIES, scene_model
    from sightline.io.scene.schema import SceneFile

    text = FORMATS
    text = text[text.index("## SCENE.toml") : text.index("## Tables read")]

    def row(name, field):
        if field.is_required():
            default = "needed"
        elif name == "detectors":
            default = ", ".join(one["name"] for one in field.default)
        else:
            default = "none" if field.default is None else f"`{json.dumps(field.default)}`"
        return f"| `{name}` | {field.description} | {default} |"

    for family in FAMILIES:
        fields = scene_model(family.name).model_fields
        rows = [row(name, field) for name, field in fields.items() if name not in SceneFile.model_fields]
        assert "\n".join(rows) in text, f"keys of {family.name}: write\n" + "\n".join(rows)
        assert f"`simulate {family.kind}`, cases {', '.join(f'`{case}`' for case in family.cases)}." in text
    (detector,) = (kind for kind in get_args(scene_model("orbit").model_fields["detectors"].annotation)[:1])
    rows = [row(name, field) for name, field in detector.model_fields.items()]
    assert "\n".join(rows) in text


#: Where the page describes the summary of each kind of result: from the first text to the second.
SUMMARIES = {
    "LineOfSight": ("### `summary.json`", "## Written by `register`"),
    "Registration": ("## Written by `register`", "### `spin` of"),
    "Mosaic": ("The registered picture that", "## Written by `simulate`"),
    "LayoutChoice": ("## Written by `layout`", "## Written by `orient`"),
    "StereoOrientation": ("## Written by `orient`", "With `--predict` nothing"),
    "StereoPrediction": ("With `--predict` nothing", "`sightline score DIR orientation-truth.csv`"),
    "SequencePoses": ("## Written by `georeference`", "## Written by `noise`"),
    "CubeSummary": ("Entry `cube` of `summary.json`", "## STEREO.toml"),
    "DetectorNoise": ("## Written by `noise`", "## Written by `match`"),
    "RasterMatches": ("## Written by `match`", "## Written by `tie`"),
    "BandMatches": ("## Written by `match`", "## Written by `tie`"),
    "ReferenceTie": ("## Written by `tie`", "## Written by `tdi`"),
    "TdiResult": ("## Written by `tdi`", "## Tags of TDI lines"),
    "Batch": ("## Written by `batch`", "The summary is the same whichever"),
    "Score": ("## Printed by `score`", "### Of poses"),
}


def test_every_key_of_a_summary_is_described_where_its_command_is():
    from typing import get_args

    from sightline.io.results import schema

    text = FORMATS
    common = set(schema.RunSummary.model_fields)
    first = text[text.index(SUMMARIES["LineOfSight"][0]) :].split("| Key |")[0]
    assert not [key for key in common if f"`{key}`" not in first]
    for model in schema.SUMMARIES:
        begin, end = SUMMARIES[get_args(model.model_fields["result"].annotation)[0]]
        start = text.index(begin)
        part = text[start : text.index(end, start)]
        inner = [schema.RankedLayout] if model is schema.LayoutSummary else []
        keys = {key for one in (model, *inner) for key in one.model_fields} - common
        assert not [key for key in keys if f"`{key}`" not in part], model.__name__


def test_the_schema_of_summaries_is_of_every_result_that_can_be_opened():
    from typing import get_args

    from sightline.io.config import json_schema
    from sightline.io.results import schema
    from sightline.kinds.open import KINDS

    known = [name for one in schema.SUMMARIES for name in get_args(one.model_fields["result"].annotation)]
    assert sorted(known) == sorted(one.__name__ for kind in KINDS for one in kind.types)
    printed = json_schema("summary")
    assert set(printed["discriminator"]["mapping"]) == set(known)
    bare = [
        f"{name}.{key}"
        for name, part in printed["$defs"].items()
        for key, value in part["properties"].items()
        if name.endswith("Summary") and "description" not in value
    ]
    assert not bare


def test_the_page_of_commands_lists_every_command():
    from typer.main import get_command

    from sightline.cli.main import app

    text = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    commands = set(get_command(app).commands)
    assert {name for name in commands if f"`sightline {name}" in text} == commands


def test_the_readme_links_the_documents_it_names_and_a_page_states_every_exit_status():
    from sightline.cli import statuses

    text = (ROOT / "README.md").read_text(encoding="utf-8")
    bare = re.findall(r"(?<!\[)`((?:docs/[\w./-]*|[A-Z]+\.md))`", text)
    assert not bare, f"named without a link: {bare}"
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    stated = page[page.index("Exit status:") :].split("\n\n")[0]
    known = {0, *(value for name, value in vars(statuses).items() if name.isupper())}
    assert {int(number) for number in re.findall(r"\b\d+\b", stated)} == known


def test_versions_agree():
    import tomllib

    from sightline.version import VERSION

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == "sightline-eo" and project["dynamic"] == ["version"]
    assert f"\nversion: {VERSION}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {VERSION}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_nothing_tells_to_install_by_a_name_of_ours():
    # On the package index `sightline` is somebody else's, and ours is not there: only a clone installs it.
    files = [
        *PAGES,
        *ROOT.glob("src/**/*.py"),
        *ROOT.glob("examples/*.py"),
        ROOT / "Makefile",
        ROOT / ".ci" / "run",
    ]
    wrong = re.compile(r"sightline(?:-eo)?\[|install[^\n]{0,40}?[\s\"'`]sightline(?:-eo)?(?![\w./-])")
    found = [
        f"{file.relative_to(ROOT)}: {match[0]}"
        for file in files
        for match in wrong.finditer(file.read_text(encoding="utf-8"))
    ]
    assert not found


def test_a_library_that_is_advised_is_one_of_ours_to_use():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    named = {re.split(r"[<>=]", one)[0] for part in lists for one in part}
    advised = re.compile(r"`pip install ([\w. -]+)`")
    sources = {path: path.read_text(encoding="utf-8") for path in ROOT.glob("src/**/*.py")}
    found = {
        word for text in sources.values() for match in advised.finditer(text) for word in match[1].split()
    }
    assert {"pycolmap", "zarr", "spiceypy", "distributed"} <= found <= named
    without = [
        path.name for path, text in sources.items() if text.count("pip install") > len(advised.findall(text))
    ]
    assert not without, "a library is named as `pip install NAME`, on one line"
