"""What all kinds of results share: tables with units, safe folders, opened folders.

A kind says what its own results hold; everything else is done here, once.

Not here: the kinds (one file each), which of them a result is of (``open.py``).
"""

from __future__ import annotations

import csv
import importlib
import io
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.access import check_file, read_bytes, read_json
from sightline.errors import FormatError, InputError, SightlineError, foreign_errors
from sightline.execution import Progress
from sightline.inputs import note
from sightline.io.formats.json_text import json_text, plain
from sightline.io.results.exports import Exported, write_export
from sightline.output.folder import output_folder
from sightline.report.page import Page, Section, Table
from sightline.result import Made, Result, logger, made
from sightline.version import VERSION
from sightline.writing import naming_file, scratch_folder, whole_text

Columns = Mapping[str, ArrayLike]
#: Of a model for COLMAP beside poses.
MODEL_FILES = (
    "colmap/cameras.txt", "colmap/images.txt", "colmap/points3D.txt", "colmap/origin.csv", "colmap/rigs.txt",
    "colmap/frames.txt", "colmap/pose_priors.csv",
)  # fmt: skip
#: Called with what is being done, in words; the progress of a command is one.
Tell = Progress

#: Bytes of a file up to which an opened result holds it, and of all its files together.
HELD, HELD_IN_ALL = 32 << 20, 256 << 20
SUMMARY, REPORT, EXPORT = "summary.json", "report.html", "export.json"
#: Where a result keeps its summary, which may take minutes.
_KEPT = "_summary"
#: Rows of a table on a page that has no figures.
PLAIN_ROWS = 500
#: Columns that hold words, whatever is in them.
WORDS = frozenset(
    "name frame camera image images first second axis source reason quantity unit method weakest limit pair "
    "positions_px positions_s blind_frequencies type placed_by".split()
)
#: Columns of 0 and 1.
FLAGS = frozenset(("observed", "rejected"))
#: What a message of the command line is called in Python.
_IN_PYTHON = (
    ("add --overwrite to", "give overwrite=True to"),
    ("give another --out", "give another folder"),
    ("give a folder with --out", "give another folder"),
    ("give a folder on another disk with --out", "give a folder on another disk"),
    (" with --out", ""),
    ("add --acquisition FILE, the ACQUISITION.toml", "give acquisition=FILE, the ACQUISITION.toml"),
    ("add --kernel FILE", "give kernels=[FILE, ...]"),
    ("--kernel is for --to", "`kernels` are for `to`"),
    ("with --to ", "with `to` "),
    ("--to ", "`to` "),
    ("by --type", "by `pixels`"),
    ("(--geometry pixels)", '(geometry="pixels")'),
)


@dataclass(frozen=True, eq=False)
class OpenedFolder:
    """A folder that a result was opened from.

    Attributes
    ----------
    folder : Path
    summary : dict
        Content of its ``summary.json``.
    held : dict of str to bytes
        Files that fit into memory, by their names below the folder.
    stamps : dict of str to (int, int)
        Size and time (ns) of the others, which are read where they lie.
    """

    folder: Path
    summary: dict[str, Any]
    held: dict[str, bytes] = field(repr=False)
    stamps: dict[str, tuple[int, int]] = field(repr=False)

    @property
    def names(self) -> list[str]:
        """Every file of the result."""
        return sorted([*self.held, *self.stamps])

    def place(self, name: str) -> Path:
        """Where a file lies that is not held.

        Raises
        ------
        InputError
            If it is not what it was when the folder was opened.
        """
        path = self.folder / name
        try:
            now = _stamp(path)
        except OSError:
            now = None
        if now != self.stamps[name]:
            what = "is gone" if now is None else "was changed"
            raise InputError(
                f"{path}: {what} since the result was opened, which refers to it (it is too large to be "
                "held); open the folder again"
            )
        return path

    def copy(self, folder: Path) -> None:
        """Every file into a folder, which exists."""
        for name in self.names:
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            with naming_file(target):
                if name in self.held:
                    target.write_bytes(self.held[name])
                else:
                    shutil.copyfile(self.place(name), target)

    def text(self, name: str) -> str:
        """A file as text."""
        data = self.held.get(name)
        return (self.place(name).read_bytes() if data is None else data).decode("utf-8", errors="replace")


def _stamp(path: Path) -> tuple[int, int]:
    known = path.stat()
    return known.st_size, known.st_mtime_ns


