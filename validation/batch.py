"""A batch whatever does it: threads, processes, a dask cluster whose workers and scheduler are killed.

Small strips are rendered and recovered one after the other, which gives what all other ways must give bit for
bit, but for `wall_seconds`, `peak_memory_bytes`, CREATION_DATE and `report.html`:

- one strip by 2 and 4 threads, by a process and by a worker of a cluster;
- all strips by 2 processes, and by a cluster of this machine: how much more CPU time the whole tree of
  processes takes than one process does, its start among it;
- all strips on a scheduler and workers of their own, of which one after the other is killed at random
  moments, and the scheduler once; the batch, which then ends with one error, is run again with `--resume`;
- 1,000 files of which a batch makes nothing: time for each.

    python validation/batch.py [--strips 40] [--lines 400] [--columns 200] [--kills 20] [--seed 1]

Needs `dask` and `distributed`. Ends with 1 if anything differs.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import gates

MEASURES = (
    "sightline.execution",
    "sightline.stages",
    "sightline.applications.batch",
    "sightline.cli.batch",
    "sightline.cli.jobs",
    "sightline.output.folder",
)
#: What a run may say of itself.
MEASURED = {"wall_seconds", "peak_memory_bytes"}
EMPTY = 1000


def sightline(*words: str, status: int = 0) -> tuple[float, float, str]:
    """A command run to its end: s of wall, CPU s of all its processes, what it said on stderr."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "sightline", *words], capture_output=True, text=True, check=False
    )
    took, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != status:
        sys.exit(f"sightline {' '.join(words[:2])} ended with {done.returncode}: {done.stderr[-600:]}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return took, cpu, done.stderr


def plain(value: Any) -> Any:
    """A summary without what a run says of itself."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items() if key not in MEASURED}
    return [plain(item) for item in value] if isinstance(value, list) else value


def content(path: Path) -> Any:
    """A file, less what may differ."""
    if path.suffix == ".json":
        return plain(json.loads(path.read_text()))
    return [line for line in path.read_bytes().split(b"\n") if b"CREATION_DATE" not in line]


def unlike(first: Path, second: Path) -> int:
    """How many files of two results differ, or are in one of them alone."""
    names = {
        path.relative_to(folder)
        for folder in (first, second)
        for path in folder.rglob("*")
        if path.is_file() and path.name != "report.html"
    }
    there = [name for name in names if (first / name).is_file() and (second / name).is_file()]
    return len(names) - sum(content(first / name) == content(second / name) for name in there)


def results(folder: Path) -> list[dict[str, str]]:
    """Rows of results.csv."""
    with (folder / "results.csv").open() as stream:
        return list(csv.DictReader(stream))


class Cluster:
    """A scheduler and two workers, each a process of this machine that may be killed."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.folder = folder
        folder.mkdir(exist_ok=True)
        environment = os.environ | {
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
            "DASK_DISTRIBUTED__NANNY__PRE_SPAWN_ENVIRON": "{}",
        }

        def begun(*words: str) -> subprocess.Popen[bytes]:
            log = (folder / f"{words[0]}.log").open("ab")
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *words], stdout=log, stderr=log, env=environment, cwd=folder
            )

        self.scheduler = begun("scheduler", "--port", str(self.port), "--no-dashboard", "--no-jupyter")
        time.sleep(8.0)
        self.workers = begun(
            "worker",
            self.address,
            "--nworkers",
            "2",
            "--nthreads",
            "1",
            "--no-dashboard",
            "--death-timeout",
            "60",
        )

    def kill_a_worker(self, draw: random.Random) -> bool:
        """SIGKILL to one of the two, which its nanny replaces; False where none is there at the moment."""
        import psutil

        there = []
        for child in psutil.Process(self.workers.pid).children():
            if "spawn_main" in " ".join(child.cmdline()):
                there.append(child)
        if not there:
            return False
        draw.choice(there).send_signal(signal.SIGKILL)
        return True

    def close(self) -> None:
        """End all of it."""
        for one in (self.workers, self.scheduler):
            if one.poll() is None:
                one.terminate()
        for one in (self.workers, self.scheduler):
            try:
                one.wait(30.0)
            except subprocess.TimeoutExpired:
                one.kill()
                one.wait()


def rendered(folder: Path, count: int, lines: int, columns: int) -> list[str]:
    """Strips, by their TOML files."""
    size = ("--lines", str(lines), "--columns", str(columns))
    for number in range(count):
        sightline(
            "simulate",
            "line-of-sight",
            *size,
            "--seed",
            str(number),
            "--out",
            str(folder / f"strip{number:02}"),
        )
    return [str(folder / f"strip{number:02}" / "acquisition.toml") for number in range(count)]


def one_strip(folder: Path, strip: str) -> None:
    """One strip, wherever its command runs."""
    sightline("recover", strip, "--out", str(folder / "alone"))
    for workers in ("1", "2", "4", "process:2", "dask:local"):
        out = folder / f"one-{workers.replace(':', '-')}"
        sightline("recover", strip, "--out", str(out), "--workers", workers)
        gates.check(f"files that differ, recover --workers {workers}", unlike(folder / "alone", out), 0, 0)


