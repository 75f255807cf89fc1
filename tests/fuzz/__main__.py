"""``make fuzz MINUTES=30 [SEED=...]``: spoilt inputs for every reader until the time is up.

Prints the seed, a table of the readers, the kinds of changes, and every fault with the smallest case that
shows it and the command that repeats it. Exit status 1 if there is one.
"""

from __future__ import annotations

import argparse
import os
import secrets
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.fuzz.hunt import Finding, Hunter, Tally, hunt_all, kept_case
from tests.fuzz.readers import READERS
from tests.fuzz.seeds import build

#: Inputs that every reader is to get.
LEAST = 100


def main() -> int:
    """Read the command line and hunt."""
    words = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    words.add_argument("--minutes", type=float, default=30.0, help="how long to go on")
    words.add_argument("--seed", type=int, help="a new one by default")
    words.add_argument("--inputs", type=int, default=0, help="end when every reader had so many")
    words.add_argument("--readers", default="", help="only those whose names hold this")
    words.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    words.add_argument("--keep", type=Path, default=Path(".fuzz"), help="folder for failing cases")
    words.add_argument("--repeat", type=Path, help="run a kept case again")
    asked = words.parse_args()
    if asked.repeat is not None:
        return repeat(asked.repeat)
    number = secrets.randbelow(2**31) if asked.seed is None else asked.seed
    print(f"seed {number}: repeat all of it with SEED={number}", flush=True)
    names = [name for name in READERS if asked.readers in name]
    with tempfile.TemporaryDirectory(prefix="sightline-fuzz-") as folder:
        root = Path(folder)
        build(root / "seeds")
        tallies, findings = hunt_all(
            names, root, asked.keep.resolve(), number, asked.minutes, asked.inputs, asked.jobs
        )
    report(tallies, findings)
    return 1 if findings else 0


def report(tallies: dict[str, Tally], findings: dict[tuple[str, str], Finding]) -> None:
    """Print what was tried and what became of it."""
    heads = ("inputs", "taken", "ref. 1", "ref. 2", "mean s")
    print(f"{'reader':62}" + "".join(f" {head:>7}" for head in heads) + f" {'worst s':>8} {'MiB':>6}")
    total, kinds = Tally(), Counter[str]()
    for name, tally in tallies.items():
        total.add(tally)
        kinds += tally.edits
        print(_line(name, tally))
    print(_line("all", total))
    print("\nchanges: " + ", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items())))
    few = [name for name, tally in tallies.items() if tally.inputs < LEAST]
    if few:
        print(f"\nfewer than {LEAST} inputs: {len(few)} of {len(tallies)} readers; give more MINUTES")
    for finding in findings.values():
        print(
            f"\nFAULT {finding.reader}: {finding.fault} ({finding.times} times)"
            f"\n  {finding.detail.strip()[:600]}"
        )
        print(
            f"  after: {', '.join(finding.edits)}\n  repeat: python -m tests.fuzz --repeat {finding.folder}"
        )
    print(
        f"\n{total.inputs} inputs of {len(tallies)} readers, {len(kinds)} kinds of changes, "
        f"{len(findings)} faults"
    )


def _line(name: str, tally: Tally) -> str:
    refused = tally.refused
    return (
        f"{name:62} {tally.inputs:7} {tally.accepted:7} {refused[1]:7} {refused[2]:7} "
        f"{tally.seconds / max(tally.inputs, 1):7.3f} {tally.worst:8.2f} "
        f"{tally.memory / 2**20:6.0f}"
    )


def repeat(folder: Path) -> int:
    """Run a kept case again and say what becomes of it."""
    row, case = kept_case(folder)
    with (
        tempfile.TemporaryDirectory(prefix="sightline-fuzz-") as work,
        Hunter(Path(work), Path(work), Path(work)) as hunter,
    ):
        answer, faults = hunter.judge(row, case)
    for key, value in answer.items():
        print(f"{key}: {str(value)[-3000:]}")
    for fault, detail in faults.items():
        print(f"FAULT {fault}\n  {detail}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