#: The file of each kind by the names by which ``summary.json`` knows its results, and the kinds that are
#: imported: to know one, not all of them need be.
FILES = {
    "LineOfSight": "recovery", "FrameAttitude": "recovery", "SpinAttitude": "recovery",
    "Registration": "registration", "Mosaic": "registration", "LayoutChoice": "layouts",
    "StereoOrientation": "orientation", "StereoPrediction": "orientation", "TdiResult": "tdi",
    "SequencePoses": "sequence", "CubeSummary": "sequence", "DetectorNoise": "noise",
    "RasterMatches": "matching", "BandMatches": "matching", "ReferenceTie": "tie", "Score": "scoring",
    "Batch": "batch",
}  # fmt: skip
NAMED: dict[str, ResultKind] = {}


def named_kind(name: str) -> ResultKind:
    """The kind whose results ``summary.json`` knows by a name; KeyError where there is none."""
    importlib.import_module(f"sightline.kinds.{FILES[name]}")
    return NAMED[name]


def earlier(folder: Path) -> Iterable[str]:
    """Names below a folder of what the result there is made of, by its summary; none where there is none."""
    try:
        summary = read_json(folder / SUMMARY, "a summary")
        return named_kind(summary["result"]).left(folder, summary) if "version" in summary else []
    except (SightlineError, KeyError, TypeError, ValueError, AttributeError):  # nobody's, or changed since
        return []


def earlier_export(folder: Path) -> Iterable[str]:
    """Names of what an earlier export in a folder is made of, by its ``export.json``.

    Raises
    ------
    InputError
        If the folder holds a result: its files would not belong to each other any more.
    """
    if next(iter(earlier(folder)), None) is not None:
        raise InputError(f"{folder}: holds a result, of which files would be replaced; give another --out")
    try:
        summary = read_json(folder / EXPORT, "what was exported")
        names = [EXPORT, *summary["files"]] if {"version", "to"} <= summary.keys() else []
    except (SightlineError, KeyError, TypeError, ValueError, AttributeError):  # nobody's, or changed since
        return []
    return names if all(isinstance(name, str) and Path(name).name == name for name in names) else []


