"""Truth for the matcher: random textures made and shifted in the Fourier domain.

A periodic texture of power 1/f^2 is synthesised four times finer than the image, blurred by a Gaussian
system MTF of 0.15 at the image's Nyquist frequency, shifted by a phase ramp, and decimated: the images alias
like those of a real sensor. It shares nothing with the matcher.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

OVER = 4


def frequencies(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies of the fine grid in cycles per image pixel, for rfft2."""
    return (
        np.fft.fftfreq(shape[0] * OVER)[:, None] * OVER,
        np.fft.rfftfreq(shape[1] * OVER)[None, :] * OVER,
    )


def shifted_pair(
    shape: tuple[int, int],
    shift: tuple[float, float],
    *,
    snr: float,
    seed: int,
    cross: bool = False,
    rho: float = 0.95,
    gamma: float = 0.8,
    gain: float = 0.8,
    contrast: float = 0.2,
    mtf_at_nyquist: float = 0.15,
    motion: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two noisy images; what lies at p in the first lies at p + shift in the second.

    With `motion` (lines, 2) each line of the second is shifted by so much more: its line i shows at column j
    what lies at ``(i, j) - shift - motion[i]`` in the first.

    With `cross` the second is of another band: an independent layer of the same spectrum (coherence rho^2),
    gamma and gain. SNR = mean / noise in each image; contrast = std / mean of the image.
    """
    from scipy import fft

    rng = np.random.default_rng(seed)
    fy, fx = frequencies(shape)
    f2 = fy**2 + fx**2
    fine = (shape[0] * OVER, shape[1] * OVER)
    blur = np.exp(np.log(mtf_at_nyquist) * f2 / 0.25).astype(np.float32)
    f2[0, 0] = np.inf

    def layer() -> NDArray[np.complex64]:
        return np.asarray(fft.rfft2(rng.standard_normal(fine, dtype=np.float32)) / np.sqrt(f2), np.complex64)

    def image(
        spectrum: NDArray[np.complex64],
        power: float,
        level: float,
        moved: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        seen = fft.irfft2(spectrum * blur, s=fine)
        scene = fft.irfft2(spectrum, s=fine) * (contrast / seen.std())
        if power != 1.0:
            scene = np.maximum(1.0 + scene, 0.02) ** power
            seen = fft.irfft2(fft.rfft2(scene) * blur, s=fine)
        else:
            seen = 1.0 + seen * (contrast / seen.std())
        sampled = level * (seen[::OVER, ::OVER] if moved is None else _line_by_line(seen, moved)).astype(
            float
        )
        return sampled + rng.standard_normal(sampled.shape) * (sampled.mean() / snr)

    a = layer()
    b = (rho * a + np.sqrt(1 - rho**2) * layer()).astype(np.complex64) if cross else a
    ramp = np.exp(-2j * np.pi * (fy * shift[0] + fx * shift[1])).astype(np.complex64)
    first = image(a, 1.0, 1000.0)
    second = image(b * ramp, gamma if cross else 1.0, 1000.0 * (gain if cross else 1.0), motion)
    return first.astype(np.float32), second.astype(np.float32)


def _line_by_line(fine: NDArray[np.float32], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lines of an image OVER times finer, each from its own place: a windowed sinc, then Fourier phase."""
    lines, taps = len(motion), np.arange(-7, 9)
    wave = -2j * np.pi * np.fft.rfftfreq(fine.shape[1])
    out = np.empty((lines, fine.shape[1] // OVER))
    for i, (dy, dx) in enumerate(motion):
        place = OVER * (i - dy)
        whole = int(np.floor(place))
        # what is left at these frequencies, under an eighth of a cycle per fine pixel, is below 1e-5
        weights = (
            np.sinc(taps - (place - whole))
            * np.kaiser(2001, 8.0)[np.rint(1000 + 1000 * (taps - (place - whole)) / 8.5).astype(int)]
        )
        row = weights @ fine[(whole + taps) % len(fine)] / weights.sum()
        out[i] = np.fft.irfft(np.fft.rfft(row) * np.exp(wave * OVER * dx), n=len(row))[::OVER]
    return out


def information_bounds(
    shape: tuple[int, int],
    pixels: int,
    *,
    snr: float,
    cross: bool = False,
    rho: float = 0.95,
    gamma: float = 0.8,
    contrast: float = 0.2,
    mtf_at_nyquist: float = 0.15,
) -> dict[str, float]:
    """Smallest possible sigma (px, per axis) of the shift of a window of so many pixels of `shifted_pair`.

    gradient: (s1^2 + s2^2/g^2) / sum of squared gradients. coherence: c = rho^2 S^2 / ((S + N)(S + N)).
    aliased: the same with the folded spectrum counted as noise (it does not move with the shift).
    """
    fy = np.fft.fftfreq(shape[0] * OVER)[:, None] * OVER
    fx = np.fft.fftfreq(shape[1] * OVER)[None, :] * OVER
    f2 = fy**2 + fx**2
    f2[0, 0] = np.inf
    power = np.exp(2 * np.log(mtf_at_nyquist) * np.where(np.isinf(f2), 0.0, f2) / 0.25) / f2
    power *= contrast**2 / power.sum() * shape[0] * shape[1]  # variance = mean over the image's own modes
    pick = [np.where(np.arange(n) < n // 2, np.arange(n), np.arange(n) + n * (OVER - 1)) for n in shape]
    signal = power[np.ix_(*pick)]
    folded = power.reshape(OVER, shape[0], OVER, shape[1]).sum(axis=(0, 2)) - signal
    wy = (2 * np.pi * np.fft.fftfreq(shape[0])[:, None]) ** 2
    g2 = gamma**2 if cross else 1.0
    noise = 1.0 / snr**2
    r2 = rho**2 if cross else 1.0

    def sigma(alias: NDArray[np.float64] | float) -> float:
        c = r2 * signal**2 * g2 / ((signal + noise + alias) * (g2 * (signal + alias) + noise))
        return float(1 / np.sqrt(pixels * (wy * c / (1 - c)).mean()))

    gradient = float(np.sqrt((noise + noise / g2) / (pixels * (wy * signal).mean())))
    return {"gradient": gradient, "coherence": sigma(0.0), "aliased": sigma(folded)}
