"""Checks of the built site: links, anchors, requests, public names; the commands of the first page are run.

Ends with 1, naming everything that is wrong.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import sightline

ROOT = Path(__file__).resolve().parents[1]
SITE = ROOT / "build" / "site"
#: Attributes by which a page fetches something by itself; links that a reader follows are no request.
FETCHED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}


class Page(HTMLParser):
    """Links, anchors and what is fetched, of one page."""

    def __init__(self, text: str) -> None:
        """Read it."""
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.fetched: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag says."""
        values = {key: value or "" for key, value in attrs}
        self.anchors |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        wanted = values.get(FETCHED.get(tag, ""), "")
        if wanted and not (tag == "link" and values.get("rel") == "canonical"):
            self.links.append(wanted)
            self.fetched.append(wanted)


def faults_of_pages() -> list[str]:
    """Dead links, missing anchors, requests of pages and of style sheets."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in SITE.rglob("*.html")}
    faults = []
    for path, page in pages.items():
        name = path.relative_to(SITE)
        faults += [f"{name} fetches {one}" for one in page.fetched if urlsplit(one).netloc]
        if path.name == "404.html":
            continue  # its links are from wherever it is shown
        for link in set(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                faults.append(f"{name} links {link}, which is not there")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                faults.append(f"{name} links {link}, which has no such part")
    for path in SITE.rglob("*.css"):
        if re.search(r"url\(\s*['\"]?(https?:)?//|@import", path.read_text(encoding="utf-8")):
            faults.append(f"{path.relative_to(SITE)} fetches from a network")
    anchors = {anchor for page in pages.values() for anchor in page.anchors}
    for name in sightline.__all__:
        if f"{sightline._MODULE_OF[name]}.{name}" not in anchors:
            faults.append(f"sightline.{name} is not documented")
    gallery = pages[SITE / "gallery" / "index.html"]
    pictures = sum(one.endswith(".png") and "favicon" not in one for one in gallery.fetched)
    links = sum(len(page.links) for page in pages.values())
    print(f"{len(pages)} pages, {links} links, {len(sightline.__all__)} names, {pictures} pictures")
    return faults


def run_page(page: Path) -> None:
    """The blocks of a page in order: those with a title are written as files, commands are run.

    Raises
    ------
    subprocess.CalledProcessError
        A command failed.
    """
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"(?ms)^(<!-- not run:[^\n]*\n)?```(\w+)([^\n]*)\n(.*?)^```", text)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    with tempfile.TemporaryDirectory() as folder:
        for skipped, language, more, body in blocks:
            title = re.search(r'title="([^"]+)"', more)
            if title:
                (Path(folder) / title[1]).write_text(body, encoding="utf-8")
            elif language == "sh" and not skipped:
                subprocess.run(
                    ["bash", "-euc", body], cwd=folder, check=True, env={**os.environ, "PATH": path},
                    stdout=subprocess.DEVNULL,
                )  # fmt: skip
        if not (Path(folder) / "registered" / "report.html").is_file():
            raise SystemExit(f"{page.name}: its commands did not write registered/report.html")


if __name__ == "__main__":
    wrong = faults_of_pages()
    run_page(ROOT / "docs" / "start.md")
    print("\n".join(wrong) or "all links lead somewhere, nothing is fetched, every public name is documented")
    sys.exit(bool(wrong))
