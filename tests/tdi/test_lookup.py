"""Words of signals: by both loops as the table's cells say, and defined for every number."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.tdi.table import BEYOND, HEADER, TdiTable


def table(cells: int = 3, groups: int = 7, shift: int = 0, seed: int = 0) -> TdiTable:
    """Random cells over columns 10 on, signals 2 to 6000 (times 2^shift) electrons."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, cells + 1, groups)
    counts[0] = cells
    thresholds = [np.append(0, np.sort(rng.choice(np.arange(1, 6000), n - 1, replace=False))) for n in counts]
    size = counts.sum()
    words = rng.integers(1, 512, size) | rng.integers(0, 5, size) << 9 | rng.integers(0, 2, size) << 14
    return TdiTable(
        10 + np.concatenate([[0], np.cumsum(rng.integers(1, 30, groups))]),
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate(thresholds).astype(np.uint16),
        words.astype(np.uint16),
        np.array([0.1, 0.2, 0.4, 0.8, 1.0]),
        (2.0 * 2.0**shift, 6000.0 * 2.0**shift),
        0.004,
        shift,
    )


def one_by_one(given: TdiTable, signals: np.ndarray) -> np.ndarray:
    """The definition, sample by sample."""
    out = np.empty(signals.shape, dtype=np.uint16)
    for (line, column), signal in np.ndenumerate(signals):
        code = int(min(signal, 1e12)) >> given.shift if signal > 0 else 0
        group = np.searchsorted(given.edges, column + given.edges[0], side="right") - 1
        cells = slice(given.starts[group], given.starts[group + 1])
        cell = np.searchsorted(given.thresholds[cells], code, side="right") - 1
        out[line, column] = given.words[cells][cell] | (BEYOND if code > given.top else 0)
    return out


@pytest.mark.parametrize("cells", [1, 3, 40])
@pytest.mark.parametrize("shift", [0, 5])
@pytest.mark.parametrize("kind", [np.uint16, np.float32, np.float64, np.int64])
def test_words_are_those_of_the_cells(cells, shift, kind):
    given = table(cells, shift=shift)
    rng = np.random.default_rng(cells)
    signals = rng.uniform(0.0, min(7000.0 * 2**shift, 65535.0), (5, given.columns))
    least = given.thresholds[rng.integers(0, len(given.thresholds), given.columns)].astype(float) * 2**shift
    signals[0], signals[1] = np.minimum(least, 65535.0), np.maximum(np.minimum(least, 65535.0) - 1.0, 0.0)
    signals = signals.astype(kind)
    np.testing.assert_array_equal(given.lookup(signals), one_by_one(given, signals))


@pytest.mark.parametrize("cells", [3, 40])
def test_every_number_has_a_word(cells):
    given = table(cells)
    lowest, highest = given.words[given.starts[:-1]], given.words[given.starts[1:] - 1]
    groups = np.diff(given.edges)
    for signal in (np.nan, -5.0, -np.inf, 0.0, 0.99):
        words = given.lookup(np.full(given.columns, signal))
        np.testing.assert_array_equal(words, np.repeat(lowest, groups))
    for signal in (6001.0, 1e30, np.inf):
        words = given.lookup(np.full(given.columns, signal, dtype=np.float32))
        np.testing.assert_array_equal(words, np.repeat(highest, groups) | BEYOND)
        assert given.flags(words)[1].all()


def test_one_line_some_columns_and_a_given_array():
    given = table()
    signals = np.random.default_rng(3).uniform(0, 6000, (4, given.columns)).astype(np.float32)
    words = given.lookup(signals)
    np.testing.assert_array_equal(given.lookup(signals[2]), words[2])
    np.testing.assert_array_equal(given.lookup(signals[:, 5:40], first_column=15), words[:, 5:40])
    np.testing.assert_array_equal(given.lookup(signals[:, ::-1].T.copy().T[:, ::-1]), words)
    out = np.zeros_like(words)
    assert given.lookup(signals, out) is out and (out == words).all()


