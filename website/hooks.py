"""What is made while the site is built: notebooks, gallery, reference, and the order of the pages.

Every ``docs/*.md`` gets into the navigation by itself: those that `GUIDES` does not name stand after it.
Links out of ``docs/`` lead to a page where the site has one, to a copy of an example, or are plain text.
"""

from __future__ import annotations

import html
import os
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from mkdocs.structure.files import File, Files
from pymdownx.slugs import slugify

import notebooks
import sightline
from sightline.execution import available_processors

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
#: Pages of the repository outside docs/, and where they stand on the site.
PROJECT = {
    "ARCHITECTURE.md": "project/architecture.md", "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changes.md", "SECURITY.md": "project/security.md",
    "README.md": "project/readme.md",
}  # fmt: skip
#: Guides in their order.
GUIDES = (
    "strips",
    "stereo",
    "tdi",
    "flights",
    "commands",
    "which-tool",
    "conventions",
    "gotchas",
    "glossary",
)
#: Pages that have a place of their own.
PLACED = ("index", "start", "python", "formats", "validation", *GUIDES)
#: Tutorials in their order, by S1 to S4; others follow.
SYSTEMS = ("strip", "stereo", "tdi", "flight")
#: What the reference calls the names of each layer; what is not here is "Common".
LAYERS = {
    "applications": "Calls and their results", "io": "Read files", "kinds": "Read files",
    "geometry": "Cameras, motion, ground",
    "imaging": "Images and detectors", "matching": "Matching", "motion": "Strips",
    "photogrammetry": "Stereo and flights",
    "products": "Products", "tdi": "TDI", "simulate": "Simulation", "evaluation": "Evaluation",
}  # fmt: skip
COMMON = "Errors, execution and what all share"


