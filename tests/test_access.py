"""Files that are what they seem, and errors of other libraries over them as one of ours."""

from __future__ import annotations

import io
import json
import os
import socket
import struct
import warnings
import zipfile
import zlib

import numpy as np
import pytest

from sightline.access import check_file, read_arrays, read_bytes, read_json, read_text
from sightline.errors import (
    EstimationError,
    FormatError,
    InputError,
    UnobservableBandWarning,
    computes,
    foreign_errors,
    reads,
)


def spoil(what):
    """An exception as a library or the interpreter raises it."""
    match what:
        case "RecursionError":
            json.loads("[" * 100_000)
        case "UnicodeDecodeError":
            b"\xff".decode("utf-8")
        case "EOFError":
            np.lib.format.read_magic(io.BytesIO(b""))
            raise EOFError("No data left in file")
        case "BadZipFile":
            zipfile.ZipFile(io.BytesIO(b"no archive"))
        case "LinAlgError":
            np.linalg.inv(np.zeros((2, 2)))
        case "OverflowError":
            float(10**400)
        case "UnicodeEncodeError":
            "\udcff.tif".encode()
        case "ValueError":
            int("9" * 5000)
        case "struct.error":
            struct.unpack("<d", b"")
        case "zlib.error":
            zlib.decompress(b"no stream")
        case "KeyError":
            {}["focal_length"]
        case "IndexError":
            [][0]
        case "TypeError":
            np.array([1.0]) + None
        case "MemoryError":
            np.empty((1 << 40, 1 << 10), dtype=np.uint8)


FOREIGN = {
    "RecursionError": "it is nested too deeply",
    "UnicodeDecodeError": "byte 0 is no UTF-8 text",
    "UnicodeEncodeError": "to be renamed: its path holds bytes that are no UTF-8 text",
    "EOFError": "",
    "BadZipFile": "not a zip file",
    "LinAlgError": "Singular matrix",
    "OverflowError": "too large",
    "ValueError": "4300 digits",
    "struct.error": "requires a buffer",
    "zlib.error": "incorrect header",
    "KeyError": "'focal_length' is missing",
    "IndexError": "out of range",
    "TypeError": "unsupported operand",
    "MemoryError": "it claims more than memory holds",
}


@pytest.mark.parametrize("what", FOREIGN)
def test_what_other_libraries_raise_over_a_file_names_the_file(what):
    @reads("a sensor model")
    def reader(path):
        spoil(what)

    with pytest.raises(
        FormatError, match=rf"^a/b: cannot be read as a sensor model \(.*{FOREIGN[what]}"
    ) as raised:
        reader("a/b")
    assert raised.value.__cause__ is not None and len(str(raised.value).splitlines()) == 1


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, UnobservableBandWarning])
def test_ctrl_c_the_end_and_warnings_pass(error):
    with pytest.raises(error), foreign_errors("a/b", "cannot be read", "look"):
        raise error


def test_our_own_errors_pass_and_those_of_array_checks_get_the_file():
    with pytest.raises(EstimationError, match=r"^too few$"), foreign_errors("a/b", "cannot be read", "look"):
        raise EstimationError("too few")
    with pytest.raises(FormatError, match=r"^a/b: `t` must increase$"), foreign_errors("a/b", "", ""):
        raise InputError("`t` must increase")


def test_a_long_word_of_another_library_is_cut():
    with pytest.raises(FormatError) as raised, foreign_errors("a/b", "cannot be read", "look"):
        raise ValueError("x\n" * 10_000)
    assert len(str(raised.value)) < 400 and "\n" not in str(raised.value)


def test_numpy_does_not_warn_of_what_is_read():
    with warnings.catch_warnings(), foreign_errors("a/b", "cannot be read", "look"):
        warnings.simplefilter("error")
        assert np.isnan(np.sqrt(np.array([-1.0])) + np.array([1e308]) * 10.0).all()


