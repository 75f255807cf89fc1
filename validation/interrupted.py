"""Runs that are stopped, that meet another, a full or read-only disk, or inputs that change under way.

First every command is run undisturbed. Then it is ended by SIGKILL and by SIGTERM at random moments, half
of them over earlier files of the same names (`--overwrite`), and the same command is run again (those that
keep stages in turn with `--resume` and without). Every file must be the same bit for bit, but for what
tells of the run itself: `wall_seconds`, `peak_memory_bytes`, other measured times, CREATION_DATE and
`report.html`; nothing else may be left. Then two runs at once into one folder, disks that run full, a
read-only disk, and inputs that are exchanged for others: each must end with one whole result, or with
status 2 and an error that names the folder or the file. Small file systems are mounted in memory; where
that is not allowed, files may not grow beyond a size instead, and the read-only disk is left out and named.

    python validation/interrupted.py [--moments 4] [--seed 1]    # 4 moments x 2 signals x 5 commands

Ends with 1 if anything differs.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gates

TDI = """
[grid]
stages = { from = 3, to = 64 }
integration_ratio = { from = 0.2, to = 1.0, step = 0.1 }
[head]
stages = 2
integration_ratio = 0.2
[noise]
gain = 9e-6
read = 12.0
[columns]
table = "columns.csv"
[signals]
from = 5
to = 2000
count = 24
[mtf]
aperture_x = 0.9
aperture_y = 0.9
diffusion_sigma_px = 0.2
optics_mtf = 0.35
"""
MEASURES = (
    "sightline.inputs",
    "sightline.stages",
    "sightline.writing",
    "sightline.output.folder",
    "sightline.output.lock",
)
#: Keys of summaries that hold measured times or memory.
MEASURED = {"wall_seconds", "peak_memory_bytes", "solve_seconds"}
#: Commands that go on from finished stages.
STAGED = ("recover", "register", "georeference", "tdi")
NOT_SAID = "wrong status or words"


@dataclass(frozen=True)
class Case:
    """A command, without ``--out``, and an input of it that may be exchanged for another."""

    name: str
    words: tuple[str, ...]
    file: Path
    other: Path


def prepared(folder: Path) -> list[Case]:
    """The five commands, on small inputs that the package makes; each has two of the file to exchange."""
    scenes = folder / "scenes"
    for seed in ("1", "2"):
        size = ("--lines", "420", "--columns", "320", "--seed", seed)
        done(("simulate", "line-of-sight", *size), scenes / f"strip{seed}")
        size = ("--case", "small", "--frames", "16", "--set", "truth_bands=0", "--seed", seed)
        done(("simulate", "frames", *size), scenes / f"flight{seed}")
        done(("simulate", "stereo", "--shots", "8", "--points", "60", "--seed", seed), scenes / f"pass{seed}")
        tdi = scenes / f"tdi{seed}"
        tdi.mkdir()
        (tdi / "tdi.toml").write_text(TDI)
        rows = "".join(f"{n},{0.999 + 0.001 * n / int(seed):.6f},{0.002 * n:.6f}\n" for n in range(9))
        (tdi / "columns.csv").write_text(f"column,scan_velocity,slip\n{rows}")
    strip, flight, shots, tdi = (scenes / f"{name}1" for name in ("strip", "flight", "pass", "tdi"))
    found = scenes / "recovered"
    done(("recover", str(strip / "acquisition.toml")), found)
    register = ("register", str(strip / "acquisition.toml"), "--motion", str(found))
    frame = Path("frames") / sorted(os.listdir(flight / "frames"))[7]
    commands = {
        ("recover", str(strip / "acquisition.toml")): "strip/B1.tif",
        register: "strip/B1.tif",
        ("georeference", str(flight / "sequence.toml")): f"flight/{frame}",
        ("tdi", str(tdi / "tdi.toml")): "tdi/columns.csv",
        ("orient", str(shots / "stereo.toml")): "pass/matches.csv",
    }
    cases = []
    for words, name in commands.items():
        kind, _, file = name.partition("/")
        cases.append(Case(words[0], words, scenes / f"{kind}1" / file, scenes / f"{kind}2" / file))
    return cases


def begun(words: tuple[str, ...], out: Path, *more: str, most: int | None = None) -> subprocess.Popen[str]:
    """A command that writes into `out`, no file of which may be larger than `most` bytes."""
    limit = (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))) if most else None
    return subprocess.Popen(
        [sys.executable, "-m", "sightline", *words, "--out", str(out), *more],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=limit,
    )  # fmt: skip


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit status and last line that is no progress."""
    said = [line for line in process.communicate()[1].splitlines() if "progress:" not in line]
    return process.returncode, said[-1] if said else ""


