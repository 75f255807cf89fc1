"""Scripts of cells (``# %%``) → notebooks, run by nbclient → pages with what they printed and drew.

A cell begins with ``# %%``, a cell of text with ``# %% [markdown]``, whose lines are comments. Editors that
know this form open the same file as a notebook. A cell of lines ``# !command`` is commands.
"""

from __future__ import annotations

import base64
import hashlib
import os
import pickle
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

ROOT = Path(__file__).resolve().parents[1]
#: s; what a cell may take, kernels compiled for the first time included.
CELL_SECONDS = 300
#: First lines of every notebook: pictures of one look, as PNG, and no fonts from elsewhere.
STYLE = (
    "%matplotlib inline\n"
    "import matplotlib.pyplot as plt\n"
    "plt.rcParams.update({'figure.figsize': (7, 3.6), 'figure.dpi': 90, 'axes.grid': True, 'grid.alpha': 0.3,"
    " 'image.cmap': 'gray', 'figure.constrained_layout.use': True})"
)


@dataclass(frozen=True)
class Picture:
    """A picture of a page: the heading that it stands under, the anchor of that, and its file."""

    title: str
    file: str


@dataclass(frozen=True)
class MadePage:
    """A page that was made of a script: its Markdown, its pictures by name, and the notebook that ran."""

    markdown: str
    pictures: dict[str, bytes]
    shown: tuple[Picture, ...]
    notebook: str


def read_cells(path: Path) -> nbformat.NotebookNode:
    """The notebook of a script."""
    cells = []
    for part in re.split(r"(?m)^# %%", path.read_text(encoding="utf-8"))[1:]:
        first, _, body = part.partition("\n")
        if "[markdown]" in first:
            cells.append(new_markdown_cell(re.sub(r"(?m)^# ?", "", body).strip()))
        elif body.strip():
            cells.append(
                new_code_cell(re.sub(r"(?m)^# !", "", re.sub(r"\A\s*# !", "%%sh\n# !", body)).strip())
            )
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    meta = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return new_notebook(cells=cells, metadata=meta)


def run(path: Path) -> MadePage:
    """The page of a script; it is run anew where it, the package or this module has changed."""
    digest = hashlib.sha256(path.read_bytes())
    for source in sorted([Path(__file__), *(ROOT / "src").rglob("*.py")]):
        digest.update(source.read_bytes())
    kept = ROOT / "build" / "notebooks" / f"{path.parent.name}-{path.stem}-{digest.hexdigest()[:16]}.pickle"
    if not kept.is_file():
        made = run_anew(path)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps(made))
    return pickle.loads(kept.read_bytes())


def run_anew(path: Path) -> MadePage:
    """Run a script as a notebook, in a folder that is removed; its page.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell fails.
    """
    notebook = read_cells(path)
    style = new_code_cell(STYLE)
    notebook.cells.insert(0, style)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook, timeout=CELL_SECONDS, kernel_name="python3", resources={"metadata": {"path": folder}}
        )
        os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        client.km = client.create_kernel_manager()
        client.km.transport = "ipc"  # no port is opened
        client.km.ip = os.path.join(folder, "kernel")
        client.execute()
    notebook.cells.remove(style)
    return _page(path.stem, notebook)


def _page(name: str, notebook: nbformat.NotebookNode) -> MadePage:
    """Cells and outputs as Markdown."""
    lines: list[str] = []
    pictures: dict[str, bytes] = {}
    shown: list[Picture] = []
    title = ""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            lines += [cell.source, ""]
            titles = re.findall(r"(?m)^#+ (.+)$", cell.source)
            title = titles[-1] if titles else title
            continue
        commands = cell.source.startswith("%%sh\n")
        lines += ["```sh" if commands else "```python", cell.source.removeprefix("%%sh\n"), "```", ""]
        printed = "".join(one["text"] for one in cell.outputs if one.get("name") == "stdout").rstrip()
        if printed:
            lines += ["```text", printed, "```", ""]
        for data in (one["data"] for one in cell.outputs if "data" in one):
            if "image/png" in data:
                file = f"{name}-{len(pictures) + 1}.png"
                pictures[file] = base64.b64decode(data["image/png"])
                shown.append(Picture(title, file))
                lines += [f"![{title}]({file})", ""]
            elif "text/html" in data:
                (table,) = re.findall(r"(?s)<table.*</table>", data["text/html"])
                lines += ['<div class="result">' + re.sub(r"\s*\n\s*", " ", table) + "</div>", ""]
            elif not re.search(r"<Axes|<matplotlib|<xarray|^Text\(", data["text/plain"]):
                lines += ["```text", data["text/plain"], "```", ""]
    return MadePage("\n".join(lines), pictures, tuple(shown), nbformat.writes(notebook))