@pytest.mark.parametrize("cells", [3, 40])
def test_words_may_take_the_place_of_signals(cells):
    """Both kernels: they write words while signals are still to be read."""
    given = table(cells)
    signals = np.random.default_rng(4).integers(0, 6000, (3, given.columns)).astype(np.uint16)
    words = given.lookup(signals)
    np.testing.assert_array_equal(given.lookup(signals, out=signals), words)


def test_unpack_gives_stages_ratio_and_flags():
    given = table()
    word = np.array([[9 | 3 << 9, 511 | 1 << 14], [1 | 4 << 9 | 1 << 15, 200 | 2 << 9]], dtype=np.uint16)
    stages, ratio = given.unpack(word)
    assert stages.tolist() == [[9, 511], [1, 200]] and ratio.tolist() == [[0.8, 0.1], [1.0, 0.4]]
    infeasible, beyond = given.flags(word)
    assert infeasible.tolist() == [[False, True], [False, False]]
    assert beyond.tolist() == [[False, False], [True, False]]


def test_bad_calls_are_refused():
    given = table()
    line = np.zeros(given.columns)
    with pytest.raises(InputError, match="columns 10 to"):
        given.lookup(line[1:])
    with pytest.raises(InputError, match="covers columns 9 to"):
        given.lookup(line, first_column=9)
    with pytest.raises(InputError, match="shape"):
        given.lookup(np.zeros((2, 2, 2)))
    with pytest.raises(InputError, match="type complex128"):
        given.lookup(line * 1j)
    for out in (np.zeros(3, np.uint16), np.zeros(len(line)), np.zeros(2 * len(line), np.uint16)[::2]):
        with pytest.raises(InputError, match="`out`"):
            given.lookup(line, out)
    locked = np.zeros(len(line), np.uint16)
    locked.flags.writeable = False
    with pytest.raises(InputError, match="can be written to"):
        given.lookup(line, locked)
    with pytest.raises(InputError, match="`out` is a list"):
        given.lookup(line, [0] * len(line))
    with pytest.raises(InputError, match="`signals` is no array"):
        given.lookup([[1.0, 2.0], [3.0]])
    for words in (np.array([31 << 9], dtype=np.uint16), np.array([3.0])):
        with pytest.raises(InputError, match="ratios"):
            given.unpack(words)


@pytest.mark.parametrize(
    "change",
    [
        {"edges": np.array([0, 5, 5])},
        {"starts": np.array([0, 1])},
        {"words": np.zeros(3, np.uint16)},
        {"ratios": np.empty(0)},
        {"signals": (5.0, 1.0)},
        {"signal_ratio": 0.0},
        {"signal_ratio": np.nan},
        {"head_stages": -1},
    ],
)
def test_what_is_no_table_is_refused(change):
    with pytest.raises(InputError, match="build_table"):
        replace(table(), **change)


def test_the_image_comes_back_the_same():
    of_head = replace(table(), signal_ratio=0.25, head_stages=2)
    for given in (table(), table(40, shift=7), table(4, groups=20_000), of_head):
        image = given.to_bytes()
        back = TdiTable.from_bytes(image)
        assert back.to_bytes() == image and back.identity == given.identity == zlib.crc32(image[:-4])
        assert struct.pack("<I", given.identity) == image[-4:]
        for name in ("edges", "starts", "thresholds", "words", "ratios"):
            np.testing.assert_array_equal(getattr(back, name), getattr(given, name))
        assert (back.signals, back.shift, back.certified_loss) == (given.signals, given.shift, 0.004)
        assert (back.signal_ratio, back.head_stages) == (given.signal_ratio, given.head_stages)


@pytest.mark.parametrize("length", [0, 4, HEADER.size - 1, HEADER.size, HEADER.size + 3])
def test_an_image_cut_in_its_head_is_none(length):
    with pytest.raises(FormatError, match="is not a TDI table's memory image"):
        TdiTable.from_bytes(table().to_bytes()[:length])
