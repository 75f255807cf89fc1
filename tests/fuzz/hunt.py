"""Draws cases, has them run, judges what they said, keeps what fails in its smallest form."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from tests.fuzz.mutations import SERVER, Case, Special, cases
from tests.fuzz.readers import READERS, Reader
from tests.fuzz.worker import MOST_MEMORY, MOST_SECONDS, Worker

#: Runs and seconds that the search for the smallest form of one fault may take.
SHRINK_RUNS, SHRINK_SECONDS = 80, 40.0


@dataclass
class Tally:
    """What became of the inputs of one reader."""

    inputs: int = 0
    accepted: int = 0
    refused: Counter[int] = field(default_factory=Counter)
    seconds: float = 0.0
    worst: float = 0.0
    memory: int = 0
    edits: Counter[str] = field(default_factory=Counter)

    def add(self, other: Tally) -> None:
        self.inputs += other.inputs
        self.accepted += other.accepted
        self.refused += other.refused
        self.edits += other.edits
        self.seconds += other.seconds
        self.worst, self.memory = max(self.worst, other.worst), max(self.memory, other.memory)


@dataclass
class Finding:
    """A fault: what it is, where the smallest case that shows it lies."""

    reader: str
    fault: str
    detail: str
    folder: Path
    edits: list[str]
    times: int = 1


class Found(Exception):
    """A case that shows a fault."""


class Hunter:
    """Draws and runs cases.

    Parameters
    ----------
    seeds : Path
        Folder that ``seeds.build`` filled.
    work : Path
        Folder for cases.
    keep : Path
        Folder for failing cases.
    more : str
        As of `Worker`.
    """

    def __init__(self, seeds: Path, work: Path, keep: Path, more: str = "") -> None:
        self._seeds, self._work, self._keep = seeds, work, keep
        self._worker = Worker(work / "worker", more)
        self._server = _Server()
        self._held: dict[str, dict[str, bytes]] = {}
        self._number = 0
        #: Faults of this hunt, and those that are known already and not to be sought again.
        self.findings: dict[tuple[str, str], Finding] = {}
        self.known: set[tuple[str, str]] = set()

    def __enter__(self) -> Hunter:
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.close()
        self._server.close()

    def files_of(self, name: str) -> dict[str, bytes]:
        """Files of a seed."""
        if name not in self._held:
            root = self._seeds / name
            paths = sorted(path for path in root.rglob("*") if path.is_file())
            self._held[name] = {str(path.relative_to(root)): path.read_bytes() for path in paths}
        return self._held[name]

    def hunt(self, name: str, count: int, number: int) -> Tally:
        """Try `count` cases of a reader, drawn from seed `number`."""
        row, tally = READERS[name], Tally()
        files = self.files_of(row.seed)
        drawn = cases(files, row.targets_of(files), row.options)
        turn = 0
        while tally.inputs < count:
            self._round(row, drawn, tally, count - tally.inputs, number + 1_000_003 * turn)
            turn += 1
        return tally

    def _round(self, row: Reader, drawn: Any, tally: Tally, count: int, number: int) -> None:
        """Draw until all are tried or a new fault is found, of which the smallest form is then sought."""
        shrinking: dict[str, Any] = {}

        def trial(case: Case) -> None:
            if not shrinking:
                tally.inputs += 1
                tally.edits.update(case.edits)
            elif time.monotonic() > shrinking["until"] or shrinking["runs"] >= SHRINK_RUNS:
                return  # as good as it gets: hypothesis learns that the fault is gone, and ends
            else:
                shrinking["runs"] += 1
            answer, faults = self.judge(row, case)
            if not shrinking:
                tally.seconds += answer.get("seconds", 0.0)
                tally.worst = max(tally.worst, answer.get("seconds", 0.0))
                tally.memory = max(tally.memory, answer.get("memory", 0))
                status = answer.get("status")
                if status == 0:
                    tally.accepted += 1
                elif status in (1, 2):
                    tally.refused[status] += 1
                for fault, detail in faults.items():
                    if (row.name, fault) in self.known:
                        continue
                    known = self.findings.get((row.name, fault))
                    if known is not None:
                        known.times += 1
                        continue
                    # what hangs takes too long to be made smaller
                    patience = 0.0 if fault.startswith("hung") else SHRINK_SECONDS
                    shrinking.update(fault=fault, runs=0, until=time.monotonic() + patience)
                    self._keep_case(row, case, fault, detail, answer)
                    raise Found(fault)
                return
            if shrinking["fault"] in faults:
                known = self.findings[row.name, shrinking["fault"]]
                if (len(case.edits), _size(case)) <= shrinking.get("least", (99, 0)):
                    shrinking["least"] = (len(case.edits), _size(case))
                    self._keep_case(
                        row, case, shrinking["fault"], faults[shrinking["fault"]], answer, known.times
                    )
                raise Found(shrinking["fault"])

        run = settings(
            max_examples=count,
            database=None,
            deadline=None,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=list(HealthCheck),
            report_multiple_bugs=False,
            print_blob=False,
        )(seed(number)(given(drawn)(trial)))
        before = tally.inputs
        try:
            run()
        except Exception as error:  # the fault, or hypothesis' word for a search that was cut off
            if not shrinking:
                raise error
        if tally.inputs == before:  # a strategy that has no more cases to give
            raise RuntimeError(f"{row.name}: no cases can be drawn")

    def judge(self, row: Reader, case: Case) -> tuple[dict[str, Any], dict[str, str]]:
        """Run a case; what became of it, and its faults with details."""
        self._number += 1
        folder = self._work / f"case{self._number}" / "case"
        try:
            try:
                self.write(case, folder)
            except OSError:  # a name that no system takes
                return {"status": 2, "seconds": 0.0}, {}
            before = _listing(folder)
            answer = self._worker.run(row.name, folder, case.words, row.patience)
            strayed = [f"changed or made {name}" for name in _changed(folder, before, row)]
            strayed += [f"beside the case: {path.name}" for path in folder.parent.iterdir() if path != folder]
            asked = self._server.asked()
        finally:
            shutil.rmtree(folder.parent, ignore_errors=True)
        return answer, faults_of(row, answer, case, strayed, asked)

    def write(self, case: Case, folder: Path) -> None:
        """The files of a case."""
        folder.mkdir(parents=True)
        address = self._server.address.encode()
        for name, content in case.files.items():
            path = folder / name
            if path.parent != folder:
                path.parent.mkdir(parents=True, exist_ok=True)
            match content:
                case Special("folder"):
                    path.mkdir()
                case Special("fifo"):
                    os.mkfifo(path)
                case Special("link", target):
                    path.symlink_to(target)
                case Special("hole", size):
                    path.touch()
                    os.truncate(path, int(size))
                case bytes():
                    path.write_bytes(
                        content.replace(SERVER.encode(), address) if SERVER.encode() in content else content
                    )

    def _keep_case(
        self, row: Reader, case: Case, fault: str, detail: str, answer: dict[str, Any], times: int = 1
    ) -> None:
        """Write a failing case where it stays."""
        name = re.sub(r"[^A-Za-z0-9.]+", "-", f"{row.name} {fault}").strip("-")[:110]
        folder = self._keep / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        plain, special = {}, {}
        for file, content in case.files.items():
            (special if isinstance(content, Special) else plain)[file] = content
        for file, content in plain.items():
            path = folder / "case" / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        about = {
            "reader": row.name,
            "fault": fault,
            "detail": detail,
            "edits": case.edits,
            "words": case.words,
            "changed": [f for f in case.files if case.files[f] != self.files_of(row.seed).get(f)],
            "gone": [f for f in self.files_of(row.seed) if f not in case.files],
            "special": {file: [held.kind, held.target] for file, held in special.items()},
            "answer": {key: str(value)[-3000:] for key, value in answer.items()},
        }
        (folder / "about.json").write_text(json.dumps(about, indent=1))
        self.findings[row.name, fault] = Finding(row.name, fault, detail, folder, case.edits, times)


# Many readers, in several processes -------------------------------------------------------------------------

#: Inputs of one reader in a round.
ROUND = 20
_hunter: list[Hunter] = []


def hunt_all(
    names: list[str], root: Path, keep: Path, number: int, minutes: float, inputs: int, jobs: int
) -> tuple[dict[str, Tally], dict[tuple[str, str], Finding]]:
    """Rounds over all readers until the time is up, or each had `inputs`."""
    until = time.monotonic() + 60.0 * minutes
    tallies = {name: Tally() for name in names}
    findings: dict[tuple[str, str], Finding] = {}
    with ProcessPoolExecutor(jobs, get_context("spawn"), _begin, (str(root), str(keep))) as pool:
        turn = 0
        while time.monotonic() < until and not (inputs and turn * ROUND >= inputs):
            tasks = {
                pool.submit(_one, name, ROUND, number + 7919 * turn + k, until, set(findings)): name
                for k, name in enumerate(names)
            }
            for task in as_completed(tasks):
                tally, found = task.result()
                tallies[tasks[task]].add(tally)
                for key, finding in found.items():
                    print(f"FAULT {finding.reader}: {finding.fault}", flush=True)
                    findings.setdefault(key, finding)
            turn += 1
            done = sum(tally.inputs for tally in tallies.values())
            left = max(0.0, until - time.monotonic()) / 60.0
            print(f"{done} inputs, {len(findings)} faults, {left:.1f} min left", flush=True)
        pool.submit(_end).result()
    return tallies, findings


def _begin(root: str, keep: str) -> None:
    work = Path(tempfile.mkdtemp(dir=root))
    _hunter.append(Hunter(Path(root) / "seeds", work, Path(keep)))


def _one(
    name: str, count: int, number: int, until: float, known: set[tuple[str, str]]
) -> tuple[Tally, dict[tuple[str, str], Finding]]:
    if time.monotonic() >= until:
        return Tally(), {}
    hunter = _hunter[0]
    hunter.known |= known
    tally = hunter.hunt(name, count, number)
    found, hunter.findings = hunter.findings, {}
    hunter.known |= set(found)
    return tally, found


def _end() -> None:
    for hunter in _hunter:
        hunter.__exit__()


# What was kept ----------------------------------------------------------------------------------------------


def kept_case(folder: Path) -> tuple[Reader, Case]:
    """A failing case read back."""
    about = json.loads((folder / "about.json").read_text())
    root = folder / "case"
    files: dict[str, Any] = {
        str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()
    }
    files |= {name: Special(*held) for name, held in about["special"].items()}
    return READERS[about["reader"]], Case(files, about["edits"], about["words"])


def _size(case: Case) -> int:
    return sum(len(content) for content in case.files.values() if isinstance(content, bytes))


def _listing(folder: Path) -> dict[str, tuple[int, int]]:
    found = {}
    for path in folder.rglob("*"):
        known = path.lstat()
        found[str(path.relative_to(folder))] = (
            (known.st_size, known.st_mtime_ns) if path.is_file() else (0, 0)
        )
    return found


def _changed(folder: Path, before: dict[str, tuple[int, int]], row: Reader) -> list[str]:
    """Files of a case that are not as they were; a command may make its folder `out`."""
    after = _listing(folder)
    made = [name for name in after if before.get(name) != after[name] and name.split("/")[0] != "out"]
    return made + [f"{name} (gone)" for name in before if name not in after]


class _Server:
    """An address of this machine at which nobody may ask; who does is sent away, and counted."""

    def __init__(self) -> None:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._count = 0
        threading.Thread(target=self._send_away, daemon=True).start()

    def _send_away(self) -> None:
        with suppress(OSError):
            while True:
                self._socket.accept()[0].close()
                self._count += 1

    def asked(self) -> int:
        """How many came since the last time."""
        count, self._count = self._count, 0
        return count

    def close(self) -> None:
        self._socket.close()


# What a case must not do ------------------------------------------------------------------------------------

_OURS = re.compile(r"sightline: (?:warning|progress|note): ")
_FOREIGN = re.compile(
    r"encountered in |divide by zero|overflow encountered|invalid value|RuntimeWarning|DeprecationWarning|"
    r"FutureWarning|NotGeoreferencedWarning|ComplexWarning|RankWarning|<class |Traceback|object at 0x"
)
#: Of a scene that is being drawn: it may be as large as is asked.
_DRAWN = re.compile(r'File "[^"]*/sightline/simulate/')
_NAN = re.compile(r"(?<![\w.-])-?(?:nan|inf)(?![\w.-])")


def faults_of(
    row: Reader, answer: dict[str, Any], case: Case, strayed: list[str], asked: int
) -> dict[str, str]:
    """Faults that an answer shows, each with its details."""
    faults: dict[str, str] = {}
    where = answer.get("where", "")
    if "hung" in answer:
        if not _DRAWN.search(_main_thread(where)):
            faults["hung" + _place_in(where)] = where[-1500:]
        return faults
    if "died" in answer:
        faults[f"died {answer['died']}{_place_in(where)}"] = where[-1500:]
        return faults
    said = answer["said"] if row.words else answer["error"]
    if answer["status"] not in (0, 1, 2):
        faults[f"status {answer['status']}: {answer['kind']} at {where}"] = said[-1500:]
    drawn = answer["status"] == 0 and "progress: rendering" in said
    if answer["seconds"] > MOST_SECONDS and not drawn:
        faults["slow"] = f"{answer['seconds']:.1f} s"
    if answer["memory"] > MOST_MEMORY or "memory ran out" in said or answer["kind"] == "MemoryError":
        faults["memory"] = f"{answer['memory'] / 2**30:.2f} GiB {said[-300:]}"
    if strayed or answer["strayed"]:
        faults["strayed"] = str((strayed + answer["strayed"])[:5])
    if asked:
        faults["asked the network"] = str(asked)
    if answer.get("check") == 0:
        faults["check passed what the run refuses"] = said[-1500:]
    if answer["status"] in (0, 1, 2):
        faults |= _faults_of_words(row, answer, case)
    return faults


def _main_thread(log: str) -> str:
    """What faulthandler wrote of the main thread: it stands last."""
    return re.split(r"(?m)^(?:Current t|T)hread ", log)[-1]


def _place_in(log: str) -> str:
    """The innermost line of the package in what faulthandler wrote."""
    found = re.search(r'File "[^"]*/sightline/([^"]+)", line (\d+)', _main_thread(log))
    return f" at {found[1]}:{found[2]}" if found else ""


def _faults_of_words(row: Reader, answer: dict[str, Any], case: Case) -> dict[str, str]:
    """What is wrong with the words of an answer."""
    faults: dict[str, str] = {}
    if row.words:
        lines = [line for line in answer["said"].splitlines() if not _OURS.match(line)]
        errors = [line for line in lines if line.startswith("sightline: error: ")]
        if answer["status"] and (len(errors) != 1 or len(lines) != 1):
            faults["not one line"] = answer["said"][-1500:]
        elif not answer["status"] and lines:
            faults["foreign words"] = answer["said"][-1500:]
        message, all_said = " ".join(errors), answer["said"] + answer["stdout"]
    else:
        message = all_said = answer["error"]
        if len(message.splitlines()) > 1:
            faults["not one line"] = message[-1500:]
        leaked = [text for text in answer["warned"] if not text.startswith("UnobservableBandWarning")]
        foreign = [text for text in leaked if _FOREIGN.search(text)]
        if foreign:
            faults["foreign warning"] = str(foreign[:3])
    found = _FOREIGN.search(all_said)
    if found:
        faults[f"foreign words: {found[0].strip()}"] = all_said[-1500:]
    if answer["status"] and not _names_a_file(message, case, row.words):
        faults["no file named"] = message[-800:]
    if len(message) > 2500:
        faults["long-winded"] = f"{len(message)} characters: {message[:300]} ..."
    if row.words[:1] == ("check",) and not answer["status"]:
        odd = [line for line in answer["stdout"].splitlines() if _NAN.search(line)]
        if odd:
            faults["nan printed"] = "\n".join(odd[:5])
    return faults


def _names_a_file(message: str, case: Case, asked: Sequence[str] = ()) -> bool:
    """Whether a message names a file of the case, a path that stands in one, or an option."""
    words = [*(word for word in asked if word.startswith("--") and word != "--out"), *case.words]
    names = {part for name in case.files for part in (name.rsplit("/", 1)[-1], name.split("/")[0])}
    # an option by its name, or by what was given for it, unless that may stand in any message; of what is
    # very long the begin
    given = {part[:100] for word in words for part in word.lstrip("-").split("=") if len(part) > 2}
    given |= {repr(part)[1:-1] for part in given}  # as it is quoted
    values = {word.partition("=")[2] or word for word in case.words}
    if any(re.search(rf"(?<![\w.-]){re.escape(value)}(?![\w.])", message) for value in values if value):
        return True  # by itself, however short
    said = (message, message.replace("_", "-"))  # of Python's names too
    return any(name in text for name in names | given for text in said) or "/case" in message
