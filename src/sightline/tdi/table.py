"""The table of settings that a flight computer holds: words by column and signal, looked up at line rate.

A cell is a group of columns and a range of signals; all within it share one word. Each group has its own
ranges, since columns drive the choice and signals hardly do. Signals are quantised to whole electrons, or to
a power of two of them where they exceed 16 bits.

Not here: how the cells are found (``table_build.py``), its other files (``io/results/tdi_table.py``).
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.access import read_bytes
from sightline.compiled import only_read
from sightline.errors import FormatError, InputError, foreign_errors
from sightline.tdi.setting import MOST_RATIOS, MOST_STAGES, RATIO_BITS, STAGE_BITS, Array, Index, TdiGrid
from sightline.tdi.table_kernels import words_by_passes, words_by_signal

Words = NDArray[np.uint16]
Flags = NDArray[np.bool_]

#: Bits of a word above those of its setting: flags.
INFEASIBLE_BIT, BEYOND_BIT = 14, 15
INFEASIBLE, BEYOND = 1 << INFEASIBLE_BIT, 1 << BEYOND_BIT

MAGIC, VERSION = b"SLTD", 2
#: Little-endian head of the memory image; `docs/formats.md` has its address map.
HEADER = struct.Struct("<4sHHIIIIIHHHHIdddd")
#: File of the memory image in a result folder.
IMAGE_FILE = "table.bin"

#: From this many cells per group on, a list by signal is faster than a pass per cell.
MANY_CELLS = 24
#: Largest such list, words; beyond it passes are made all the same.
MOST_SPREAD = 1 << 26


@dataclass(frozen=True, eq=False)
class TdiTable:
    """TDI stages and integration ratio by column and signal, as packed words.

    Attributes
    ----------
    edges : (G + 1,) int
        Number of the first column of each group, and of the one after the last.
    starts : (G + 1,) int
        First cell of each group; its cells lie in order of signal.
    thresholds : (cells,) uint16
        Least quantised signal of each cell; 0 for the first of a group.
    words : (cells,) uint16
        Stages in bits 0-8, number of the integration ratio in bits 9-13, flag "infeasible" in bit 14.
    ratios : (k,)
        Integration ratios that words count.
    signals : (float, float)
        Electrons of one line between which the table is certified.
    certified_loss : float
        Worst relative loss of merit against the best setting of each column and signal that keeps all limits
        for the whole electron.
    shift : int
        A quantised signal is the whole electrons over 2^shift.
    signal_ratio : float
        Integration ratio of the line whose electrons signals are.
    head_stages : int
        Lines of the head, where signals are those of a head line; else 0.

    Notes
    -----
    A signal below the range, zero, negative or not a number takes the lowest cell of its group. One above the
    range takes the highest, and bit 15, "beyond", is set: neither merit nor wells are known there.
    """

    edges: Index
    starts: Index
    thresholds: Words
    words: Words
    ratios: Array
    signals: tuple[float, float]
    certified_loss: float
    shift: int = 0
    signal_ratio: float = 1.0
    head_stages: int = 0

    def __post_init__(self) -> None:
        problem = self._problem()
        if problem:
            raise InputError(f"the table's {problem}; build it with `build_table`")

    def _problem(self) -> str | None:
        """What cannot be a table, or None."""
        edges, starts = self.edges, self.starts
        if len(edges) < 2 or edges[0] < 0 or (np.diff(edges) <= 0).any():
            return "groups of columns do not rise"
        if edges[-1] > 1 << 32:
            return f"columns reach to {edges[-1] - 1}, which 32 bits do not hold"
        if len(starts) != len(edges) or starts[0] != 0 or (np.diff(starts) <= 0).any():
            return "groups do not each have a cell"
        if starts[-1] != len(self.words) or len(self.thresholds) != len(self.words):
            return f"{len(self.words)} words do not fill its {starts[-1]} cells"
        rising = np.diff(self.thresholds.astype(np.int64)) > 0
        rising[starts[1:-1] - 1] = True
        if not rising.all() or self.thresholds[starts[:-1]].any():
            return "signals do not rise from 0 within a group"
        if not 1 <= len(self.ratios) <= MOST_RATIOS:
            return f"{len(self.ratios)} integration ratios do not fit {RATIO_BITS} bits"
        stages, number = self.words & MOST_STAGES, self._ratio_number(self.words)
        if (stages == 0).any() or (number >= len(self.ratios)).any() or (self.words >= BEYOND).any():
            return "words name settings that it does not have"
        if not 0 <= self.shift <= 16 or not 0.0 <= self.signals[0] <= self.signals[1] < 2.0**32:
            return f"range of signals is {self.signals[0]:g} to {self.signals[1]:g}"
        if not 0.0 < self.signal_ratio < np.inf or not 0 <= self.head_stages <= np.iinfo(np.uint16).max:
            return f"signals are of {self.head_stages} head lines at a ratio of {self.signal_ratio:g}"
        return None

    @property
    def columns(self) -> int:
        """Number of columns that the table covers."""
        return int(self.edges[-1] - self.edges[0])

    @property
    def top(self) -> int:
        """Highest quantised signal within the range."""
        return int(self.signals[1]) >> self.shift

    def lookup(self, signals: ArrayLike, out: Words | None = None, first_column: int | None = None) -> Words:
        """Words of signals.

        Parameters
        ----------
        signals : (lines, columns) or (columns,) array
            Electrons of one line. uint16, float32 and float64 are read as they are, others as float64. A part
            of an electron is dropped.
        out : same shape, uint16, C order, optional
            Written to and returned. It may be `signals` themselves.
        first_column : int, optional
            Number of the first column of `signals`; by default the table's first, and `signals` has all.

        Raises
        ------
        InputError
            Columns outside the table; an `out` that does not fit.
        """
        given = _array(signals, "signals")
        if given.ndim not in (1, 2) or not (np.isrealobj(given) and given.dtype.kind in "uifb"):
            raise InputError(
                f"`signals` has shape {given.shape} and type {given.dtype}; numbers of shape (lines, "
                "columns) or (columns,) are allowed"
            )
        if given.dtype not in (np.uint16, np.float32, np.float64):
            given = given.astype(np.float64)
        edges = self._edges_of(given.shape[-1], first_column)
        if out is None:
            out = np.empty(given.shape, dtype=np.uint16)
        else:
            _check_out(out, given.shape)
        lines = np.ascontiguousarray(given).reshape(-1, given.shape[-1])
        if np.may_share_memory(lines, out):  # words are written before all signals are read
            lines = lines.copy()
        (lines,) = only_read(lines)
        starts, thresholds, words = self._whole_cells if given.dtype == np.uint16 else self._real_cells
        if self._spread is not None:
            begins, last, spread = self._spread
            words_by_signal(lines, edges, begins, last, self.shift, spread, out.reshape(lines.shape))
        else:
            words_by_passes(lines, edges, starts, thresholds, words, out.reshape(lines.shape))
        return out

    def unpack(self, words: ArrayLike) -> tuple[Index, Array]:
        """Number of stages (int) and integration ratio (float) of words, in their shape."""
        packed = _array(words, "words")
        whole = packed.dtype.kind in "ui"
        number = self._ratio_number(packed) if whole else packed
        if not whole or (number >= len(self.ratios)).any():
            raise InputError(
                f"`words` of type {packed.dtype} name integration ratios that the table does not have; give "
                "words of this table's lookup"
            )
        return (packed & MOST_STAGES).astype(np.intp), self.ratios[number]

    @staticmethod
    def flags(words: ArrayLike) -> tuple[Flags, Flags]:
        """Whether words are flagged: no setting keeps all limits in some of the cell; signal beyond range."""
        packed = np.asarray(words)
        return np.asarray(packed & INFEASIBLE != 0), np.asarray(packed & BEYOND != 0)

    @staticmethod
    def _ratio_number(words: NDArray[Any]) -> NDArray[Any]:
        return (words >> STAGE_BITS) & (MOST_RATIOS - 1)

    def _edges_of(self, columns: int, first_column: int | None) -> Index:
        """First column of each group, counted in an image of `columns` columns."""
        if first_column is None and columns == self.columns:
            return self._all_edges
        first = int(self.edges[0]) if first_column is None else int(first_column)
        if first_column is None or first < self.edges[0] or first + columns > self.edges[-1]:
            raise InputError(
                f"`signals` covers columns {first} to {first + columns - 1}, the table {self.edges[0]} to "
                f"{self.edges[-1] - 1}; give all of them, or some from `first_column` on"
            )
        return np.clip(self.edges - first, 0, columns).astype(np.int64)

    @cached_property
    def _all_edges(self) -> Index:
        return (self.edges - self.edges[0]).astype(np.int64)

    @cached_property
    def _real_cells(self) -> tuple[Index, NDArray[np.float32], Words]:
        """Cells for real signals: thresholds in electrons, and one more cell per group beyond the range."""
        ends = self.starts[1:]
        codes = np.insert(self.thresholds.astype(np.int64), ends, self.top + 1)
        words = np.insert(self.words, ends, self.words[ends - 1] | BEYOND)
        # 16 bits and a power of two: exact in single precision
        return self.starts + np.arange(len(self.starts)), (codes << self.shift).astype(np.float32), words

    @cached_property
    def _whole_cells(self) -> tuple[Index, Words, Words]:
        """The same for 16-bit signals, which never reach some of them."""
        starts, least, words = self._real_cells
        reached = least <= np.iinfo(np.uint16).max
        before = np.concatenate([[0], np.cumsum(reached)])
        return before[starts].astype(np.int64), least[reached].astype(np.uint16), words[reached]

    @cached_property
    def _spread(self) -> tuple[Index, Index, Words] | None:
        """One word per quantised signal and group: where groups begin, their last thresholds, the words."""
        starts, least, words = self._real_cells
        codes = least.astype(np.int64) >> self.shift
        last = codes[starts[1:] - 1]
        if np.diff(starts).max() < MANY_CELLS or (last + 1).sum() > MOST_SPREAD:
            return None
        counts = np.diff(codes, append=0)
        counts[starts[1:] - 1] = 1
        begins = np.concatenate([[0], np.cumsum(last + 1)])
        return begins.astype(np.int64), last << self.shift, np.repeat(words, counts)

    def to_bytes(self) -> bytes:
        """The memory image, little-endian, with a CRC-32 at its end."""
        wide = max(self.columns, len(self.words)) > np.iinfo(np.uint16).max
        index = "<u4" if wide else "<u2"
        body = b"".join(
            (
                self.ratios.astype("<f8").tobytes(),
                (self.edges - self.edges[0]).astype(index).tobytes(),
                self.starts.astype(index).tobytes(),
                self.thresholds.astype("<u2").tobytes(),
                self.words.astype("<u2").tobytes(),
            )
        )
        head = HEADER.pack(
            MAGIC, VERSION, HEADER.size, HEADER.size + len(body) + 4, int(self.edges[0]), self.columns,
            len(self.edges) - 1, len(self.words), len(self.ratios), 4 if wide else 2, self.shift,
            self.head_stages, self.top, *self.signals, self.certified_loss, self.signal_ratio,
        )  # fmt: skip
        return head + body + struct.pack("<I", zlib.crc32(head + body))

    @property
    def identity(self) -> int:
        """The CRC-32 of the memory image: distinguishes one table from another."""
        return int.from_bytes(self.to_bytes()[-4:], "little")

    @classmethod
    def from_bytes(cls, image: bytes, source: str = "memory image") -> TdiTable:
        """Table of a memory image.

        Parameters
        ----------
        image : bytes
        source : str
            Named in an error.

        Raises
        ------
        FormatError
            Foreign, cut short or corrupted.
        """
        if len(image) < HEADER.size + 4 or image[:4] != MAGIC:
            raise FormatError(f"{source}: is not a TDI table's memory image; it begins with {MAGIC.decode()}")
        (
            _, version, head, size, first, columns, groups, cells, ratios, wide, shift,
            head_stages, top, low, high, loss, signal_ratio,
        ) = HEADER.unpack_from(image)  # fmt: skip
        if version != VERSION or head != HEADER.size:
            raise FormatError(f"{source}: version {version} of the table is not read; {VERSION} is")
        if size != len(image):
            raise FormatError(f"{source}: has {len(image)} bytes, its head says {size}; write it anew")
        if zlib.crc32(image[:-4]) != int.from_bytes(image[-4:], "little"):
            raise FormatError(f"{source}: is corrupted (its CRC-32 does not fit); write it anew")
        parts = (
            ("<f8", ratios),
            (f"<u{wide}", groups + 1),
            (f"<u{wide}", groups + 1),
            ("<u2", cells),
            ("<u2", cells),
        )
        if wide not in (2, 4) or head + sum(int(t[2]) * n for t, n in parts) + 4 != size:
            raise FormatError(f"{source}: its parts do not add up to {size} bytes")
        at, found = head, []
        for kind, count in parts:
            found.append(np.frombuffer(image, kind, count, at))
            at += found[-1].nbytes
        try:
            table = cls(
                found[1].astype(np.intp) + first, found[2].astype(np.intp), found[3].astype(np.uint16),
                found[4].astype(np.uint16), found[0].astype(np.float64), (low, high), loss, shift,
                signal_ratio, head_stages,
            )  # fmt: skip
        except InputError as problem:
            raise FormatError(f"{source}: {problem}") from None
        if table.columns != columns or table.top != top:
            raise FormatError(f"{source}: its head and its groups disagree")
        return table

    @classmethod
    def read(cls, path: str | Path) -> TdiTable:
        """Table that `sightline tdi` wrote.

        Parameters
        ----------
        path : path
            Its result folder, or the memory image itself.

        Raises
        ------
        FormatError
            Missing, foreign, cut short or corrupted.
        """
        file = Path(path)
        if file.is_dir():
            file = file / IMAGE_FILE
        image = read_bytes(file, "a TDI table", advice="give the folder that `sightline tdi` wrote")
        with foreign_errors(file, "cannot be read as a TDI table", "make it again with `sightline tdi`"):
            return cls.from_bytes(image, str(file))


def _array(given: ArrayLike, name: str) -> NDArray[Any]:
    """An array of what was given; InputError where rows differ in length."""
    try:
        return np.asarray(given)
    except ValueError:
        raise InputError(f"`{name}` is no array: its rows differ in length") from None


def _check_out(out: Words, shape: tuple[int, ...]) -> None:
    """InputError where words of a shape cannot be written to `out`."""
    if not isinstance(out, np.ndarray):
        raise InputError(f"`out` is a {type(out).__name__}; an array is needed, to be written to")
    if out.shape != shape or out.dtype != np.uint16 or not out.flags.c_contiguous or not out.flags.writeable:
        raise InputError(
            f"`out` has shape {out.shape} and type {out.dtype}; an array of shape {shape}, uint16, C order, "
            "that can be written to is needed"
        )


def check_words_fit(grid: TdiGrid) -> None:
    """InputError where settings of a grid do not fit a word."""
    if len(grid.ratios) > MOST_RATIOS or grid.stages[-1] > MOST_STAGES:
        raise InputError(
            f"the grid has {len(grid.ratios)} integration ratios and up to {grid.stages[-1]} stages; a word "
            f"of the table holds {MOST_RATIOS} ratios and {MOST_STAGES} stages: leave some out"
        )