class ResultKind:
    """One kind of result; each has a class of its own.

    Attributes
    ----------
    types : tuple of type
        Classes of its results, by whose names ``summary.json`` knows them.
    table : str
        Name of the main table, without ``.csv``.
    index : tuple of str
        Columns of it that are coordinates.
    files : tuple of str
        Patterns of the names of all files that there may be.
    units : dict
        Unit of each column, as ``column``, or ``table:column`` where tables differ; of ``sigma_X`` that of
        ``X`` where it is not named. "1" where there is none.
    options : tuple of str
        What `write` may be given.
    panels : int
        Axes of a plot.
    render : callable
        ``render(result, folder, tell, begun, **options)`` writes every file of a result that was made into a
        folder and gives the summary; work began at `begun` (s of ``time.perf_counter``).
    """

    types: tuple[type[Result], ...] = ()
    table: str = ""
    index: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    units: Mapping[str, str] = {}
    options: tuple[str, ...] = ()
    panels: int = 1
    render: Callable[..., dict[str, Any]]

    def __init_subclass__(cls) -> None:
        """Enter it under the names of its results."""
        NAMED.update({one.__name__: cls() for one in cls.types})

    # ---- what a kind says

    def facts(self, result: Any) -> Mapping[str, str]:
        """A few words by what they are about, of a result that was made or opened."""
        raise NotImplementedError

    def columns(self, result: Any) -> Columns:
        """The main table of a result that was made, as its file has it."""
        raise NotImplementedError

    def opened(self, folder: Path, summary: dict[str, Any]) -> dict[str, Any]:
        """The attributes that the files of a folder hold."""
        raise NotImplementedError

    def draw(self, result: Any, axes: Sequence[Any]) -> None:
        """Draw a result into so many axes as there are panels."""
        raise NotImplementedError

    def variables(self, result: Any) -> Mapping[str, tuple[tuple[str, ...], ArrayLike, str]]:
        """Further variables of the dataset: dimensions, values, unit."""
        return {}

    def patterns(self, summary: Mapping[str, Any]) -> Sequence[str]:
        """Of the names of the files that belong to an opened result."""
        return self.files

    def left(self, folder: Path, summary: dict[str, Any]) -> list[str]:
        """Of the files that a result of this kind in a folder may have left there."""
        return [name for name in self.files if "*" not in name]

    def summarize(self, result: Any) -> dict[str, Any]:
        """The summary of a result that was made; by writing it, where it says what was written."""
        return self._rendered(result, lambda folder, summary: summary)

    # ---- what all can do

    def summary(self, result: Any) -> dict[str, Any]:
        """The content of ``summary.json``."""
        origin = result.origin
        found = origin.summary if isinstance(origin, OpenedFolder) else result.__dict__.get(_KEPT)
        if found is None:
            found = self.summarize(result)
            object.__setattr__(result, _KEPT, found)
        return {key: plain(value) for key, value in found.items()}

    def write(self, result: Any, folder: Path, *, overwrite: bool, **options: Any) -> None:
        """Write every file, together or not at all."""
        unknown = sorted(set(options) - set(self.options))
        if unknown:
            there = f"allowed: {', '.join(self.options)}" if self.options else "it has none"
            raise InputError(f"`{unknown[0]}` is no option of writing a {type(result).__name__}; {there}")
        if options and isinstance(result.origin, OpenedFolder):
            raise InputError(
                f"`{next(iter(options))}` is for a result that was just made: one that was opened is written "
                "as it is; leave it out"
            )
        if not isinstance(result.origin, OpenedFolder):
            made(result)
        try:
            with output_folder(folder, overwrite=overwrite, earlier=earlier) as new:
                if isinstance(result.origin, OpenedFolder):
                    for name in result.origin.stamps:
                        note(result.origin.place(name))
                    result.origin.copy(new)
                else:
                    summary = self.render(result, new, _logged, _begun(result), **options)
                    object.__setattr__(result, _KEPT, summary)
        except InputError as error:
            raise _in_python(error) from error

    def exported(self, result: Any, acquisition: Any) -> Exported:
        """What a result gives to other programs; `acquisition` is what it was made of, or None."""
        raise InputError(
            f"a {type(result).__name__} is not exported; results of `recover`, `georeference`, `register` "
            "and `orient` are"
        )

    def export(
        self,
        result: Any,
        to: str,
        folder: Path,
        *,
        acquisition: Any = None,
        kernels: Sequence[Path] = (),
        overwrite: bool = False,
    ) -> dict[str, Any]:
        """Write a form of other programs into a folder; its summary."""
        try:
            with output_folder(folder, overwrite=overwrite, earlier=earlier_export) as new:
                return self.export_into(result, to, new, acquisition, kernels)
        except InputError as error:
            raise _in_python(error) from error

    def export_into(
        self, result: Any, to: str, folder: Path, acquisition: Any, kernels: Sequence[Path]
    ) -> dict[str, Any]:
        """Write a form of other programs into a folder that exists, with what it says in ``export.json``."""
        summary = write_export(to, folder, self.exported(result, acquisition), tuple(kernels))
        whole_text(folder / EXPORT, json_text(summary))
        return summary

    def report(self, result: Any, path: Path) -> None:
        """Write the page."""
        if path.is_dir() or not path.parent.is_dir():
            what = "is a folder" if path.is_dir() else f"there is no folder {path.parent}"
            raise InputError(f"{path}: {what}; give the name of a file to write, in a folder that exists")
        whole_text(path, self.page(result))

    def page(self, result: Any) -> str:
        """The page as text."""
        if not isinstance(result.origin, OpenedFolder):
            if REPORT not in self.files:
                return self.plain_page(result)
            return self._rendered(result, lambda folder, _: (folder / REPORT).read_text(encoding="utf-8"))
        if REPORT in result.origin.names:
            return result.origin.text(REPORT)
        if REPORT not in self.files:
            return self.plain_page(result)
        raise InputError(f"{result.origin.folder}: holds no {REPORT}; run the command again")

    def plain_page(self, result: Any) -> str:
        """The facts, the main table and the summary, of a kind whose command makes no page."""
        facts, columns = self.facts(result), self.numbers(result, self.table)
        summary = self.summary(result)
        name = type(result).__name__
        rows = [[_cell(value) for value in row] for row in zip(*columns.values(), strict=True)]
        heads = [
            f"{key} ({self.unit(key, self.table)})" if _is_number(columns[key]) else key for key in columns
        ]
        most = rows[:PLAIN_ROWS]
        left_out = [f"The first {len(most)} of {len(rows)} rows."] if len(rows) > len(most) else []
        sections = [
            Section("facts", "In short", [Table(["what", "value"], list(facts.items()), [0, 1])]),
            Section("table", self.table.capitalize(), [*left_out, Table(heads, most)]),
            Section(
                "summary",
                "Summary",
                [Table(["key", "value"], [(k, str(v)) for k, v in summary.items()], [0, 1])],
            ),
        ]
        heading = str(summary.get("name", name))
        warnings = [str(text) for text in summary.get("warnings", ())]
        return Page(heading, name, "", [], warnings, sections, f"Sightline {VERSION}").html

    def frame(self, result: Any, table: str | None) -> Any:
        """A table as a DataFrame."""
        pandas = library("pandas")
        name = self.table if table is None else table
        columns = self.numbers(result, name)
        frame = pandas.DataFrame({key: _native(values) for key, values in columns.items()})
        frame.attrs["units"] = {key: self.unit(key, name) for key in columns if _is_number(columns[key])}
        frame.attrs["name"] = name
        return frame

    def numbers(self, result: Any, name: str) -> dict[str, NDArray[Any]]:
        """Columns of a table."""
        opened = result.origin if isinstance(result.origin, OpenedFolder) else None
        if name == self.table and (opened is None or f"{name}.csv" not in self.files):
            return {key: np.asarray(values) for key, values in self.columns(result).items()}
        if opened is not None:
            if f"{name}.csv" not in opened.names:
                raise self._no_table(name, opened.names, result)
            return columns_of(opened.text(f"{name}.csv"), opened.folder / f"{name}.csv")
        if not any(_matches(f"{name}.csv", pattern) for pattern in self.files):
            raise self._no_table(name, self.files, result)

        def read(folder: Path, _: Any) -> dict[str, NDArray[Any]]:
            path = folder / f"{name}.csv"
            if not path.is_file():
                raise self._no_table(name, sorted(one.name for one in folder.iterdir()), result)
            return columns_of(path.read_text(encoding="utf-8"), path)

        return self._rendered(result, read)

    def _no_table(self, name: str, files: Sequence[str], result: Any) -> InputError:
        tables = [one[:-4] for one in files if one.endswith(".csv") and "/" not in one]
        tables = list(dict.fromkeys([self.table, *tables]))
        return InputError(f"a {type(result).__name__} has no table {name!r}; there are: {', '.join(tables)}")

    def unit(self, column: str, table: str) -> str:
        """Unit of a column of a table."""
        for key in (f"{table}:{column}", column):
            if key in self.units:
                return self.units[key]
        for prefix in ("sigma_absolute_", "sigma_"):
            if column.startswith(prefix):
                return self.unit(column.removeprefix(prefix), table)
        return "1"

    def dataset(self, result: Any) -> Any:
        """The main table as an xarray dataset."""
        xarray = library("xarray")
        columns = self.numbers(result, self.table)
        axes = {name: np.unique(columns[name]) for name in self.index}
        if len(self.index) == 1:
            axes = {self.index[0]: columns[self.index[0]]}
        shape = tuple(len(values) for values in axes.values())
        variables: dict[str, Any] = {}
        for name, values in columns.items():
            if name in axes:
                continue
            attributes = {"units": self.unit(name, self.table)} if _is_number(values) else {}
            variables[name] = (self.index, _native(values).reshape(shape), attributes)
        for name, (dimensions, array, unit) in self.variables(result).items():
            variables[name] = (dimensions, np.asarray(array), {"units": unit})
        coordinates = {
            name: (
                (name,),
                _native(values),
                {"units": self.unit(name, self.table)} if _is_number(values) else {},
            )
            for name, values in axes.items()
        }
        return xarray.Dataset(variables, coordinates, {"result": type(result).__name__, **self.facts(result)})

    def plot(self, result: Any, axes: Any) -> Any:
        """Draw with matplotlib."""
        library("matplotlib")
        if axes is None:
            pyplot = importlib.import_module("matplotlib.pyplot")
            _, axes = pyplot.subplots(
                self.panels, 1, sharex=self.panels > 1, squeeze=True, layout="constrained",
                figsize=(8.0, 2.2 * self.panels + 1.2),
            )  # fmt: skip
        given = list(np.atleast_1d(np.asarray(axes, dtype=object)).ravel())
        if len(given) != self.panels:
            raise InputError(f"`axes` must be {self.panels} of matplotlib, got {len(given)}")
        self.draw(result, given)
        return axes

    def _rendered(self, result: Any, use: Callable[[Path, dict[str, Any]], Any]) -> Any:
        """What is read of all files, written where they are gone afterwards."""
        made(result)
        with scratch_folder() as folder:
            return use(folder, self.render(result, folder, _logged, _begun(result)))

    def open(self, folder: Path, summary: dict[str, Any], cls: type[Result]) -> Result:
        """The result of a folder."""
        result = object.__new__(cls)
        again = "run the command that wrote it again"
        with foreign_errors(folder / SUMMARY, "its list of files cannot be read", again):
            patterns = self.patterns(summary)
        origin = _opened_folder(folder, summary, patterns)
        object.__setattr__(result, "origin", origin)
        # whatever its files hold, an opened result shows itself
        with foreign_errors(folder, "cannot be opened as a result", again):
            for name, value in self.opened(folder, summary).items():
                object.__setattr__(result, name, value)
            self.facts(result)
            self.numbers(result, self.table)
        return result


