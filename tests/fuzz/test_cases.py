"""Minimal cases of wrong inputs that once were a traceback, a result, a hang, a request or an "interrupted".

Each begins from a seed of the fuzzer and is judged as the fuzzer judges: one line, file named, nothing
touched, nothing asked. Beside that it must end with its status, and name what its pattern says.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable

import numpy as np
import pytest
from tests.fuzz.hunt import Hunter
from tests.fuzz.mutations import SERVER, VRT, WMS, Case, File, Special
from tests.fuzz.readers import READERS
from tests.fuzz.seeds import npy

Files = dict[str, File]
Spoil = Callable[[Files], None]


def text(name: str, old: str, new: str) -> Spoil:
    """Another text in a file."""

    def spoil(files: Files) -> None:
        held = files[name]
        assert isinstance(held, bytes) and old.encode() in held
        files[name] = held.replace(old.encode(), new.encode(), 1)

    return spoil


def key(name: str, pattern: str, new: str) -> Spoil:
    """Another line in a TOML file in place of that which begins with `pattern`."""

    def spoil(files: Files) -> None:
        held = files[name]
        assert isinstance(held, bytes)
        changed, count = re.subn(rf"(?m)^{pattern}.*$", lambda _: new, held.decode(), count=1)
        assert count == 1
        files[name] = changed.encode()

    return spoil


def content(name: str, new: File) -> Spoil:
    """Another file."""

    def spoil(files: Files) -> None:
        files[name] = new

    return spoil


def entry(name: str, *path: str | int, value: object) -> Spoil:
    """Another value in a JSON file."""

    def spoil(files: Files) -> None:
        held = files[name]
        assert isinstance(held, bytes)
        tree = holder = json.loads(held)
        for step in path[:-1]:
            holder = holder[step]
        holder[path[-1]] = value
        files[name] = json.dumps(tree).encode()

    return spoil


def years_apart(files: Files) -> None:
    held = files["state.json"]
    assert isinstance(held, bytes)
    model, _, text = held.decode().partition("\n")
    state = json.loads(text)
    state["m_centerEphemerisTime"] += 3e8
    files["state.json"] = f"{model}\n{json.dumps(state)}".encode()


def one_instant_too_many(files: Files) -> None:
    held = files["isd.json"]
    assert isinstance(held, bytes)
    tree = json.loads(held)
    tree["instrument_pointing"]["ephemeris_times"].append(
        tree["instrument_pointing"]["ephemeris_times"][-1] + 1.0
    )
    files["isd.json"] = json.dumps(tree).encode()


def xmp_not_utf8(files: Files) -> None:
    held = files["photos/p2.jpg"]
    assert isinstance(held, bytes) and b'"-89.90"' in held
    files["photos/p2.jpg"] = held.replace(b'"-89.90"', b'"-8\xff\xfe0"')


def exif_broken(files: Files) -> None:
    """Lengths of the EXIF that point behind its end."""
    held = files["photos/p2.jpg"]
    assert isinstance(held, bytes)
    at = held.index(b"Exif\0\0") + 14
    files["photos/p2.jpg"] = held[:at] + b"\xff" * 40 + held[at + 40 :]


def cut(name: str, keep: int) -> Spoil:
    def spoil(files: Files) -> None:
        held = files[name]
        assert isinstance(held, bytes)
        files[name] = held[:keep]

    return spoil


def dem_of_noise(files: Files) -> None:
    """Heights of whatever bits lay on a damaged disk."""
    from rasterio.io import MemoryFile

    held = files["dem.tif"]
    with MemoryFile(held) as memory, memory.open() as source:
        profile, shape = source.profile, source.shape
    for name in ("nodata", "blockxsize", "blockysize"):
        profile.pop(name, None)
    bits = np.random.default_rng(0).bytes(8 * shape[0] * shape[1])
    with MemoryFile() as memory:
        with memory.open(**profile | {"dtype": "float64"}) as target:
            target.write(np.frombuffer(bits, dtype=np.float64).reshape(1, *shape))
        files["dem.tif"] = memory.read()


def archive(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()


def empty_archive() -> bytes:
    stream = io.BytesIO()
    zipfile.ZipFile(stream, "w").close()
    return stream.getvalue()


VRT_OF_SERVER = VRT.format(
    lines=64, columns=40, relative=0, source=f"/vsicurl/http://{SERVER}/secret.tif"
).encode()
VRT_ELSEWHERE = VRT.format(lines=64, columns=40, relative=0, source="/etc/hostname").encode()
WMS_OF_SERVER = WMS.format(lines=64, columns=40).encode()
BIG_FIELD = b"frame,t,image\n0,0.0," + b"x" * 200_000 + b"\n"
ACQUISITION, LEVEL = "acquisition.toml", "check level/acquisition.toml"
MODEL, FLOWN = "check sensor-model/acquisition.toml", "check flown/sequence.toml"
PHOTOGRAPHS, INSTRUMENT = "check photographs/sequence.toml", "check instrument/instrument.toml"

#: Sentence: row of the fuzzer, what is spoilt, status, what the message names.
CASES: dict[str, tuple[str, Spoil, int, str]] = {
    "a TOML file nested too deep": (
        LEVEL,
        content(ACQUISITION, b"x=" + b"[" * 10_000 + b"]" * 10_000),
        2,
        r"deep",
    ),
    "an integer of 5,000 digits": (
        LEVEL,
        key(ACQUISITION, "altitude", "altitude = " + "9" * 5000),
        2,
        r"digits",
    ),
    "a TOML file that never ends": (
        LEVEL,
        content(ACQUISITION, Special("link", "/dev/zero")),
        2,
        ACQUISITION,
    ),
    "a TOML file that is a pipe": (LEVEL, content(ACQUISITION, Special("fifo")), 2, ACQUISITION),
    "a TOML file of gigabytes": (LEVEL, content(ACQUISITION, Special("hole", str(3 << 30))), 2, ACQUISITION),
    "a TOML file that is a folder": (LEVEL, content(ACQUISITION, Special("folder")), 2, ACQUISITION),
    "a table that is a pipe": (LEVEL, content("gyro.csv", Special("fifo")), 2, r"gyro\.csv"),
    "a table that never ends": (LEVEL, content("gyro.csv", Special("link", "/dev/zero")), 2, r"gyro\.csv"),
    "a table that is not there": (
        LEVEL,
        key(ACQUISITION, "psd", 'psd = "none.csv"'),
        2,
        r"acquisition\.toml.*none\.csv|none\.csv.*acquisition\.toml",
    ),
    "an image that is not there": (LEVEL, text(ACQUISITION, '"PAN.tif"', '"none.tif"'), 1, r"none\.tif"),
    "an empty .npy": (LEVEL, content("XS.npy", b""), 2, r"XS\.npy"),
    "an .npy of objects": (LEVEL, content("XS.npy", npy(np.zeros((64, 40)))[:40]), 2, r"XS\.npy"),
    "an image that is a list of tiles on a server": (
        LEVEL,
        content("PAN.tif", WMS_OF_SERVER),
        2,
        r"PAN\.tif",
    ),
    "an image that refers to a server": (LEVEL, content("PAN.tif", VRT_OF_SERVER), 2, r"PAN\.tif"),
    "an image that refers to files elsewhere": (LEVEL, content("PAN.tif", VRT_ELSEWHERE), 2, r"PAN\.tif"),
    "an image by its address": (
        LEVEL,
        text(ACQUISITION, '"PAN.tif"', f'"http://{SERVER}/PAN.tif"'),
        2,
        r"http:",
    ),
    "an image through a server": (
        LEVEL,
        text(ACQUISITION, '"PAN.tif"', f'"/vsicurl/http://{SERVER}/PAN.tif"'),
        2,
        r"vsicurl",
    ),
    "a field of 200,000 letters": (FLOWN, content("frames.csv", BIG_FIELD), 2, r"frames\.csv"),
    "a latitude of 122 degrees": (
        FLOWN,
        text("sequence.toml", 'frame = "local"', 'frame = "local"\norigin = [8.0, 122.0, 0.0]'),
        2,
        r"origin",
    ),
    "one instant too many in a sensor model": (MODEL, one_instant_too_many, 2, r"isd\.json"),
    "ragged positions in a sensor model": (
        MODEL,
        entry("isd.json", "instrument_position", "positions", 0, value=[1.0]),
        2,
        r"isd\.json",
    ),
    "words for quaternions in a sensor model": (
        MODEL,
        entry("isd.json", "instrument_pointing", "quaternions", value="x"),
        2,
        r"isd\.json",
    ),
    "no light through a lens without a pixel": (
        MODEL,
        entry("isd.json", "focal2pixel_samples", value=[0.0, 0.0, 0.0]),
        2,
        r"isd\.json",
    ),
    "an ifov of 4e-17 behind a mirror": (
        "check mirror/acquisition.toml",
        key(ACQUISITION, "ifov", "ifov = 4.2e-17"),
        2,
        r"ifov",
    ),
    "a line period of 1e-300": (
        INSTRUMENT,
        key("instrument.toml", "line_period", "line_period = 1e-300"),
        2,
        r"line_period",
    ),
    "an integration ratio in steps of 1e-300": (
        "check tdi/tdi.toml",
        key(
            "tdi.toml", "integration_ratio", "integration_ratio = { from = 1e-300, to = 1.0, step = 1e-300 }"
        ),
        2,
        r"integration_ratio",
    ),
    "a billion TDI stages": (
        "check tdi/tdi.toml",
        key("tdi.toml", "stages", "stages = { from = 3, to = 1000000000 }"),
        2,
        r"stages",
    ),
    "a plan of 1e30 shots": (
        "orient --predict",
        key("stereo.toml", "shots", "shots = 1" + "0" * 30),
        2,
        r"shots",
    ),
    "a DEM that is damaged": ("orient with a DEM", dem_of_noise, 2, r"dem\.tif"),
    "an empty value in metadata of JunoCam": (
        "io.formats.junocam.read_metadata",
        entry("JNCE_30.json", "INTERFRAME_DELAY", value=""),
        2,
        r"JNCE_30\.json",
    ),
    "metadata of JunoCam that are a list": (
        "io.formats.junocam.read_metadata",
        content("JNCE_30.json", b"[1]"),
        2,
        r"JNCE_30\.json",
    ),
    "a truncated covariance.npz": (
        "score georeferenced",
        cut("result/covariance.npz", 400),
        2,
        r"covariance\.npz",
    ),
    "a covariance.npz of 0 bytes": (
        "score georeferenced",
        cut("result/covariance.npz", 0),
        2,
        r"covariance\.npz",
    ),
    "a covariance.npz without arrays": (
        "score georeferenced",
        content("result/covariance.npz", empty_archive()),
        2,
        r"covariance\.npz",
    ),
    "a covariance.npz of objects": (
        "register",
        content("result/covariance.npz", archive(t=np.array([None]), angles=np.array([{}]))),
        2,
        r"covariance\.npz",
    ),
    "frames of which nothing is seen": (
        "register frames",
        content("e2.npy", npy(np.full((48, 60), np.inf))),
        1,
        r"acquisition\.toml",
    ),
    "an .npy whose header names no type": (
        LEVEL,
        content("XS.npy", npy(np.zeros((64, 40))).replace(b"'descr': '<f8'", b"'descr': float")),
        2,
        r"XS\.npy",
    ),
    "a summary.json nested too deep": (
        "score recovered",
        content("result/summary.json", b"[" * 100_000),
        2,
        r"summary\.json",
    ),
    "an infinite turn in a recovered spin": (
        "io.results.registered_frames.read_recovered_spin",
        entry("result/summary.json", "spin", "exposures", 0, "departure", "roll", value=1e300),
        2,
        r"summary\.json",
    ),
    "images of a recovered spin that are a number": (
        "io.results.registered_frames.read_recovered_spin",
        entry("result/summary.json", "images", value=2.5),
        2,
        r"summary\.json",
    ),
    "a sigma of a static parameter that is a word": (
        "io.tdi.motion.read_motion_knowledge",
        entry("result/summary.json", "statics", 0, "sigma", value="px"),
        2,
        r"summary\.json",
    ),
    "bands of a registration that lie elsewhere": (
        "open_result (results/bands)",
        entry("bands/summary.json", "files", value=["/etc/passwd", "XS.tif"]),
        2,
        r"summary\.json: files holds '/etc/passwd'",
    ),
    "bands imaged years apart": (
        "check sensor-model/acquisition.toml, what it names",
        years_apart,
        1,
        r"acquisition\.toml: PAN sees ground .* s before or after",
    ),
    "a raw image that is a pipe": (
        "io.formats.hirise_edr.is_hirise",
        content("raw.IMG", Special("fifo")),
        2,
        r"raw\.IMG",
    ),
}


#: The same where the rest goes on without what is wrong: it is named, and the command ends well.
LEFT_OUT: dict[str, tuple[str, Spoil, str]] = {
    "an XMP that is not UTF-8": (PHOTOGRAPHS, xmp_not_utf8, r"p2\.jpg"),
    "an XMP that is no XML": (PHOTOGRAPHS, text("photos/p2.jpg", "</rdf:RDF>", "</rdf:RDG>"), r"p2\.jpg"),
    "an EXIF that is broken": (PHOTOGRAPHS, exif_broken, r"p2\.jpg"),
    "a photograph that is cut short": (PHOTOGRAPHS, cut("photos/p2.jpg", 700), r"p2\.jpg"),
    "a photograph of 0 bytes": (PHOTOGRAPHS, cut("photos/p2.jpg", 0), r"p2\.jpg"),
    "a frame of 0 bytes": (FLOWN, content("f3.npy", b""), r"f3|frame 3"),
    "a frame that is a pipe": (FLOWN, content("f3.npy", Special("fifo")), r"f3|frame 3"),
}


def judged(hunter: Hunter, name: str, spoil: Spoil) -> dict[str, object]:
    """What became of a case; it shows no fault that the fuzzer knows."""
    row = READERS[name]
    case = Case(dict(hunter.files_of(row.seed)))
    spoil(case.files)
    answer, faults = hunter.judge(row, case)
    assert not faults
    return answer


@pytest.mark.parametrize("sentence", CASES)
def test_is_one_clear_error(hunter, sentence):
    name, spoil, status, pattern = CASES[sentence]
    answer = judged(hunter, name, spoil)
    message = f"{answer['said']}{answer['error']}"
    assert answer["status"] == status, message
    assert re.search(pattern, message), message


@pytest.mark.parametrize("sentence", LEFT_OUT)
def test_is_left_out_and_named(hunter, sentence):
    name, spoil, pattern = LEFT_OUT[sentence]
    answer = judged(hunter, name, spoil)
    assert answer["status"] == 0, answer["said"]
    assert re.search(pattern, f"{answer['stdout']}{answer['said']}"), answer["stdout"]


def test_a_layout_of_340_000_px_is_described_in_little_time_and_memory(hunter):
    spoil = key("instrument.toml", "positions_px", "positions_px = [0, 60, 340000]")
    answer = judged(hunter, INSTRUMENT, spoil)
    assert answer["status"] in (0, 2)