@pytest.mark.parametrize("what", ["LinAlgError", "OverflowError", "ZeroDivisionError"])
def test_arithmetic_that_fails_over_data_is_no_defect(what):
    @computes("the motion")
    def estimate():
        spoil(what)
        return 1 / 0

    with pytest.raises(EstimationError, match=r"^the motion: cannot be computed from these data \("):
        estimate()


def test_mistakes_in_our_own_code_are_not_taken_for_the_data_s():
    @computes("the motion")
    def estimate():
        raise TypeError("a defect")

    with pytest.raises(TypeError):
        estimate()


def test_only_regular_files_of_bounded_size_are_read(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    listening = socket.socket(socket.AF_UNIX)
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    listening.bind("socket")
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    for name, said in {
        "pipe": r"is a pipe \(FIFO\)",
        "socket": "is a socket",
        "/dev/zero": "is a device",
        ".": "is a folder",
        "sparse": "holds 1,099,511,627,776 bytes",
        "none": "no such file",
        "none/none": "no such file",
        "sparse/none": "no such file",
        "a\0b": "cannot be opened",
        "x" * 300: "cannot be opened",
        "http://127.0.0.1/a.csv": "is an address",
    }.items():
        with pytest.raises(FormatError, match=said):
            read_bytes(tmp_path / name if ":" not in name else type(tmp_path)(name), "a table")
    listening.close()


def test_text_is_read_with_and_without_a_byte_order_mark(tmp_path):
    for content in (b"\xef\xbb\xbfa\r\nb", b"a\r\nb"):
        (tmp_path / "t.csv").write_bytes(content)
        assert read_text(tmp_path / "t.csv", "a table") == "a\r\nb"
    (tmp_path / "t.csv").write_bytes("é".encode("latin-1"))
    with pytest.raises(FormatError, match=r"t\.csv: cannot be read as a table \(byte 0 is no UTF-8 text\)"):
        read_text(tmp_path / "t.csv", "a table")


@pytest.mark.parametrize("text", ["", "[" * 100_000, "{", "9" * 5000, "\0"])
def test_json_that_is_none_is_refused(tmp_path, text):
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(FormatError, match=r"m\.json: not valid JSON \(.*\); a model is expected"):
        read_json(tmp_path / "m.json", "a model")


def test_archives_of_arrays_are_read_whole_or_refused(tmp_path):
    np.savez(tmp_path / "a.npz", t=np.arange(3.0))
    assert read_arrays(tmp_path / "a.npz", "a motion", "run it again")["t"].tolist() == [0.0, 1.0, 2.0]
    whole = (tmp_path / "a.npz").read_bytes()
    spoilt = {"cut": whole[:100], "empty": b"", "other": b"PK\x03\x04 no archive"}
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("t.npy", b"")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "a") as archive:
        archive.infolist()[0].file_size = 1 << 40
        archive._didModify = True
    for name, content in spoilt.items():
        (tmp_path / f"{name}.npz").write_bytes(content)
    for name in (*spoilt, "bomb"):
        with pytest.raises(FormatError, match=rf"{name}\.npz: .*; run it again"):
            read_arrays(tmp_path / f"{name}.npz", "a motion", "run it again")


def test_a_place_stands_before_the_path(tmp_path):
    with pytest.raises(
        FormatError, match=rf"^a\.toml: \[\[band\]\] 2 image: {tmp_path}/x: no such file; look$"
    ):
        check_file(tmp_path / "x", "look", "a.toml: [[band]] 2 image")


@pytest.mark.parametrize("place", ["os.stat", "pathlib.Path.open"])
def test_a_file_that_may_not_be_read_asks_for_its_permissions(tmp_path, monkeypatch, place):
    path = tmp_path / "orbit.csv"
    path.write_text("t,x,y,z\n")

    def refuse(*_args, **_more):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(place, refuse)
    with pytest.raises(FormatError, match=r"Permission denied\); .*see its permissions") as caught:
        read_text(path, "a CSV table")
    monkeypatch.undo()
    assert "check the name" not in str(caught.value)
