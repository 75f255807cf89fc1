"""How many planted faults the nearest tests catch: a sign, an index, a constant, an axis, a transposition.

    python validation/planted_faults.py                     all of them: hours of one core
    python validation/planted_faults.py --packages tdi products --faults 12 --seed 3

Faults are drawn by the seed over the formulas of each package, the kinds in turn, one to a function: ``+``
becomes ``-`` or a minus is lost; an index is one off; a constant is a quarter larger; an axis, a column or
two stacked things change places; a ``.T`` is lost or two letters of an einsum change places. Words of errors,
defaults and annotations are left alone. `KNOWN` are planted besides: faults that tests once let pass.

Each goes alone into a copy of ``src`` in a scratch folder. Only the tests of the nearest folder run
(``tests/motion`` for ``motion/``), those first that import the changed module, until one fails or the time is
out (which counts as caught where the tests as they are take less than half of it). A fault that no input
could show is listed in `EQUIVALENT` with the reason, shown as such, and not counted.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

import gates

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src"
PACKAGES = ("geometry", "imaging", "matching", "motion", "photogrammetry", "tdi", "products")
KINDS = ("sign", "index", "constant", "axis", "transposition")
#: Share of the faults that the nearest tests are to catch.
TARGET = 0.92
#: A constant becomes so many times as large.
GROWN = 1.25
#: (text that stands once in the package, what it becomes, which tests must see it, what it is)
KNOWN: tuple[tuple[str, str, str, str], ...] = (
    (
        "Rotation.from_rotvec([0.0, 0.0, -hand * motion[2]])",
        "Rotation.from_rotvec([0.0, 0.0, hand * motion[2]])",
        "photogrammetry",
        "yaw sign of the displacement method",
    ),
    (
        "(pixels[k, 1] - corner[1] - phase[n, 1]) / period[1]",
        "(pixels[k, 1] - corner[1] + phase[n, 1]) / period[1]",
        "products",
        "column phase of a mosaic's cell",
    ),
    (
        "np.full((pairs, pairs), 0.5) + 0.5 * np.eye(pairs)",
        "np.full((pairs, pairs), 0.25) + 0.75 * np.eye(pairs)",
        "motion",
        "start value of the error that pairs share through the hub",
    ),
)
#: Lines as they become of faults that change no result, and why.
EQUIVALENT = {
    'pulled = np.einsum("nji,nj->ni", square, origins - centre)': "the matrix is symmetric",
    "ab = np.zeros((int(depth.max(initial=0)) + 1, matrix.shape[1]))": "the matrix is square",
    "mount = sightings.body_from_camera[sightings.camera[images[1]]]": "all of a row are of one camera",
    "middle = 0.625 * (np.array(detector.shape) - 1.0)": "only the hand of the axes is used",
    "s = np.where(small, 1.0 / 6.0 - z / 120.0 + z**3 / 5040.0, s)": "below 2e-10 where it is used",
    "jxx = radial - x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x": "a slope of Newton steps",
    "d0 * curve[i, 0] + d1 * curve[i + 1, 1] + d2 * curve[i + 2, 0] + d3 * curve[i + 3, 0],": (
        "a slope of Newton steps"
    ),
    "floor, _ = _roots(ox, oy, oz, dx, dy, dz, a + low - 1.0, b + low - 1.25)": "a margin of a search",
    "if places[0] * places[0] <= _MOST_DIRECT:": "the other way to the same surface",
    "position = np.column_stack([1e4 * (2 * camera - 1) + 2500.0 * shot, 0.0 * shot, "
    "np.full(2 * shots, 5e4)])": "numbers that only load compiled code",
    "value = position[m, axis] + less * nodes[m]": "a steady shift by the way of others",
    "points = rays.origins - ranges[rows, None] * rays.directions": "of the same tangents",
    "back = [mount.T @ _TURNS @ mount for mount in mounts]": "of each error only the square counts",
    "scale = 1.01 * distance[:, -1:] - 1e-9": "what keeps a distance of nothing from being divided by",
    "key = (end + begin, share, columns.tobytes())": "as different where columns are, or their number, is",
    "peak[k, axis] += np.clip(0.625 * (low - high) / bend, -0.5, 0.5)": "a start of steps",
    "stars_from_body = Rotation.from_rotvec(np.outer(t - t[1], rate)) * reference": "one turn before all",
    "seen = np.isfinite(pixels[:, 1])": "a pixel that is not seen is NaN in both",
    "i, j0, j1 = top - 3 + r, left - 3, left - 4 + count": "the end of a slice, which compiled code ignores",
    "guess = 0.625 * (lines - 1.0)": "a start of steps",
    "guess = 0.5 * (lines + 1.0)": "a start of steps",
    "guess = 0.5 * (lines - 1.25)": "a start of steps",
    "middle, half = 0.5 * (low + high), 0.625 * (high - low)": "as true, over other stretches",
    "inside = self._inside(start, rim) & self._inside(corner + half, half - 1)": "windows lie farther inside",
    "if columns[0] <= column <= columns[0]:": "the other way to the same line",
    "return np.asarray(1.25 / np.sqrt(spread))": "known up to a common factor",
    "span = grid.window[1] / (2.5 * math.sqrt(3.0))": "a slope, over another chord",
    "g_low = p[0] * plane_low[0] + p[1] * plane_low[1] + p[1] * plane_low[2] - plane_low[3]": (
        "the other way to the same line"
    ),
    "time = ((t + t.mean()) / (float(np.ptp(t)) or 1.0))[pairs.shot]": "the same slopes from another time",
    "places = np.linspace(step, max(camera.lines - 1.25 - step, step), GROUND_PLACES)": "a start of lines",
    'held = np.einsum("nba,nb->na", self._inverse, points)': "the matrix is symmetric",
    "return self.x - posterior @ rhs, 0.5 * (posterior + posterior)": "symmetric but for rounding",
    "whole = 0.5 * (reduced.information + reduced.information)": "symmetric but for rounding",
    "g_high = p[0] * plane_high[0] + p[1] * plane_high[1] + p[2] * plane_high[1] - plane_high[3]": (
        "the other way to the same line"
    ),
    "slope = 2.5 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))": "a slope of Newton steps",
    "axis = int(np.argmax(spans[1]))": "which windows are read together",
    "reach = int(np.ceil(1.875 * k + 1 + _TURN * max(self.reader.shape)))": "a margin of a search",
    "places = np.linspace(max(1.0, low + 1.0), min(camera.lines - 2.0, high - 1.25), lines)": (
        "lines that are asked"
    ),
    "margin = 0.125 * np.ptp(values) + step": "a margin of a search",
    "across = phases(columns.velocity, columns.slip, fx, 0.0)[0]": "both are one phase along the row",
}


@dataclass(frozen=True)
class Fault:
    """One change of one file: characters `start` to `end` of its text become `text`."""

    kind: str
    file: Path
    function: str
    line: int
    start: int
    end: int
    text: str
    folder: str

    def planted(self, source: str) -> str:
        """The text of the file with the fault."""
        return source[: self.start] + self.text + source[self.end :]

    @property
    def becomes(self) -> str:
        """The line as it becomes."""
        after = self.planted((SOURCE / self.file).read_text(encoding="utf-8"))
        return after.splitlines()[self.line - 1].strip()

    @property
    def name(self) -> str:
        """Function, and the line as it becomes."""
        return f"{self.function}: {self.becomes}"


class Formulas(ast.NodeVisitor):
    """Places of a file where a fault can be planted."""

    def __init__(self, file: Path, folder: str) -> None:
        self.source = (SOURCE / file).read_text(encoding="utf-8")
        self.file, self.folder, self.functions, self.found = file, folder, [], []
        lines = self.source.splitlines(keepends=True)
        self.begin = [0]
        for line in lines:
            self.begin.append(self.begin[-1] + len(line))
        self.lines = [line.encode() for line in lines]

    def place(self, line: int, column: int) -> int:
        """Place in the text; columns of the parser count bytes."""
        return self.begin[line - 1] + len(self.lines[line - 1][:column].decode())

    def span(self, node: ast.AST) -> tuple[int, int]:
        return self.place(node.lineno, node.col_offset), self.place(node.end_lineno, node.end_col_offset)

    def put(self, kind: str, line: int, start: int, end: int, text: str) -> None:
        if self.functions:
            name = ".".join(self.functions)
            self.found.append(Fault(kind, self.file, name, line, start, end, text, self.folder))

    def line_of(self, place: int) -> int:
        return self.source.count("\n", 0, place) + 1

    # what holds no formula

    def visit_Raise(self, node: ast.Raise) -> None: ...
    def visit_Assert(self, node: ast.Assert) -> None: ...
    def visit_JoinedStr(self, node: ast.JoinedStr) -> None: ...
    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value:
            self.visit(node.value)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        words = node.name.startswith("__") or (
            isinstance(node.returns, ast.Name) and node.returns.id in ("str", "Never", "NoReturn")
        )
        if words:
            return
        self.functions.append(node.name)
        for statement in node.body:
            self.visit(statement)
        self.functions.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for statement in node.body:
            self.visit(statement)

    def visit_Call(self, node: ast.Call) -> None:
        name = ast.unparse(node.func).rpartition(".")[2]
        if name in ("warn", "append_warning", "say", "progress") or name.endswith("Error"):
            return
        for given in node.keywords:
            if given.arg == "axis" and (value := number(given.value)) in (0, 1, -1, -2):
                other = {0: 1, 1: 0, -1: -2, -2: -1}[value]
                self.put("axis", given.value.lineno, *self.span(given.value), str(other))
        if (
            name in ("stack", "column_stack")
            and node.args
            and isinstance(node.args[0], (ast.List, ast.Tuple))
        ):
            self.swapped("axis", node.args[0].elts[:2])
        if name == "einsum" and node.args and isinstance(node.args[0], ast.Constant):
            first, last = self.span(node.args[0])
            terms = self.source[first:last]
            for term in list(re.finditer(r"[a-z](?=[a-z]\b)", terms))[:-1]:
                pair = terms[term.start() : term.start() + 2]
                if pair == pair[::-1]:
                    continue
                at = first + term.start()
                self.put("transposition", self.line_of(at), at, at + 2, pair[::-1])
        self.generic_visit(node)

    def swapped(self, kind: str, pair: list[ast.expr]) -> None:
        if len(pair) == 2 and not any(isinstance(one, ast.Starred) for one in pair):
            (a, b), (c, d) = map(self.span, pair)
            if self.source[a:b] != self.source[c:d]:
                text = self.source[c:d] + self.source[b:c] + self.source[a:b]
                self.put(kind, pair[0].lineno, a, d, text)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        words = any(isinstance(side, (ast.List, ast.Tuple, ast.JoinedStr)) or (
            isinstance(side, ast.Constant) and not isinstance(side.value, (int, float))
        ) for side in (node.left, node.right))  # fmt: skip
        if isinstance(node.op, (ast.Add, ast.Sub)) and not words:
            between = self.span(node.left)[1], self.span(node.right)[0]
            sign = "+" if isinstance(node.op, ast.Add) else "-"
            at = self.source.index(sign, *between)
            self.put("sign", self.line_of(at), at, at + 1, "-" if sign == "+" else "+")
        if isinstance(node.op, (ast.Add, ast.Sub, ast.Mult, ast.Div)) and not words:
            for side in (node.left, node.right):
                value = number(side)
                if isinstance(value, float) and abs(value) > 1e-6:
                    self.put("constant", side.lineno, *self.span(side), repr(GROWN * value))
        if isinstance(node.op, ast.Pow) and (value := number(node.right)) in (2, 3):
            self.put("constant", node.right.lineno, *self.span(node.right), str(5 - value))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
            first = self.span(node)[0]
            self.put("sign", node.lineno, first, first + 1, "")
        self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for place, part in enumerate(parts):
            ends = (part.lower, part.upper) if isinstance(part, ast.Slice) else (part,)
            for end in ends:
                if isinstance(value := number(end), int):
                    other = {0: 1, 1: 0}.get(value, value - 1)
                    kind = "axis" if place and value in (0, 1) and end is part else "index"
                    self.put(kind, end.lineno, *self.span(end), str(other))
        self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if node.attr == "T":
            last = self.span(node)[1]
            self.put("transposition", node.end_lineno, last - 2, last, "")
        self.generic_visit(node)


def number(node: ast.AST | None) -> int | float | None:
    """Value of a constant, with its sign."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        value = number(node.operand)
        return None if value is None else -value
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return None if isinstance(node.value, bool) else node.value
    return None