def all_strips(folder: Path, strips: list[str], serial: Path, cpu: float) -> None:
    """All strips by two processes and on a cluster of this machine, and the CPU time of each way."""
    count = len(strips)
    for workers in ("process:2", "dask:local"):
        out = folder / f"all-{workers.replace(':', '-')}"
        took, all_cpu, _ = sightline("batch", *strips, "--out", str(out), "--workers", workers)
        apart = sum(unlike(serial / Path(one).parent.name, out / Path(one).parent.name) for one in strips)
        print(f"{count} strips, {workers}: {took:.0f} s, {all_cpu:.0f} s of CPU (one process: {cpu:.0f} s)")
        gates.check(f"files that differ, batch --workers {workers}", apart, 0, 0)
        gates.check(
            f"CPU time beyond that of one process, {workers}", all_cpu / cpu - 1.0, most=0.1, form=".3f"
        )


def killed(
    folder: Path, strips: list[str], serial: Path, kills: int, pace: float, draw: random.Random
) -> None:
    """All strips on a cluster of which workers are killed at a pace (s), and the scheduler once."""
    out, cluster = folder / "killed", Cluster(folder / "cluster")
    words = ["batch", *strips, "--out", str(out), "--workers", f"dask:{cluster.address}"]
    done, stopped = 0, threading.Event()

    def kill_on(limit: int) -> None:
        nonlocal done
        while done < limit and not stopped.wait(draw.uniform(0.3, 1.7) * pace):
            done += cluster.kill_a_worker(draw)

    time.sleep(8.0)
    killer = threading.Thread(target=kill_on, args=(kills // 2,))
    killer.start()
    first = subprocess.Popen([sys.executable, "-m", "sightline", *words], stderr=subprocess.PIPE, text=True)
    killer.join()
    cluster.scheduler.kill()
    assert first.stderr is not None
    said = first.stderr.read()
    errors = re.findall(r"(?m)^sightline: error: .*", said)
    print(f"the scheduler killed after {done} workers: exit status {first.wait()}: {errors[-1:]}")
    gates.note(
        "one error where the scheduler is gone",
        str(len(errors)),
        "1",
        len(errors) == 1 and first.returncode == 1,
    )
    cluster.close()
    cluster = Cluster(folder / "cluster")
    words[-1] = f"dask:{cluster.address}"
    time.sleep(8.0)
    killer = threading.Thread(target=kill_on, args=(kills,))
    killer.start()
    took, _, _ = sightline(*words, "--resume")
    stopped.set()
    killer.join()
    cluster.close()
    rows = results(out)
    print(
        f"resumed: {sum(row['kept'] == '1' for row in rows)} kept, {took:.0f} s; {done} workers killed in all"
    )
    gates.check("workers killed", done, least=kills)
    gates.check("inputs done", sum(row["state"] == "done" for row in rows), len(strips), len(strips))
    apart = sum(unlike(serial / row["name"], out / row["name"]) for row in rows)
    gates.check("files that differ after kills of workers and scheduler", apart, 0, 0)


def empty(folder: Path) -> None:
    """Files of which a batch makes nothing: what a job costs by itself."""
    (folder / "empty").mkdir()
    names = [f"nothing{number}.toml" for number in range(EMPTY)]
    for name in names:
        (folder / "empty" / name).write_text("detectors = 3\n")
    (folder / "empty" / "list.txt").write_text("\n".join(names))
    for workers in ("process:2", "dask:local"):
        out = folder / f"empty-{workers.replace(':', '-')}"
        words = ("batch", f"@{folder / 'empty' / 'list.txt'}", "--out", str(out), "--workers", workers)
        took, cpu, _ = sightline(*words, status=1)
        print(f"{EMPTY} files without work, {workers}: {took:.1f} s, {cpu:.1f} s of CPU, start and end too")
        gates.check(f"ms of CPU for a job without work, {workers}", 1e3 * cpu / EMPTY, most=50.0, form=".1f")


def main() -> None:
    """Print all; name what was missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--strips", type=int, default=40)
    parser.add_argument("--lines", type=int, default=400)
    parser.add_argument("--columns", type=int, default=200)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "2"  # two workers of a cluster of this machine
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        strips = rendered(folder / "strips", given.strips, given.lines, given.columns)
        one_strip(folder, strips[0])
        _, cpu, _ = sightline("batch", *strips, "--out", str(folder / "serial"), "--workers", "1")
        rows = results(folder / "serial")
        each, pace = (
            sum(float(row[key]) for row in rows[1:]) / len(rows[1:])
            for key in ("cpu_seconds", "wall_seconds")
        )
        print(
            f"{given.strips} strips of {given.lines} lines x {given.columns} columns x 4 bands: "
            f"{each:.1f} s of CPU each"
        )
        killed(folder, strips, folder / "serial", given.kills, pace, random.Random(given.seed))
        all_strips(folder, strips, folder / "serial", cpu)
        empty(folder)


if __name__ == "__main__":
    gates.run(main, __file__)
