"""Compiled run-length code of a table of lines and column groups.

Tokens follow one another over the flattened table, line after line. A token is a count, in groups of 7 bits
(least first, the top bit says that more follow), whose lowest bit says what it repeats: 1: the same group of
the line before, count times; 0: one value, which follows in little-endian bytes, count times.

Not here: what the values mean (``tagging.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit


@njit(cache=True, nogil=True)
def _put_count(out, at, number):  # type: ignore[no-untyped-def]
    """Write a count; gives the place after it."""
    while number >= 128:
        out[at] = 128 | (number & 127)
        number >>= 7
        at += 1
    out[at] = number
    return at + 1


@njit(cache=True, nogil=True)
def encode_runs(values, begin, width, size, out):  # type: ignore[no-untyped-def]
    """Code of a table from a place on; gives its length.

    Parameters
    ----------
    values : (n,) uint64
        Bit patterns, line after line.
    begin : int
        Values before it are coded already: 0, or `width` for lines that follow another.
    width : int
        Values of a line.
    size : int
        Bytes of a value.
    out : (m,) uint8
        Overwritten; 10 + `size` bytes per value always suffice.
    """
    at, i, total = 0, begin, values.shape[0]
    while i < total:
        same = i + 1
        while same < total and values[same] == values[i]:
            same += 1
        above = i
        if i >= width:
            while above < total and values[above] == values[above - width]:
                above += 1
        if above > i and above >= same:
            at = _put_count(out, at, (above - i) << 1 | 1)
            i = above
        else:
            at = _put_count(out, at, (same - i) << 1)
            for b in range(size):
                out[at] = (values[i] >> np.uint64(8 * b)) & np.uint64(255)
                at += 1
            i = same
    return at


@njit(cache=True, nogil=True)
def decode_runs(code, width, size, out):  # type: ignore[no-untyped-def]
    """Bit patterns (n,) uint64 from a code; True if the code makes up the table exactly."""
    at, i, total, end = 0, np.int64(0), out.shape[0], code.shape[0]
    while i < total:
        number, shift = np.int64(0), 0
        while True:
            if at >= end or shift > 56:
                return False
            number |= np.int64(code[at] & 127) << shift
            shift += 7
            at += 1
            if code[at - 1] < 128:
                break
        count = number >> 1
        if count < 1 or count > total - i:
            return False
        if number & 1:
            if i < width:
                return False
            for j in range(i, i + count):
                out[j] = out[j - width]
        else:
            if at + size > end:
                return False
            value = np.uint64(0)
            for b in range(size):
                value |= np.uint64(code[at]) << np.uint64(8 * b)
                at += 1
            for j in range(i, i + count):
                out[j] = value
        i += count
    return at == end