def drawn(package: str, count: int, seed: int) -> list[Fault]:
    """Faults of a package: kinds in turn, one to a function, the same for the same source and seed."""
    rng, every = random.Random(f"{seed} {package}"), []
    for path in sorted((SOURCE / "sightline" / package).rglob("*.py")):
        formulas = Formulas(path.relative_to(SOURCE), package)
        formulas.visit(ast.parse(formulas.source))
        every += formulas.found
    # in an order that moved files and lines do not change
    every.sort(key=lambda fault: (fault.function, fault.name, fault.start))
    rng.shuffle(every)
    chosen: list[Fault] = []
    while len(chosen) < count:
        kind = KINDS[len(chosen) % len(KINDS)]
        taken = {fault.function for fault in chosen}
        new = next((f for f in every if f.kind == kind and f.function not in taken), None)
        new = new or next((f for f in every if f.function not in taken), None)
        if new is None:
            break
        chosen.append(new)
    return chosen


def known() -> Iterator[Fault]:
    """The faults of `KNOWN`."""
    for before, after, folder, what in KNOWN:
        files = [p for p in SOURCE.rglob("*.py") if p.read_text(encoding="utf-8").count(before) == 1]
        if len(files) != 1:
            raise SystemExit(f"{what}: {before!r} stands in {len(files)} files; mend KNOWN")
        text = files[0].read_text(encoding="utf-8")
        at = text.index(before)
        line = text.count("\n", 0, at) + 1
        file = files[0].relative_to(SOURCE)
        yield Fault("known", file, what, line, at, at + len(before), after, folder)