def _opened_folder(folder: Path, summary: dict[str, Any], patterns: Sequence[str]) -> OpenedFolder:
    """The files of a result, held as far as they are small."""
    held: dict[str, bytes] = {}
    stamps: dict[str, tuple[int, int]] = {}
    total = 0
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name.startswith(".") or not any(_matches(name, pattern) for pattern in patterns):
            continue
        if path.is_dir():
            continue
        check_file(path, "run the command that wrote it again")
        size = path.stat().st_size
        if size <= HELD and total + size <= HELD_IN_ALL:
            held[name] = read_bytes(path, "a file of a result", most=HELD)
            total += size
        else:
            stamps[name] = _stamp(path)
    return OpenedFolder(folder, summary, held, stamps)


def _matches(name: str, pattern: str) -> bool:
    """Whether a file's name is of a pattern; only one that names a folder matches in folders."""
    return ("/" in pattern or "/" not in name) and fnmatchcase(name, pattern)


def library(name: str) -> Any:
    """A library that is loaded when it is first asked for."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(_MISSING[name]) from None


_MISSING = {
    "pandas": "a table needs pandas, which is not installed; run `pip install pandas`",
    "xarray": "a dataset needs xarray, which is not installed; run `pip install xarray`",
    "matplotlib": "a plot needs matplotlib, which is not installed; run `pip install matplotlib`",
}


def columns_of(text: str, path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a CSV table: whole numbers, numbers, or words where one is no number.

    Raises
    ------
    FormatError
        If rows are of several lengths.
    """
    lines = (line for line in io.StringIO(text, newline="") if not line.startswith("#"))
    rows = [row for row in csv.reader(lines) if row]
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise FormatError(f"{path}: is no table of a header and rows of its length; run the command again")
    cells = zip(*rows[1:], strict=True) if len(rows) > 1 else ((),) * len(rows[0])
    return {name: _column(name, list(values)) for name, values in zip(rows[0], cells, strict=True)}


