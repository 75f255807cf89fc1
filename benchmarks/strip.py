"""Time and memory of `sightline recover` on long, wide strips: are they linear in the number of lines?

    python benchmarks/strip.py
    python benchmarks/strip.py --folder strips --lengths 3000 6000 12000 --columns 6000
    python benchmarks/strip.py --folder strips --lengths 3000 12000 120000 --columns 300
    python benchmarks/strip.py --lengths 800 --columns 200 --first

Renders a strip of four bands per length (`sightline simulate line-of-sight`; a strip that the folder
already holds is used again) and recovers each in a process of its own, on all processors there are. Wall and
CPU time, and the peak memory of the process, are those of the whole command: reading, matching, estimating,
writing the result and its report; `--first`: and compiling the kernels, as in the first run of all. The score
against truth is that of `sightline score`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

#: The command of the environment that runs this script.
COMMAND = [str(Path(sys.executable).with_name("sightline"))]


def measured(arguments: list[str], *, first: bool = False) -> tuple[float, float, float]:
    """Wall and CPU seconds and peak memory (GiB) of one command, of that process alone.

    `first`: with no kernel compiled before.
    """
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryDirectory() as empty:
        kernels = {"NUMBA_CACHE_DIR": empty} if first else {}
        begin = time.perf_counter()
        process = subprocess.Popen(
            [*COMMAND, *arguments], stdout=said, stderr=subprocess.STDOUT, env=os.environ | kernels
        )
        # not RUSAGE_CHILDREN: its peak is that of the largest process so far, renderings included
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise SystemExit(f"sightline {' '.join(arguments)} failed:\n{said.read()}")
    unit = 2**30 if sys.platform == "darwin" else 2**20
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss / unit


def rendered(folder: Path, lines: int, columns: int, seed: int) -> Path:
    """The strip of so many lines, rendered unless it is there."""
    strip = folder / f"strip-{lines}x{columns}-{seed}"
    if not (strip / "acquisition.toml").exists():
        size = ["--lines", str(lines), "--columns", str(columns), "--seed", str(seed)]
        command = [*COMMAND, "simulate", "line-of-sight", *size, "--out", str(strip)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return strip


def score(result: Path, strip: Path) -> str:
    """rms error / NEES of roll, pitch and yaw."""
    command = [*COMMAND, "score", str(result), str(strip / "truth.csv")]
    said = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return "  ".join(f"{said[axis]['rms']:.4f}/{said[axis]['nees']:.2f}" for axis in ("roll", "pitch", "yaw"))


def run(folder: Path, lengths: list[int], columns: int, seed: int, *, first: bool) -> None:
    """The table."""
    print(f"{os.cpu_count()} processors, 4 bands of {columns} columns, load {os.getloadavg()[0]:.1f}")
    strips = {lines: rendered(folder, lines, columns, seed) for lines in sorted(lengths)}
    peaks = {}
    print("lines    wall s   CPU s   peak GiB   wall ms/line   CPU ms/line   rms px/NEES roll, pitch, yaw")
    for lines, strip in strips.items():
        result = folder / f"result-{strip.name}"
        arguments = ["recover", str(strip / "acquisition.toml"), "--out", str(result), "--overwrite"]
        wall, spent, peak = measured(arguments, first=first)
        peaks[lines] = peak
        print(
            f"{lines:6d} {wall:8.1f} {spent:7.1f} {peak:8.2f} {1e3 * wall / lines:12.2f} "
            f"{1e3 * spent / lines:13.2f}      {score(result, strip)}",
            flush=True,
        )
    shortest, longest = min(peaks), max(peaks)
    if shortest < longest:
        grown = (peaks[longest] - peaks[shortest]) / (longest - shortest) * 2**20
        print(f"memory grows by {grown:.1f} kiB a line")


def main() -> None:
    """Render what is missing, recover, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, help="where strips and results go; a temporary one by default")
    parser.add_argument("--lengths", nargs="+", type=int, default=[3000, 6000, 12000])
    parser.add_argument("--columns", type=int, default=6000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", action="store_true", help="compile the kernels in each run")
    arguments = parser.parse_args()
    if arguments.folder is not None:
        arguments.folder.mkdir(parents=True, exist_ok=True)
        run(arguments.folder, arguments.lengths, arguments.columns, arguments.seed, first=arguments.first)
        return
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder), arguments.lengths, arguments.columns, arguments.seed, first=arguments.first)


if __name__ == "__main__":
    main()