# ------------------------------------------------------------------------------------------------- tests


def test_files(fault: Fault) -> list[Path]:
    """Those of the nearest folder, first those that import the changed module."""
    module = ".".join(fault.file.with_suffix("").parts)
    package, _, name = module.rpartition(".")
    imports = re.compile(rf"{re.escape(module)}\b|from {re.escape(package)} import .*\b{name}\b")
    files = sorted((ROOT / "tests" / fault.folder).rglob("test_*.py"))
    text = {file: file.read_text(encoding="utf-8") for file in files}
    return sorted(files, key=lambda f: (f.stem != f"test_{name}", not imports.search(text[f]), f))


class Scratch:
    """A copy of the source, and kernels compiled from it."""

    def __init__(self, folder: Path) -> None:
        self.source, self.kernels = folder / "src", folder / "kernels"
        if not self.source.is_dir():
            shutil.copytree(SOURCE, self.source, ignore=shutil.ignore_patterns("__pycache__"))
        self.kernels.mkdir(exist_ok=True)

    def run(self, files: list[Path], limit: float, kernels: Path | None = None) -> tuple[str, str, float]:
        """("passed", "failed" or "no end", the test that failed, CPU s)."""
        environment = os.environ | {
            "PYTHONPATH": str(self.source), "NUMBA_CACHE_DIR": str(kernels or self.kernels),
            "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip
        words = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "-n0",
            "--tb=no",
            "-p",
            "no:cacheprovider",
            "-rfE",
        ]
        begun = os.times()
        process = subprocess.Popen(
            [*words, *map(str, files)], cwd=ROOT, env=environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, preexec_fn=lambda: os.nice(10),
        )  # fmt: skip
        try:
            said, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.communicate()
            return "no end", f"after {limit:.0f} s", limit
        ended = os.times()
        failed = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.M)
        seconds = ended.children_user - begun.children_user
        if process.returncode < 0:  # a kernel that writes where it must not
            return "failed", f"signal {-process.returncode}", seconds
        if process.returncode > 2:
            raise SystemExit(f"pytest ended with {process.returncode}: {said[-500:]}")
        return "failed" if process.returncode else "passed", failed[1] if failed else "-", seconds

    def judge(self, fault: Fault, limit: float) -> tuple[str, str, float]:
        """Plant, test, mend."""
        path = self.source / fault.file
        whole, was = path.read_text(encoding="utf-8"), path.stat()
        kernels = self.kernels.with_name("kernels-now")
        shutil.rmtree(kernels, ignore_errors=True)
        # numba writes files anew and never into them: the links keep what was compiled from the whole source
        shutil.copytree(self.kernels, kernels, copy_function=os.link)
        times = {}
        try:
            path.write_text(fault.planted(whole), encoding="utf-8")
            # kernels that call a changed one hold it compiled in: theirs are made anew too
            if "njit" in whole:
                for other in self.source.rglob("*.py"):
                    if "njit" in other.read_text(encoding="utf-8") and other != path:
                        if fault.file.stem in other.read_text(encoding="utf-8"):
                            times[other] = other.stat()
                            os.utime(other)
            return self.run(test_files(fault), limit, kernels)
        finally:
            path.write_text(whole, encoding="utf-8")
            for other, stat in {**times, path: was}.items():
                os.utime(other, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def main() -> None:
    """Plant, count, and say what survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--faults", type=int, default=70, help="drawn, over all packages")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--packages", nargs="+", choices=PACKAGES, default=PACKAGES)
    parser.add_argument("--limit", type=float, default=300.0, help="s of a fault's tests")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scratch", type=Path, help="folder that keeps compiled kernels between runs")
    parser.add_argument("--only", nargs="+", help="faults whose names hold one of these")
    parser.add_argument("--list", action="store_true", help="name the faults, run nothing")
    given = parser.parse_args()
    each = -(-given.faults // len(given.packages))
    faults = [fault for package in given.packages for fault in drawn(package, each, given.seed)]
    faults += [fault for fault in known() if fault.folder.partition("/")[0] in given.packages]
    if given.only:
        faults = [fault for fault in faults if any(word in fault.name for word in given.only)]
    if given.list:
        for fault in faults:
            print(f"{fault.kind:14} {fault.file}:{fault.line} {fault.name}")
        sys.exit(0)
    with tempfile.TemporaryDirectory() as place:
        folder = given.scratch or Path(place)
        copies: SimpleQueue[Scratch] = SimpleQueue()
        for worker in range(given.workers):
            (folder / str(worker)).mkdir(parents=True, exist_ok=True)
            copies.put(Scratch(folder / str(worker)))
        report(faults, judged(faults, copies, given.limit, given.workers), given.seed)


def judged(faults: list[Fault], copies: SimpleQueue[Scratch], limit: float, workers: int) -> list[str]:
    """What became of each: "caught", "survived" or "equivalent"; a line each on the way."""

    def sound(folder: str) -> str:
        """The tests as they are must pass in the copy; what they compile is kept."""
        scratch = copies.get()
        state, failed, seconds = scratch.run([ROOT / "tests" / folder], 1800.0)
        copies.put(scratch)
        if state != "passed":
            raise SystemExit(f"the tests of {folder} fail as they are: {failed}")
        return f"tests/{folder} as they are: {seconds:.0f} CPU s"

    def one(fault: Fault) -> str:
        scratch = copies.get()
        try:
            state, by, seconds = scratch.judge(fault, limit)
        finally:
            copies.put(scratch)
        came = "caught" if state != "passed" else "equivalent" if fault.becomes in EQUIVALENT else "survived"
        where = f"{fault.file}:{fault.line}"
        print(
            f"{came} {fault.kind} {where} {fault.name} [{by}; {seconds:.0f} s]", file=sys.stderr, flush=True
        )
        return came

    with ThreadPoolExecutor(workers) as pool:
        for line in pool.map(sound, sorted({fault.folder for fault in faults})):
            print(line, file=sys.stderr, flush=True)
        return list(pool.map(one, faults))


def report(faults: list[Fault], outcome: list[str], seed: int) -> None:
    """Counts by package and kind, what survived, what no input could show."""
    print(f"| seed {seed}: caught of planted | {' | '.join((*KINDS, 'known'))} | equivalent |")
    print("|---" * (len(KINDS) + 3) + "|")
    for package in PACKAGES:
        cells = []
        for kind in (*KINDS, "known"):
            came = [
                o
                for f, o in zip(faults, outcome, strict=True)
                if f.folder == package and f.kind == kind and o != "equivalent"
            ]
            cells.append(f"{came.count('caught')} of {len(came)}" if came else "")
        same = sum(f.folder == package and o == "equivalent" for f, o in zip(faults, outcome, strict=True))
        print(f"| {package} | {' | '.join(cells)} | {same or ''} |")
    for fault, came in zip(faults, outcome, strict=True):
        if came != "caught":
            why = f" ({EQUIVALENT[fault.becomes]})" if came == "equivalent" else ""
            print(f"{came}: {fault.kind}, {fault.file.name}, {fault.name}{why}")
    counted = outcome.count("caught") + outcome.count("survived")
    gates.check("faults planted", len(faults), 60)
    gates.check("share caught, equivalent ones aside", outcome.count("caught") / max(counted, 1), TARGET)


if __name__ == "__main__":
    gates.run(main, __file__)