def _column(name: str, cells: list[str]) -> NDArray[Any]:
    if name in WORDS:
        return np.array(cells, dtype=object)
    for kind in (np.int64, np.float64):
        try:
            values = np.array(cells, dtype=np.str_).astype(kind)
            return values != 0 if name in FLAGS else values
        except (ValueError, OverflowError):
            continue
    return np.array(cells, dtype=object)


def _is_number(values: Any) -> bool:
    return np.asarray(values).dtype.kind in "biuf"


def _cell(value: Any) -> str:
    """A number in six digits, a word as it is."""
    return f"{value:.6g}" if isinstance(value, float | np.floating) else str(value)


def _native(values: Any) -> NDArray[Any]:
    """Words as objects, which every library takes."""
    array = np.asarray(values)
    return array.astype(object) if array.dtype.kind in "US" else array


def _begun(result: Any) -> float:
    """When work on a result began, as if its files were written right after it was made."""
    seconds = result.origin.seconds if isinstance(result.origin, Made) else 0.0
    return time.perf_counter() - float(seconds)


def _logged(text: str, *_: Any) -> None:
    logger.info("%s", text)


def _in_python(error: InputError) -> InputError:
    """A message of the command line in the words of Python."""
    text = str(error)
    for option, argument in _IN_PYTHON:
        text = text.replace(option, argument)
    return type(error)(text)


def given(result: Any) -> Mapping[str, Any]:
    """The arguments of the call that made a result."""
    return made(result).given


def per_axis(values: Any, form: str = "{:.3g}", names: Sequence[str] = ("roll", "pitch", "yaw")) -> str:
    """Numbers of the axes in words."""
    return ", ".join(f"{name} {form.format(float(value))}" for name, value in zip(names, values, strict=True))


def warned(result: Any) -> dict[str, str]:
    """How many warnings there are, where there are some."""
    return {"warnings": str(len(result.warnings))} if result.warnings else {}
