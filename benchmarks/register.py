"""Resampling a whole image: error and speed of both cases beside OpenCV and scipy, in one run.

    python benchmarks/register.py               8192 x 8192, two minutes
    python benchmarks/register.py --size 2048   quick

Truth is no kernel's: a periodic texture of power 1/f^2 and system MTF 0.15 at Nyquist, cut off at a frequency
that every row of the first table names, moved by the phases of its Fourier series. Per line: every line has a
shift of its own, of which the truth is one inverse transform along columns for each line and, along lines, a
matrix of phases on a strip of columns. General: shifts that vary along the line too (yaw, relief), checked
on points drawn at random against the sum of the series.

Errors are rms in units of the texture's standard deviation; the ratio is to LANCZOS4, and no 16 weights per
axis could be better than the last column (least squares for that very spectrum). CPU seconds are of all
threads together, the same number for all; wall seconds beside them. Maps of OpenCV and scipy (one place per
pixel) are made beforehand and not counted; ours are evaluated inside.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # not OMP_NUM_THREADS, which rules our threads too

import numpy as np
import scipy.fft

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src"))

from sightline.execution import available_processors, in_threads  # noqa: E402
from sightline.products.resample import product_kernel, resample_rows  # noqa: E402

Array = np.ndarray
MTF_AT_NYQUIST, OUTER_SCALE = 0.15, 1800.0
PAD = 32
NODES = 64
#: The texture of the acceptance figure ends here; above, no 16 taps can be true.
ACCEPTED_CUT = 0.4


def spectrum(size: int, cut: float, seed: int) -> Array:
    """Half spectrum (size, size/2 + 1) of a texture of unit variance with nothing at `cut` and beyond."""
    white = np.random.default_rng(seed).standard_normal((size, size), dtype=np.float32)
    out = scipy.fft.rfft2(white, workers=2)
    fy, fx = scipy.fft.fftfreq(size)[:, None], scipy.fft.rfftfreq(size)[None, :]
    radius = fy**2 + fx**2
    power = MTF_AT_NYQUIST ** (8.0 * radius) / (radius + OUTER_SCALE**-2)
    power *= (np.abs(fy) < cut) & (np.abs(fx) < cut)
    power[0, 0] = 0.0
    out *= np.sqrt(power).astype(np.float32)
    image = scipy.fft.irfft2(out, workers=2)
    return (out / image.std()).astype(np.complex64)


def texture(half: Array) -> Array:
    """The texture at whole pixels, float32, with its period continued by `PAD` px on every side."""
    return np.pad(scipy.fft.irfft2(half, workers=2).astype(np.float32), PAD, mode="wrap")


def shifted_by_line(half: Array, lines: Array, columns: Array) -> Array:
    """Truth of the case per line: line i is the texture at line `lines[i]`, columns j + `columns[i]`."""
    size = half.shape[0]
    fy, fx = scipy.fft.fftfreq(size), scipy.fft.rfftfreq(size)
    used = np.flatnonzero(np.abs(half).max(axis=1) > 0)
    out = np.empty((len(lines), size), np.float32)
    for first in range(0, len(lines), 512):
        part = slice(first, first + 512)
        # along lines by the series itself, for these lines only; along columns by one transform per line
        phases = np.exp(2j * np.pi * np.outer(lines[part], fy[used])).astype(np.complex64) / size
        row = (phases @ half[used]) * np.exp(2j * np.pi * np.outer(columns[part], fx)).astype(np.complex64)
        out[part] = scipy.fft.irfft(row, n=size, axis=1, workers=2)
    return out


def series_at(half: Array, points: Array) -> Array:
    """Truth at single places (N, 2): the whole Fourier series summed in float64."""
    size = half.shape[0]
    fy, fx = scipy.fft.fftfreq(size), scipy.fft.rfftfreq(size)
    twice = np.where((fx == 0) | (fx == 0.5), 1.0, 2.0)
    used = np.flatnonzero(np.abs(half).max(axis=1) > 0)
    along = np.exp(2j * np.pi * np.outer(points[:, 0], fy[used])) @ half[used]
    return np.asarray(
        (along * twice * np.exp(2j * np.pi * np.outer(points[:, 1], fx))).real.sum(axis=1) / size**2
    )


def jitter(size: int, seed: int) -> tuple[Array, Array]:
    """Shifts (px) of every line along lines and columns: slow drift and fast jitter."""
    rng = np.random.default_rng(seed)
    t = np.arange(size) / size
    both = [
        3.0 * np.sin(2 * np.pi * (t + rng.uniform())) + 0.3 * np.sin(2 * np.pi * (200 * t + rng.uniform()))
        + 0.05 * rng.standard_normal(size)
        for _ in range(2)
    ]  # fmt: skip
    return both[0], both[1]


def places(size: int, shifts: tuple[Array, Array], general: bool) -> tuple[Array, Array]:
    """Position (size, M, 2) in the padded texture at the columns `nodes` (M,) of every line.

    The general case adds yaw of 1e-3 rad with its jitter and a parallax of some 0.3 px in waves of 400 px.
    """
    nodes = np.append(np.arange(0, size, NODES), size) if general else np.array([0, size])
    line = np.arange(size)[:, None] + shifts[0][:, None] + PAD + 0.0 * nodes
    column = nodes + shifts[1][:, None] + PAD
    if general:
        across = nodes - size / 2
        yaw = 1e-3 + 2e-5 * np.sin(2 * np.pi * 300 * np.arange(size) / size)
        relief = np.sin(2 * np.pi * np.arange(size) / 520.0)[:, None] * np.sin(2 * np.pi * nodes / 400.0)
        line = line + yaw[:, None] * across + 0.3 * relief
        column = column + 1e-4 * across + 0.02 * relief
    return np.stack([line, column], axis=-1), nodes


def dense(position: Array, nodes: Array) -> tuple[Array, Array]:
    """The same places at every pixel, float32 (lines, columns), as OpenCV and scipy take them."""
    size = len(position)
    maps = [np.empty((size, size), np.float32) for _ in range(2)]
    for i in range(size):
        for k in range(2):
            maps[k][i] = np.interp(np.arange(size), nodes, position[i, :, k])
    return maps[0], maps[1]


def blocks(size: int) -> list[tuple[int, int]]:
    return [(first, min(first + 256, size)) for first in range(0, size, 256)]


def ours(image: Array, position: Array, nodes: Array, threads: int) -> Array:
    out = np.empty((len(position), nodes[-1]), np.float32)

    def work(part: tuple[int, int]) -> None:
        here = slice(*part)
        low = int(position[here, :, 0].min()) - 12
        high = int(position[here, :, 0].max()) + 12
        resample_rows(image[low:high], position[here] - [low, 0], nodes, out[here])

    in_threads(work, blocks(len(position)), threads)
    return out


def opencv(image: Array, maps: tuple[Array, Array], threads: int) -> Array:
    import cv2

    cv2.setNumThreads(threads)
    out = np.empty(maps[0].shape, np.float32)
    for part in blocks(len(maps[0])):  # its images may not have 32767 lines, ours may
        here = slice(*part)
        low, high = int(maps[0][here].min()) - 12, int(maps[0][here].max()) + 12
        out[here] = cv2.remap(image[low:high], maps[1][here], maps[0][here] - low, cv2.INTER_LANCZOS4)
    return out


def scipy_spline(image: Array, maps: tuple[Array, Array], threads: int) -> Array:
    from scipy.ndimage import map_coordinates, spline_filter

    smooth = spline_filter(image, order=5, output=np.float32)
    out = np.empty(maps[0].shape, np.float32)

    def work(part: tuple[int, int]) -> None:
        here = slice(*part)
        where = np.stack([maps[0][here], maps[1][here]])
        out[here] = map_coordinates(smooth, where, order=5, prefilter=False, output=np.float32)

    in_threads(work, blocks(len(maps[0])), threads)
    return out


def timed(call: Callable[[], Array]) -> tuple[Array, float, float, float]:
    """Result, CPU seconds, wall seconds, peak memory of the call (GiB, its result included)."""
    forget_peak()
    before = memory("VmRSS")
    cpu, wall = time.process_time(), time.perf_counter()
    out = call()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return out, cpu, wall, memory("VmHWM") - before


def forget_peak() -> None:
    """Let the peak memory count from now on (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def memory(key: str) -> float:
    """GiB: resident now (VmRSS) or at its peak (VmHWM); NaN where the system does not say."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return float("nan")
    return float(status.split(f"{key}:")[1].split()[0]) / 2**20


def best_taps(cut: float, taps: int = 16) -> float:
    """Smallest rms error that any `taps` weights per axis leave on the texture cut off at `cut`.

    Least squares for its spectrum, one axis after the other; over all fractions of a pixel.
    """
    f = (np.arange(-512, 512) + 0.5) / 1024
    fy, fx = np.meshgrid(f, f, indexing="ij")
    radius = fy**2 + fx**2
    power = MTF_AT_NYQUIST ** (8.0 * radius) / (radius + OUTER_SCALE**-2)
    power *= (np.abs(fy) < cut) & (np.abs(fx) < cut)
    share = power.sum(axis=0) / power.sum()
    k = np.arange(taps) - (taps // 2 - 1)
    d = (np.arange(64) + 0.5) / 64
    normal = np.cos(2 * np.pi * np.subtract.outer(k, k)[..., None] * f) @ share + 1e-12 * np.eye(taps)
    right = np.cos(2 * np.pi * np.subtract.outer(k, d)[..., None] * f) @ share
    left = 1.0 - np.einsum("kd,kd->d", right, np.linalg.solve(normal, right))
    return float(np.sqrt(2.0 * left.mean()))


def errors_by_cut(size: int) -> None:
    """First table: rms error against the frequency at which the texture ends."""
    print(f"per line, {size} x {size}, rms error / texture")
    print("texture ends at     ours      LANCZOS4   ratio    spline 5   best 16 taps")
    shifts = jitter(size, 1)
    for cut in (0.25, 0.30, 0.35, 0.40, 0.42, 0.45, 0.51):
        half = spectrum(size, cut, 2)
        image = texture(half)
        position, nodes = places(size, shifts, general=False)
        truth = shifted_by_line(half, position[:, 0, 0] - PAD, position[:, 0, 1] - PAD)
        maps = dense(position, nodes)
        rms = [
            float(np.sqrt(np.mean((result - truth) ** 2)))
            for result in (
                ours(image, position, nodes, 2),
                opencv(image, maps, 2),
                scipy_spline(image, maps, 2),
            )
        ]
        name = f"{cut:.2f} c/px" if cut < 0.5 else "Nyquist  "
        print(
            f"{name:14} {rms[0]:10.2e} {rms[1]:12.2e} {rms[0] / rms[1]:8.3f} {rms[2]:10.2e}"
            f" {best_taps(cut):13.2e}"
        )


def both_cases(size: int, threads: int, spline: bool) -> None:
    """Second table: error and speed of both cases."""
    half = spectrum(size, ACCEPTED_CUT, 3)
    image = texture(half)
    shifts = jitter(size, 4)
    rng = np.random.default_rng(5)
    print(f"\n{size} x {size} float32, texture up to {ACCEPTED_CUT} c/px, {threads} threads")
    print("case      method       rms error   ratio   CPU s  ratio   wall s   ns/px CPU   GiB peak")
    for name in ("per line", "general"):
        position, nodes = places(size, shifts, general=name == "general")
        maps = dense(position, nodes)
        if name == "per line":
            rows = np.sort(rng.choice(size, min(size, 1024), replace=False))
            checked = np.ix_(rows, np.arange(size))
            truth = shifted_by_line(half, position[rows, 0, 0] - PAD, position[rows, 0, 1] - PAD)
        else:
            pick = rng.integers(0, size, (2, 4000))
            checked = tuple(pick)
            exact = np.array([
                [np.interp(j, nodes, position[i, :, k]) - PAD for k in range(2)]
                for i, j in pick.T
            ])  # fmt: skip
            truth = np.concatenate([series_at(half, part) for part in np.array_split(exact, 40)])
        methods: list[tuple[str, Callable[[], Array]]] = [
            ("ours", lambda p=position, n=nodes: ours(image, p, n, threads)),
            ("LANCZOS4", lambda m=maps: opencv(image, m, threads)),
        ]
        if spline:
            methods.append(("spline 5", lambda m=maps: scipy_spline(image, m, threads)))
        rows_out = []
        for method, call in methods:
            result, cpu, wall, more = timed(call)
            rms = float(np.sqrt(np.mean((result[checked] - truth) ** 2)))
            rows_out.append((method, rms, cpu, wall, more))
        base = rows_out[1]
        for method, rms, cpu, wall, more in rows_out:
            print(
                f"{name:9} {method:10} {rms:11.2e} {rms / base[1]:7.3f} {cpu:7.2f} {cpu / base[2]:6.2f}"
                f" {wall:8.2f} {1e9 * cpu / size**2:11.2f} {more:10.2f}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=8192)
    parser.add_argument(
        "--no-spline", action="store_true", help="leave scipy out (it takes most of the time)"
    )
    given = parser.parse_args()
    threads = available_processors()
    warm = np.zeros((64, 600), np.float32)
    for general in (False, True):  # compile before the clock runs
        position, nodes = places(512, (np.zeros(512), np.zeros(512)), general)
        resample_rows(
            warm, position[:4] - [10, 0], nodes, np.empty((4, 512), np.float32), table=product_kernel()
        )
    both_cases(given.size, threads, not given.no_spline)
    errors_by_cut(min(given.size, 2048))


if __name__ == "__main__":
    main()