def on_files(files: Files, config: Any) -> Files:
    """Add what is made, then set the navigation."""
    for source, place in PROJECT.items():
        if (ROOT / source).is_file():
            text = _from(ROOT / source, DOCS / place)
            files.append(File.generated(config, place, content=text))
    for path in sorted((ROOT / "examples").glob("*.py")):
        files.append(File.generated(config, f"examples/{path.name}", abs_src_path=str(path)))
    gallery: list[str] = []
    scripts = [path for folder in ("tutorials", "gallery") for path in _in_order(folder)]
    with ProcessPoolExecutor(available_processors()) as pool:
        done = dict(zip(scripts, pool.map(notebooks.run, scripts), strict=True))
    for folder in ("tutorials", "gallery"):
        for path in _in_order(folder):
            made = done[path]
            place = f"{folder}/{path.stem}"
            note = f"[As a notebook]({path.stem}.ipynb). Every cell was run when this page was made.\n\n"
            first, _, rest = made.markdown.partition("\n")
            files.append(File.generated(config, f"{place}.md", content=f"{first}\n\n{note}{rest}"))
            files.append(File.generated(config, f"{place}.ipynb", content=made.notebook))
            for name, data in made.pictures.items():
                files.append(File.generated(config, f"{folder}/{name}", content=data))
            if folder == "gallery":
                gallery += [_thumbnail(path.stem, picture) for picture in made.shown]
    files.append(File.generated(config, "gallery/index.md", content=_gallery(gallery)))
    for place, text in _reference().items():
        files.append(File.generated(config, place, content=text))
    config.nav = _navigation()
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Links that lead out of docs/, and to scripts that became pages."""
    if page.file.generated_by is not None and not page.file.src_uri.startswith(("tutorials/", "gallery/")):
        return markdown
    return _relinked(markdown, (DOCS / page.file.src_uri).parent, (DOCS / page.file.src_uri).parent)


def _from(path: Path, place: Path) -> str:
    """A page of the repository, its links as seen from where it stands on the site."""
    return _relinked(path.read_text(encoding="utf-8"), path.parent, place.parent)


def _relinked(text: str, here: Path, there: Path) -> str:
    """Links of a page that lies in `here` and is shown in `there`."""

    def link(match: re.Match[str]) -> str:
        words, target, part = match[1], match[2], match[3] or ""
        if ":" in target or not target:
            return match[0]
        path = Path(os.path.normpath(here / target))
        if path.is_relative_to(DOCS):
            shown = path
        elif (name := path.relative_to(ROOT).as_posix()) in PROJECT:
            shown = DOCS / PROJECT[name]
        elif name.startswith("examples/") and path.is_file():
            shown = DOCS / name
        else:
            return words
        if shown.is_dir():
            return words
        if (
            shown.suffix == ".py"
            and shown.is_relative_to(DOCS)
            and shown.parent.name in ("tutorials", "gallery")
        ):
            shown = shown.with_suffix(".md")
        return f"[{words}]({Path(os.path.relpath(shown, there)).as_posix()}{part})"

    parts = re.split(r"(?ms)(^ *```.*?^ *```)", text)  # not inside blocks of code
    return "".join(
        part if number % 2 else re.sub(r"\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)#\s]*)(#[^)\s]*)?\)", link, part)
        for number, part in enumerate(parts)
    )


def _in_order(folder: str) -> list[Path]:
    known = {name: number for number, name in enumerate(SYSTEMS)}
    return sorted((DOCS / folder).glob("*.py"), key=lambda path: (known.get(path.stem, 99), path.stem))


def _thumbnail(page: str, picture: notebooks.Picture) -> str:
    title, anchor = html.escape(picture.title), slugify(case="lower")(picture.title, "-")
    return f'<a href="{page}.html#{anchor}"><img src="{picture.file}" alt="{title}"><span>{title}</span></a>'


def _gallery(thumbnails: list[str]) -> str:
    inside = "\n".join(thumbnails)
    return (
        "# Gallery\n\nEach picture leads to its code. All were made when this site was built.\n\n"
        f'<div class="gallery">\n{inside}\n</div>\n'
    )


def _reference() -> dict[str, str]:
    """Pages of the reference, and its contents."""
    groups: dict[str, list[str]] = {}
    for name in sightline.__all__:
        layer = sightline._MODULE_OF[name].split(".")[1]
        groups.setdefault(LAYERS.get(layer, COMMON), []).append(name)
    order = list(dict.fromkeys([*LAYERS.values(), COMMON]))
    pages = {}
    lines = [
        "# Reference",
        "",
        "Every name of `import sightline`. What each command does in Python: [Python](../python.md).",
        "",
    ]
    for title in (one for one in order if one in groups):
        file = re.sub(r"\W+", "-", title.lower()) + ".md"
        text = [f"# {title}", ""]
        lines += [f"## {title}", "", "| | |", "|---|---|"]
        for name in groups[title]:
            target = f"{sightline._MODULE_OF[name]}.{name}"
            said = (
                (getattr(sightline, name).__doc__ or "")
                .strip()
                .split("\n\n")[0]
                .replace("\n", " ")
                .replace("|", "\\|")
            )
            lines.append(f"| [`{name}`]({file}#{target}) | {' '.join(said.split())} |")
            text += [f"::: {target}", ""]
        lines.append("")
        pages[f"reference/{file}"] = "\n".join(text)
    return {"reference/index.md": "\n".join(lines), **pages}


def _navigation() -> list[Any]:
    """Sections of the site, in the order in which a reader needs them."""
    there = sorted(path.stem for path in DOCS.glob("*.md"))
    guides = [name for name in GUIDES if name in there] + [name for name in there if name not in PLACED]
    reference = list(_reference())
    return [
        {"Home": "index.md"},
        {"Start": "start.md"},
        {"Tutorials": [f"tutorials/{path.stem}.md" for path in _in_order("tutorials")]},
        {"Gallery": ["gallery/index.md", *(f"gallery/{path.stem}.md" for path in _in_order("gallery"))]},
        {"Guides": [f"{name}.md" for name in guides]},
        {"Files": ["formats.md", *_pages("formats")]},
        {"Python": ["python.md", *reference]},
        {"Theory": [*_pages("theory"), "validation.md"]},
        {"Project": [*(place for name, place in PROJECT.items() if (ROOT / name).is_file()),
                     {"Decisions": _pages("decisions")}]},
    ]  # fmt: skip


def _pages(folder: str) -> list[str]:
    return [f"{folder}/{path.name}" for path in sorted((DOCS / folder).glob("*.md"))]
