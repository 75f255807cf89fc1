"""`sightline demo` with a package on a read-only file system, by another user, without a home.

    python validation/read_only.py     # five minutes; Linux, as root: it mounts and changes its user

All of it happens in a mount namespace of its own, which ends with the command. Run three times: with an empty
temporary directory, with what the first run left there, and where nothing but `--out` can be written.
The results have the same bits, but for wall time, memory and the date of an AEM.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import gates

MEASURES = ("sightline.compiled", "sightline.access", "sightline.writing", "sightline.output.folder")
PACKAGE = Path(__file__).resolve().parents[1] / "src" / "sightline"
#: Owner of nothing.
NOBODY = 65534
#: What differs between two runs that are the same.
UNEQUAL = ("wall_seconds", "peak_memory_bytes")

# A tmpfs holds the package and is then made read-only. Where a folder on the way to Python is closed to other
# users, an empty one stands in its place, which holds Python and nothing else.
SCRIPT = """
set -e
mount --make-rprivate /
mount -t tmpfs -o mode=755 tmpfs "$STAGE"
mkdir "$STAGE/package" "$STAGE/kept"
cp -r "$PACKAGE" "$STAGE/package/sightline"
chmod -R a+rX "$STAGE/package"
for needed in $NEEDED; do
    closed=$needed
    for above in $(python_parents "$needed"); do
        [ "$(stat -c %A "$above" | cut -c10)" = - ] && closed=$above && break
    done
    if [ "$closed" != "$needed" ]; then
        mount --rbind "$needed" "$STAGE/kept"
        mount -t tmpfs -o mode=755 tmpfs "$closed"
        mkdir -p "$needed"
        mount --move "$STAGE/kept" "$needed"
        mount -o remount,ro "$closed"
    fi
done
if [ -n "$BARE" ]; then
    mount --rbind "$WORK" "$STAGE/kept"
    for place in /tmp /var/tmp /usr/tmp; do
        if [ -d "$place" ]; then mount --rbind "$place" "$place"; mount -o remount,bind,ro "$place"; fi
    done
    WORK="$STAGE/kept"
fi
mount -o remount,ro "$STAGE"
cd "$WORK"
exec setpriv --reuid=NOBODY --regid=NOBODY --clear-groups --no-new-privs env -i \
    PATH=/usr/bin:/bin HOME="$STAGE" TMPDIR="$TEMPORARY" PYTHONPATH="$STAGE/package" \\
    "$PYTHON" -m sightline "$@"
"""
PARENTS = """
python_parents() {
    way=; rest=$1
    IFS=/; set -- $rest; unset IFS
    for part in "$@"; do [ -z "$part" ] || { way="$way/$part"; echo "$way"; }; done
}
"""


def cannot() -> str:
    """Why this cannot be tried here; "" where it can."""
    if not sys.platform.startswith("linux"):
        return "it needs Linux"
    if os.geteuid() != 0:
        return "it needs root, to mount and to change the user"
    missing = [name for name in ("unshare", "mount", "setpriv") if shutil.which(name) is None]
    if missing:
        return f"it needs {', '.join(missing)}"
    with tempfile.TemporaryDirectory() as folder:
        tried = subprocess.run(
            ["unshare", "-m", "sh", "-c", 'mount --make-rprivate / && mount -t tmpfs tmpfs "$0"', folder],
            capture_output=True,
            text=True,
        )
    return "" if tried.returncode == 0 else f"a mount is refused: {tried.stderr.strip()}"


def run_elsewhere(
    words: Sequence[str], work: Path, temporary: Path, *, bare: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run ``sightline`` with `words` in the folder `work`, which it may write, as it may `temporary`.

    With `bare`, no directory for temporary files can be written.
    """
    stage = work.parent / "stage"  # the same in every run: kernels are kept by the place of their package
    for folder in (work, temporary, stage):
        folder.mkdir(exist_ok=True)
    for folder in (work, temporary):
        os.chown(folder, NOBODY, NOBODY)
    environment = {
        "PATH": os.environ["PATH"],
        "STAGE": str(stage),
        "PACKAGE": str(PACKAGE),
        "NEEDED": " ".join(dict.fromkeys([sys.base_prefix, sys.prefix])),
        "PYTHON": sys.executable,
        "WORK": str(work),
        "TEMPORARY": str(stage if bare else temporary),
        "BARE": "yes" if bare else "",
    }
    return subprocess.run(
        ["unshare", "-m", "sh", "-c", PARENTS + SCRIPT.replace("NOBODY", str(NOBODY)), "sh", *words],
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )


def contents(folder: Path) -> dict[str, object]:
    """Every file of a result but its pages, without what is new in every run: times, memory, dates.

    A summary among the inputs of another holds such things, so its hash is left out too.
    """
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.name == "summary.json":
            summary = json.loads(path.read_text(encoding="utf-8"))
            found[name] = {key: value for key, value in summary.items() if key not in UNEQUAL}
            summary["inputs"].pop("summary.json", None)
        elif path.suffix == ".aem":
            lines = path.read_text(encoding="utf-8").splitlines()
            found[name] = [line for line in lines if not line.startswith("CREATION_DATE")]
        elif path.is_file() and path.suffix != ".html":
            found[name] = path.read_bytes()
    return found


def kernels(temporary: Path) -> dict[str, int]:
    """Kept kernels, and when each was written."""
    files = temporary.glob(f"sightline-kernels-{NOBODY}/*/*.nbc")
    return {str(path.relative_to(temporary)): path.stat().st_mtime_ns for path in files}


def main() -> None:
    refused = cannot()
    if refused:
        sys.exit(f"left out: {refused}")
    with tempfile.TemporaryDirectory() as name:
        base = Path(name)
        base.chmod(0o755)
        temporary, before, first = base / "temporary", {}, {}
        print("| run | status | kernels kept (new) | same bits as the first | said |")
        print("|---|---|---|---|---|")
        runs = (("first", False), ("again", False), ("nothing but --out can be written", True))
        for number, (label, bare) in enumerate(runs):
            work = base / f"work-{number}"
            ran = run_elsewhere(["demo", "--out", "demo"], work, temporary, bare=bare)
            after = kernels(temporary)
            new = {key: value for key, value in after.items() if before.get(key) != value}
            found = contents(work / "demo") if ran.returncode == 0 else {}
            first = first or found
            notes = [line for line in ran.stderr.splitlines() if ": note: " in line]
            said = notes[0].partition(": note: ")[2].partition(",")[0] if notes else "nothing"
            said = said.replace(f"{base}/", "")
            same = bool(found) and found == first
            gates.check(f"{label}: exit status", ran.returncode, 0, 0)
            gates.note(f"{label}: same bits as the first", str(same), "True", same)
            gates.check(f"{label}: notes of where kernels are kept", len(notes), 1, 1)
            kept = bool(after) and bool(new) == (label == "first")
            gates.note(
                f"{label}: kernels kept, new", f"{len(after)}, {len(new)}", "new in the first alone", kept
            )
            print(f"| {label} | {ran.returncode} | {len(after)} ({len(new)}) | {same} | {said} |", flush=True)
            if ran.returncode:
                print(ran.stderr)
            before = after


if __name__ == "__main__":
    gates.run(main, __file__)