def done(words: tuple[str, ...], out: Path, *more: str) -> float:
    """Run a command that must succeed; seconds it took."""
    start = time.monotonic()
    status, said = ended(begun(words, out, *more))
    if status != 0:
        raise SystemExit(f"sightline {' '.join(words)}: status {status}: {said}")
    return time.monotonic() - start


def content(folder: Path) -> dict[str, Any]:
    """Every file of a result, without what tells of the run itself."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink() or not path.is_file():
            found[name] = str(path.readlink()) if path.is_symlink() else None
        elif name == "report.html":
            found[name] = "a page"
        elif path.suffix == ".json" and path.read_bytes()[:1] in (b"{", b"["):
            found[name] = without_times(json.loads(path.read_bytes()))
        else:
            found[name] = re.sub(rb"CREATION_DATE = \S+", b"", path.read_bytes())
    return found


def without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if key not in MEASURED}
    return [without_times(item) for item in value] if isinstance(value, list) else value


@contextmanager
def mounted(place: Path, options: str) -> Iterator[bool]:
    """A small file system in memory; False where this user may mount none."""
    place.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    may = shutil.which("mount") is not None and subprocess.run(words, capture_output=True).returncode == 0
    try:
        yield may
    finally:
        if may:
            subprocess.run(["umount", str(place)], check=True)


class Account:
    """What was tried, and what came of it."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[str, str, str]] = Counter()
        self.wrong: list[str] = []

    def note(self, what: str, command: str, came: str, wrong: str = "") -> None:
        self.counts[what, command, came] += 1
        if wrong:
            self.wrong.append(f"{what}, {command}: {wrong}")
            print(f"  WRONG: {what}, {command}: {wrong}", flush=True)

    def table(self) -> None:
        print(f"\n{'what':34} {'command':13} {'what came of it':46} {'runs':>4}")
        for (what, command, came), count in sorted(self.counts.items()):
            print(f"{what:34} {command:13} {came:46} {count:4d}")


def differences(found: dict[str, Any], expected: dict[str, Any]) -> str:
    """The first files that are not the same; "" if all are."""
    names = found.keys() | expected.keys()
    return ", ".join(sorted(name for name in names if found.get(name, 0) != expected.get(name, 0))[:4])


def interrupted(
    case: Case, whole: dict[str, Any], seconds: float, moments: list[float], folder: Path, account: Account
) -> None:
    """End a command at moments (shares of the time it takes), then run it again."""
    for number, moment in enumerate(moments):
        for kind in (signal.SIGKILL, signal.SIGTERM):
            over = number % 2 == 1
            out, more = folder / f"{case.name}-{number}-{kind.name}", ("--overwrite",) if over else ()
            if over:
                shutil.copytree(folder / case.name, out)
                for path in out.rglob("*"):
                    if path.is_file():
                        path.write_text("earlier")
                (out / "mine.txt").write_text("mine")
            expected = whole | ({"mine.txt": b"mine"} if over else {})
            process = begun(case.words, out, *more)
            time.sleep(moment * seconds)
            process.send_signal(kind)
            status, said = ended(process)
            what = f"{kind.name}{', over a result' if over else ''}"
            if status == 0:
                came = "ended before"
            elif kind is signal.SIGTERM and status not in (143, -signal.SIGTERM):
                account.note(what, case.name, NOT_SAID, f"status {status}: {said}")
                continue
            else:
                came = "stopped, then the same bits"
                complete = not differences(content(out), expected) if out.is_dir() else False
                again = more + (("--resume",) if case.name in STAGED and number % 4 > 1 else ())
                if case.name in STAGED and over:
                    again = (*more, "--resume")
                status, said = ended(begun(case.words, out, *again))
                if status == 2 and complete and not over:
                    came = "stopped when the result was complete"
                elif status != 0:
                    account.note(what, case.name, NOT_SAID, f"again: status {status}: {said}")
                    continue
            account.note(what, case.name, came, differences(content(out), expected))
            shutil.rmtree(out)


def two_at_once(case: Case, whole: dict[str, Any], folder: Path, account: Account) -> None:
    out = folder / f"{case.name}-two"
    runs = [begun(case.words, out) for _ in range(2)]
    ends = sorted(ended(run) for run in runs)
    refused = "is being written by another run" in ends[1][1] or "is not empty" in ends[1][1]
    wrong = "" if refused and [status for status, _ in ends] == [0, 2] else f"ended with {ends}"
    wrong = wrong or differences(content(out), whole)
    account.note("two at once", case.name, "one result, one refused", wrong)


def full_disk(case: Case, whole: dict[str, Any], size: int, folder: Path, account: Account) -> None:
    """Disks that have room for a part of the result."""
    for share in (0.02, 0.3, 0.8, 0.97):
        place = folder / f"{case.name}-full-{share}"
        with mounted(place, f"size={int(share * size)}") as may:
            most = None if may else int(share * size)
            out = place / "out"
            status, said = ended(begun(case.words, out, most=most))
            judged(status, said, out, str(place), [whole], account, "full disk", case.name)


