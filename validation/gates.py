"""Figures beside their targets, and the block of docs/validation.md that each script of this folder owns.

A script declares its figures while it runs (`check`, `note`) and ends through `run`, which prints them with
their targets in one table and ends with status 1 where one is missed. Run without arguments, as `make
validate` does, a script writes what it printed into its block, with date, version, and a digest of the code
measured.

    python validation/gates.py            names blocks that are older than the code that they measure
    python validation/gates.py --mark     writes into these blocks that they are (docs/decisions/0009)

The digest is of what the script reaches by import in the package, layers aside that no figure hangs on
(`ASIDE`), and of the modules that it names in ``MEASURES``. It is made of the statements at the top of those
modules, in no order: files may be moved and renamed, parts of them too. Comments, docstrings, annotations,
imports, words of errors, names of local variables, and how a result shows itself do not count.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import functools
import hashlib
import io
import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src"
DOCUMENT = ROOT / "docs" / "validation.md"
#: Scripts without figures: helpers.
HELPERS = ("gates", "point_flights")
#: Layers on which no figure hangs: words, files, where work runs; and modules that say of an estimate how far
#: it can be trusted, and have no part in it.
ASIDE = frozenset(
    "version errors inputs result access execution compiled writing output stages io report kinds cli "
    "__main__ motion.strip.warnings motion.strip.withheld".split()
)
OLDER = "Older than the code that it measures: that has changed since."
BLOCK = re.compile(
    r"<!-- begin validation/(?P<script>\w+)\.py, code (?P<code>\w+) -->\n(?P<text>.*?)"
    r"<!-- end validation/(?P=script)\.py -->\n",
    re.S,
)


# ------------------------------------------------------------------------------------- figures, targets


@dataclass(frozen=True)
class Figure:
    """A figure beside its target, both in words, and whether it is met."""

    what: str
    shown: str
    wanted: str
    met: bool


_figures: list[Figure] = []


def note(what: str, shown: str, wanted: str, met: bool) -> bool:
    """Note a figure and its target in words; True where it is met."""
    _figures.append(Figure(what, shown, wanted, bool(met)))
    print(f"{'    ' if met else 'MISS'} {what}: {shown} ({wanted})", file=sys.stderr, flush=True)
    return bool(met)


def check(
    what: str, value: float, least: float = -math.inf, most: float = math.inf, form: str = ".4g"
) -> bool:
    """Note a figure and its bounds, allowed themselves; True within them, where NaN is not."""
    from_below = least > -math.inf and (least != 0.0 or most == math.inf)
    ends = (f">= {least:.4g}" if from_below else "", f"<= {most:.4g}" if most < math.inf else "")
    wanted = f"{least:.4g}" if least == most else ", ".join(filter(None, ends))
    return note(what, f"{value:{form}}", wanted, least <= value <= most)


def nees_bounds(samples: float, chance: float = 1e-3) -> tuple[float, float]:
    """Bounds of a mean of (error / sigma)^2 over so many independent samples, where sigma is true.

    Sigmas a quarter too small or too large, which divide it by 0.64 or 1.56, lie outside of them from some 75
    samples on.
    """
    from scipy.stats import chi2

    return chi2.ppf(0.5 * chance, samples) / samples, chi2.isf(0.5 * chance, samples) / samples


def table(figures: list[Figure]) -> str:
    """Figures, targets, and whether they are met."""
    rows = [f"| {f.what} | {f.shown} | {f.wanted} | {'yes' if f.met else '**NO**'} |" for f in figures]
    return "\n".join(["| figure | found | wanted | met |", "|---|---|---|---|", *rows]) + "\n"


class _Both(io.TextIOBase):
    """What is printed, kept."""

    def __init__(self, to: io.TextIOBase) -> None:
        self.to, self.kept = to, io.StringIO()

    def write(self, text: str) -> int:
        self.kept.write(text)
        return self.to.write(text)

    def flush(self) -> None:
        self.to.flush()


def run(main: Callable[[], object], file: str) -> None:
    """Run a script, print its figures beside their targets, write its block, end with 1 for a missed one.

    Parameters
    ----------
    main
        Prints what the figures rest on, and notes them by `check`.
    file
        ``__file__`` of the script.
    """
    both = _Both(sys.stdout)  # type: ignore[arg-type]
    with contextlib.redirect_stdout(both):
        main()
    print("\n" + table(_figures), flush=True)
    name, missed = Path(file).stem, [figure for figure in _figures if not figure.met]
    if len(sys.argv) == 1:
        write_block(name, f"{tidy(both.kept.getvalue())}\n{table(_figures)}".lstrip())
    if not _figures:
        sys.exit("no figure was checked")
    print(f"{len(missed)} of {len(_figures)} figures missed")
    sys.exit(1 if missed else 0)


def tidy(printed: str) -> str:
    """Printed text as Markdown: tables as they are, all else between fences."""
    out: list[str] = []
    for is_table, lines in _runs(printed.splitlines()):
        text = "\n".join(line.rstrip() for line in lines).strip("\n")
        if text.strip():
            out.append(text if is_table else f"```text\n{text}\n```")
    return "\n\n".join(out) + "\n"


def _runs(lines: list[str]) -> Iterator[tuple[bool, list[str]]]:
    """Neighbouring lines of one kind."""
    part: list[str] = []
    for line in lines:
        if part and line.startswith("|") != part[0].startswith("|"):
            yield part[0].startswith("|"), part
            part = []
        part.append(line)
    if part:
        yield part[0].startswith("|"), part


# --------------------------------------------------------------------------------------------- blocks


def blocks() -> dict[str, re.Match[str]]:
    """The blocks of docs/validation.md by the script that owns them."""
    found = list(BLOCK.finditer(DOCUMENT.read_text(encoding="utf-8")))
    return {match["script"]: match for match in found}


def block(script: str, code: str, text: str) -> str:
    """A block as it stands in the document."""
    return (
        f"<!-- begin validation/{script}.py, code {code} -->\n{text.rstrip()}\n"
        f"<!-- end validation/{script}.py -->\n"
    )


def write_block(script: str, text: str) -> None:
    """Replace the block of a script by what it has just found."""
    from sightline.version import VERSION

    old = blocks().get(script)
    if old is None:
        sys.exit(f"docs/validation.md has no block of validation/{script}.py: write its two marks there")
    today = datetime.now(UTC).date()
    first = f"*`python validation/{script}.py`, {today}, version {VERSION}.*"
    _replace(old, block(script, digest(script), f"{first}\n\n{text}"))


def _replace(old: re.Match[str], new: str) -> None:
    document = DOCUMENT.read_text(encoding="utf-8")
    part = document.replace(old[0], new)
    scratch = DOCUMENT.with_suffix(".part")
    scratch.write_text(part, encoding="utf-8")
    os.replace(scratch, DOCUMENT)


def wrong_marks() -> dict[str, str]:
    """Blocks that do not say what they are: older than the code but silent, or the other way round."""
    out = {}
    for script, found in blocks().items():
        older, said = found["code"] != digest(script), OLDER in found["text"]
        if older and not said:
            out[script] = "is older than the code that it measures and does not say so"
        elif said and not older:
            out[script] = "says that it is older than the code that it measures and is not"
    return out


def mark() -> None:
    """Write into blocks that they are older than the code that they measure, or take that out."""
    for script in wrong_marks():
        found = blocks()[script]
        text = found["text"]
        if OLDER in text:
            text = text.replace(f" {OLDER}", "")
        else:
            first, _, rest = text.partition("*\n")
            text = f"{first} {OLDER}*\n{rest}"
        _replace(found, block(script, found["code"], text))


# --------------------------------------------------------------------------------------------- digest


def digest(script: str) -> str:
    """Of the code that a script measures: 12 letters."""
    parts: set[str] = set()
    for path in measured(ROOT / "validation" / f"{script}.py"):
        parts |= _statements(path, path.stat().st_mtime_ns)
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()[:12]


def measured(script: Path) -> set[Path]:
    """Files of the package that a script reaches by import, and those that it names in MEASURES."""
    named = re.search(r"^MEASURES = \((.*?)\)", script.read_text(encoding="utf-8"), re.M | re.S)
    found = {_file(name) for name in re.findall(r'"([\w.]+)"', named[1])} if named else set()
    if None in found:
        raise SystemExit(f"{script}: MEASURES names a module that is not there")
    to_read, seen = [script], {script}
    while to_read:
        for path in _imported(to_read.pop()) - seen:
            seen.add(path)
            inside = path.is_relative_to(SOURCE)
            if not inside or not _is_aside(path.relative_to(SOURCE / "sightline").with_suffix("").parts):
                to_read.append(path)
                if inside:
                    found.add(path)
    return {path for path in found if path is not None}


def _is_aside(parts: tuple[str, ...]) -> bool:
    return not ASIDE.isdisjoint({parts[0], ".".join(parts)})


@functools.cache
def _imported(path: Path) -> frozenset[Path]:
    """Files of this repository that one imports, inside functions too, but for types alone."""
    names = set()
    for node in _import_statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif node.module and not node.level:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(filter(None, map(_file, names)))


def _import_statements(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Those below a node, but for types alone; expressions, which hold none, are not looked through."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        yield node
        return
    parts = ["body", "orelse", "finalbody", "handlers", "cases"]
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        parts.remove("body")
    for part in parts:
        below = getattr(node, part, ())
        for inner in below if isinstance(below, list) else ():  # of an expression these are no lists
            yield from _import_statements(inner)


def _file(module: str) -> Path | None:
    """File of a module of the package, of validation/ or of tests/."""
    parts = Path(*module.split("."))
    folders = (SOURCE, ROOT / "validation", ROOT / "tests", ROOT)
    return next((f for folder in folders if (f := (folder / parts).with_suffix(".py")).is_file()), None)


@functools.cache
def _statements(path: Path, _: int) -> frozenset[str]:
    """Digests of the statements at the top of a module."""
    return frozenset(statements(path.read_text(encoding="utf-8")))


def statements(source: str) -> set[str]:
    """Digests of the statements at the top of a text, less what changes no result."""
    tree = _Plain().visit(ast.parse(source))
    kept = (node for node in tree.body if not isinstance(node, ast.Pass))
    return {hashlib.sha256(ast.dump(node).encode()).hexdigest()[:16] for node in kept}


class _Plain(ast.NodeTransformer):
    """Takes out what changes no result, and numbers the names of local variables."""

    def __init__(self) -> None:
        self.local: dict[str, str] = {}

    def visit_Import(self, node: ast.Import) -> ast.AST:
        return ast.Pass()

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST:
        return ast.Pass()

    def visit_If(self, node: ast.If) -> ast.AST:
        return ast.Pass() if "TYPE_CHECKING" in ast.unparse(node.test) else self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        return ast.Raise(exc=None, cause=None)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        return ast.Pass() if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        return ast.arg(arg=node.arg, annotation=None)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        value = self.visit(node.value) if node.value else None
        return ast.Assign(targets=[self.visit(node.target)], value=value, lineno=0)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.bases = [base for base in node.bases if ast.unparse(base) != "Result"]
        for one in node.decorator_list:
            if isinstance(one, ast.Call):
                one.keywords = [key for key in one.keywords if key.arg != "repr"]
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        if node.name == "__repr__":
            return ast.Pass()
        node.decorator_list = [one for one in node.decorator_list if ast.unparse(one) != "makes_result"]
        outer = self.local
        if not outer:  # of the outermost function: those inside share its names
            inside = list(ast.walk(node))
            given = {one.arg for one in inside if isinstance(one, ast.arg)}
            given |= {
                name for one in inside if isinstance(one, (ast.Global, ast.Nonlocal)) for name in one.names
            }
            stored = [
                one.id for one in inside if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
            ]
            self.local = {
                name: f"local {k}" for k, name in enumerate(dict.fromkeys(stored)) if name not in given
            }
        node.returns = None
        self.generic_visit(node)
        self.local = outer
        return node

    def visit_Name(self, node: ast.Name) -> ast.AST:
        return ast.Name(id=self.local.get(node.id, node.id), ctx=node.ctx)


def main() -> int:
    """Name the blocks whose marks are wrong, or mend the marks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--mark", action="store_true", help="write into old blocks that they are")
    if parser.parse_args().mark:
        mark()
    for script, what in wrong_marks().items():
        print(f"docs/validation.md: the block of validation/{script}.py {what}")
    return int(bool(wrong_marks()))


if __name__ == "__main__":
    sys.exit(main())
