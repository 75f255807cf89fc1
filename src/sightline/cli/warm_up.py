"""``sightline warm-up``: compiled kernels made before they are needed."""

from __future__ import annotations

#: Small jobs of every command that computes: kernels are compiled for what real ones call them with.
JOBS = (
    "simulate line-of-sight --lines 400 --columns 200 --out strip",
    "recover strip/acquisition.toml --out recovered",
    "register strip/acquisition.toml --motion recovered --out registered",
    "tdi tdi.toml --motion recovered --out settings",
    "simulate stereo --shots 4 --points 30 --out pair",
    "orient pair/stereo.toml --out oriented",
    "simulate frames --case small --lines 128 --columns 128 --frames 12 --out flight",
    "georeference flight/sequence.toml --out located",
)


def warm_up() -> None:
    """Compile the kernels of all commands, so that the first run of each need not wait for it."""
    import subprocess
    import sys
    import tempfile
    import time
    from pathlib import Path

    from sightline.cli.demo import TDI
    from sightline.cli.terminal import progress, say
    from sightline.errors import EstimationError

    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, progress() as report:
        (Path(folder) / "tdi.toml").write_text(TDI.replace("scene/", "strip/"), encoding="utf-8")
        for number, job in enumerate(JOBS):
            report(f"compiling for {job.split()[0]}", number, len(JOBS))
            words = [sys.executable, "-m", "sightline", *job.split()]
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                last = (done.stderr.strip().splitlines() or ["nothing"])[-1]
                raise EstimationError(
                    f"`sightline {job}`, on data that it renders itself, ended with: {last}; "
                    "please report this"
                )
    say(f"kernels are compiled and kept: {time.perf_counter() - begun:.0f} s")