def read_only(case: Case, folder: Path, account: Account) -> bool:
    place = folder / f"{case.name}-read-only"
    with mounted(place, "size=1m,ro") as may:
        if may:
            status, said = ended(begun(case.words, place / "out"))
            judged(status, said, place / "out", str(place), [], account, "read-only disk", case.name)
    return may


def judged(
    status: int,
    said: str,
    out: Path,
    name: str,
    wholes: list[dict[str, Any]],
    account: Account,
    what: str,
    command: str,
) -> None:
    """One whole result, or status 2, an error that names what it is about, and nothing left."""
    if status == 0:
        found = content(out)
        wrong = "" if any(found == whole for whole in wholes) else f"a result of its own: {sorted(found)[:5]}"
        account.note(what, command, "a whole result", wrong)
    elif status == 2 and name in said:
        left = sorted(content(out)) if out.is_dir() else []
        left = [entry for entry in left if not entry.startswith(".partial")]
        account.note(what, command, "status 2, named, nothing left", f"left: {left[:5]}" if left else "")
    else:
        account.note(what, command, NOT_SAID, f"status {status}: {said}")


def exchanged(
    case: Case, whole: dict[str, Any], seconds: float, moments: list[float], folder: Path, account: Account
) -> None:
    """An input exchanged for another of its kind while the command runs."""
    kept, wholes = case.file.read_bytes(), [whole]
    try:
        for number, moment in enumerate(moments):
            out = folder / f"{case.name}-exchanged-{number}"
            process = begun(case.words, out)
            time.sleep(moment * seconds)
            exchange(case, number)
            status, said = ended(process)
            if status in (1, 2) and str(case.file) in said:
                status = 2
            elif status == 2 and case.name == "register" and "does not belong to" in said:
                said = str(case.file)  # exchanged before it was read: of another strip than the motion
            elif status == 0 and content(out) != whole and len(wholes) == 1:
                # exchanged before it was read: the result of the other
                other = folder / f"{case.name}-other"
                done(case.words, other)
                wholes.append(content(other))
            judged(status, said, out, str(case.file), wholes, account, "input exchanged", case.name)
            restored(case.file, kept)
    finally:
        restored(case.file, kept)


def exchange(case: Case, number: int) -> None:
    """By moving another in its place, or by writing over it."""
    if number % 2:
        shutil.copyfile(case.other, case.file)
    else:
        copy = case.file.with_name("copy")
        shutil.copyfile(case.other, copy)
        os.replace(copy, case.file)


def restored(path: Path, content: bytes) -> None:
    if path.read_bytes() != content:
        path.write_bytes(content)


def drawn(rng: random.Random, count: int) -> list[float]:
    """Moments as shares of the time a command takes, every fourth near its end, where files are moved."""
    return [rng.uniform(0.9, 1.02) if k % 4 == 3 else rng.uniform(0.02, 1.0) for k in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--moments", type=int, default=4, help="at which each signal ends each command")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--commands", nargs="+", help="some of them only")
    given = parser.parse_args()
    rng, account = random.Random(given.seed), Account()
    may_mount = True
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for case in prepared(folder):
            if given.commands and case.name not in given.commands:
                continue
            done(case.words, folder / f"{case.name}-first")
            seconds = done(case.words, folder / case.name)
            whole = content(folder / case.name)
            account.note(
                "undisturbed, twice", case.name, f"{len(whole)} files, {seconds:.0f} s",
                differences(content(folder / f"{case.name}-first"), whole),
            )  # fmt: skip
            print(f"{case.name}: {seconds:.1f} s", flush=True)
            size = sum(path.stat().st_size for path in (folder / case.name).rglob("*") if path.is_file())
            interrupted(case, whole, seconds, drawn(rng, given.moments), folder, account)
            two_at_once(case, whole, folder, account)
            full_disk(case, whole, size, folder, account)
            may_mount &= read_only(case, folder, account)
            exchanged(case, whole, seconds, drawn(rng, given.moments), folder, account)
    account.table()
    if not may_mount:
        print("left out: read-only disks, as this user may mount none; full disks were limits of file sizes")
    stopped = sum(n for (what, _, came), n in account.counts.items() if "SIG" in what and "stopped" in came)
    print(f"\n{stopped} runs stopped by SIGKILL or SIGTERM and run again; seed {given.seed}")
    gates.check("runs stopped by a signal and run again", stopped, 1)
    gates.check("runs that ended otherwise than they should", len(account.wrong), 0, 0)


if __name__ == "__main__":
    gates.run(main, __file__)
