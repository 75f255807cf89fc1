"""What is known of the motion of a strip: the motion recovered, and what it may be besides.

Three kinds of not knowing: a stationary error of known spectral density (blind bands, and all above what
windows resolve, hold the motion's own density there); hidden directions, which the images leave free, with
the covariance of how much of each there may be; jitter too fast for any of it.

Not here: what it does to TDI (``motion_mtf.py``), files (``io/tdi/motion.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sightline.errors import InputError, SpanError
from sightline.geometry.trajectory import Motion
from sightline.imaging.tdi_transfer import dirichlet
from sightline.motion.strip.joint import CONSTANT_SIGMA
from sightline.tdi.scan_columns import ColumnGeometry

Array = NDArray[np.float64]

#: TDI's own low-pass is undone up to where it leaves less than this of a motion: beyond, noise is amplified
#: more than twice, and the first zero is near.
LEAST_SEEN = 0.5
#: Densities of motion fall at least as f to this power where nothing is measured.
FALL = -4.0
#: rad; a slip of a larger sigma comes from the prior of the yaw's constant.
LOOSE_SLIP = 0.5 * CONSTANT_SIGMA[2]


@dataclass(frozen=True, eq=False)
class MotionKnowledge:
    """A motion and how well it is known.

    Attributes
    ----------
    motion : Motion
        rad; departures from the reference attitude. Its own covariance is not used.
    frequency : (F,)
        Hz, rising; of `error_psd`.
    error_psd : (F, 3)
        rad^2/Hz, one-sided; error of roll, pitch, yaw, hidden directions left out. Empty where exact.
    hidden : (N, 3, H)
        Hidden directions at the times of the motion.
    hidden_covariance : (H, H)
        Of how much the motion holds of each, besides what the motion given has.
    jitter : (3,)
        rad, 1-sigma; motion faster than every frequency of the table.
    warnings : tuple of str
        What had to be left out.
    """

    motion: Motion
    frequency: Array = field(default_factory=lambda: np.zeros(0))
    error_psd: Array = field(default_factory=lambda: np.zeros((0, 3)))
    hidden: Array | None = None
    hidden_covariance: Array | None = None
    jitter: Array = field(default_factory=lambda: np.zeros(3))
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what does not fit together."""
        if np.shape(self.error_psd) != (len(self.frequency), 3):
            raise InputError(
                f"`error_psd` has shape {np.shape(self.error_psd)}; ({len(self.frequency)}, 3), roll, pitch "
                "and yaw at every frequency, is needed"
            )
        if not (np.isfinite(self.error_psd).all() and (np.asarray(self.error_psd) >= 0.0).all()):
            raise InputError("`error_psd` must be finite and 0 or more at every frequency")
        if (self.hidden is None) != (self.hidden_covariance is None):
            raise InputError("`hidden` and `hidden_covariance` belong together: give both or neither")
        if self.hidden is not None and self.hidden_covariance is not None:
            count = len(self.hidden_covariance)
            if np.shape(self.hidden) != (len(self.motion.t), 3, count):
                raise InputError(
                    f"`hidden` has shape {np.shape(self.hidden)}; ({len(self.motion.t)}, 3, {count}), times, "
                    "axes and directions, is needed"
                )
            if not np.isfinite(self.hidden_covariance).all():
                raise InputError("`hidden_covariance` must be finite")

    @property
    def exact(self) -> bool:
        """Whether nothing but the jitter is uncertain."""
        known = self.hidden_covariance is None or not self.hidden_covariance.any()
        return known and not np.any(self.error_psd)

    def drift_covariance(self, geometry: ColumnGeometry) -> Array:
        """Covariance (C, 2, 2) of velocity and slip that the hidden directions are, means over the strip.

        Parameters
        ----------
        geometry : ColumnGeometry
        """
        count = len(geometry.column)
        if self.hidden is None or self.hidden_covariance is None:
            return np.zeros((count, 2, 2))
        since = self.motion.t - self.motion.t.mean()
        rates = np.einsum("n,nah->ah", since, self.hidden) / (since @ since)
        moves = geometry.line_period * geometry.levers @ rates  # (C, 2, H) px per line period
        slope = np.tan(geometry.slip)[:, None]
        # a turn about the optical axis turns the path of the scene
        turn = geometry.twist @ self.hidden.mean(axis=0)
        along = moves[:, 1] + geometry.velocity[:, None] * slope * turn
        lean = np.cos(geometry.slip[:, None]) ** 2 / geometry.velocity[:, None]
        across = lean * (moves[:, 0] - slope * moves[:, 1]) - turn
        by_direction = np.stack([along, across], axis=1)
        return np.asarray(by_direction @ self.hidden_covariance @ by_direction.transpose(0, 2, 1))

    def doubts(self, geometry: ColumnGeometry) -> tuple[str, ...]:
        """Warnings: what had to be left out, and a slip that nothing but belief bounds.

        Parameters
        ----------
        geometry : ColumnGeometry
        """
        sigma = float(np.sqrt(self.drift_covariance(geometry)[:, 1, 1].max()))
        if sigma < LOOSE_SLIP:
            return self.warnings
        return (
            *self.warnings,
            "neither images nor sensors tie the slip of the columns: its sigma of "
            f"{np.degrees(sigma):.2g} degrees is what is believed of a standing yaw "
            f"({np.degrees(CONSTANT_SIGMA[2]):.2g} degrees) before anything is measured; "
            "add an attitude sensor, or give the offsets of the bands with a smaller sigma",
        )

    def check_covers(self, begin: float, end: float) -> None:
        """SpanError unless the motion is known from `begin` to `end` (s)."""
        first, last = self.motion.span
        # images begin and end half a line before and after their first and last line
        slack = 2.0 * float(np.median(np.diff(self.motion.t))) if len(self.motion.t) > 1 else 0.0
        if first > begin + slack or last < end - slack:
            raise SpanError(
                f"the motion covers t = [{first:.6g}, {last:.6g}] s, the strip [{begin:.6g}, {end:.6g}] s; "
                "give the folder that `sightline recover` wrote for this acquisition"
            )

    def without_tdi(self, stages: int, ratio: float, line_period: float) -> tuple[MotionKnowledge, float]:
        """The motion before TDI averaged it, where it came from images of that many stages.

        Parameters
        ----------
        stages : int
            Of the images it was recovered from.
        ratio : float
            Their integration ratio.
        line_period : float
            s

        Returns
        -------
        knowledge : MotionKnowledge
            Densities of the error grown alike.
        highest : float
            Hz; up to where the motion was restored. Beyond, the error is the density found there, falling.

        Notes
        -----
        A line shows the mean place of all its stages: motion of nu cycles per line period is seen times
        ``W = sinc(Kt nu) D_N(nu)``. It is divided by W up to `LEAST_SEEN`, half way to its first zero.
        """
        if stages < 1 or not 0.0 < ratio <= 1.0:
            raise InputError(
                f"[motion] `stages` is {stages} and `integration_ratio` {ratio:g}; 1 stage or more, and a "
                "share of the line period above 0 up to 1, are allowed"
            )
        t, angles = _even(self.motion, line_period)
        seen = _low_pass(np.linspace(0.0, 0.5, 4096), stages, ratio)
        weak = np.flatnonzero(seen < LEAST_SEEN)
        edge = (weak[0] - 1 if len(weak) else 4095) / 4095 * 0.5
        restored = _restored(angles, stages, ratio, edge)
        highest = edge / line_period
        motion = Motion(t, restored)
        frequency, psd = self._grown(motion, stages, ratio, line_period, highest)
        hidden = None if self.hidden is None else prolonged(self.motion.t, self.hidden, t)
        return replace(self, motion=motion, hidden=hidden, frequency=frequency, error_psd=psd), highest

    def _grown(
        self, motion: Motion, stages: int, ratio: float, line_period: float, highest: float
    ) -> tuple[Array, Array]:
        """Frequencies and densities of the error after `without_tdi`."""
        nyquist = 0.5 / line_period
        f = self.frequency if len(self.frequency) else np.linspace(0.0, nyquist, 2048)
        given = self.error_psd if len(self.frequency) else np.zeros((len(f), 3))
        out = given / np.maximum(_low_pass(f * line_period, stages, ratio), LEAST_SEEN)[:, None] ** 2
        beyond = f > highest
        if beyond.any():
            level = _density_below(motion, highest)
            fall = (f[beyond] / highest) ** FALL
            out[beyond] = np.maximum(out[beyond], level * fall[:, None])
        return f, out


def error_and_jitter(frequency: Array, error_psd: Array, psd: Array) -> tuple[Array, Array]:
    """Density (F, 3) of the error, finite, and the sigma (3,) of what is faster than the table.

    Parameters
    ----------
    frequency : (F,)
        Hz
    error_psd, psd : (F, 3)
        rad^2/Hz, one-sided: of the error, infinite where nothing is known, and of the motion.
    """
    error = np.where(np.isfinite(error_psd), error_psd, psd)
    # falling as f^-4 from the last density on: a third of density times frequency
    return error, np.sqrt(error[-1] * frequency[-1] / 3.0)


def prolonged(t: Array, values: Array, at: Array) -> Array:
    """Values (N, ...) known at `t`, linear between and straight on beyond the ends, at the times `at`."""
    out = _interpolated(t, values, at)
    reach = min(len(t) - 1, max(1, len(t) // 20))
    for end, inner, outside in ((0, reach, at < t[0]), (-1, -1 - reach, at > t[-1])):
        slope = (values[end] - values[inner]) / (t[end] - t[inner])
        beyond = (at[outside] - t[end]).reshape(-1, *[1] * (values.ndim - 1))
        out[outside] = values[end] + beyond * slope
    return out


def _low_pass(nu: ArrayLike, stages: int, ratio: float) -> Array:
    """What TDI leaves of a motion of `nu` cycles per line period."""
    cycles = np.asarray(nu, dtype=np.float64)
    return np.asarray(np.sinc(ratio * cycles) * dirichlet(stages, cycles))


def _even(motion: Motion, step: float) -> tuple[Array, Array]:
    """Times and angles of the motion at every line period."""
    first, last = motion.span
    count = int(np.floor((last - first) / step + 1e-9)) + 1
    if count < 4:
        raise SpanError(f"the motion spans {last - first:.6g} s; at least four line periods are needed")
    t = np.minimum(first + step * np.arange(count), last)
    return t, motion.at(t)


def _restored(angles: Array, stages: int, ratio: float, edge: float) -> Array:
    """Angles with the low-pass of TDI divided out up to `edge` cycles per sample, left alone beyond."""
    count = len(angles)
    ends = np.linspace(angles[0], angles[-1], count)
    # odd about both ends once they are zero: no jump of value or slope where the transform closes the circle
    rest = angles - ends
    circle = np.concatenate([rest, -rest[-2:0:-1]])
    nu = np.fft.rfftfreq(len(circle))
    gain = np.where(nu <= edge, 1.0 / np.maximum(_low_pass(nu, stages, ratio), LEAST_SEEN), 1.0)
    turned = np.fft.irfft(np.fft.rfft(circle, axis=0) * gain[:, None], len(circle), axis=0)
    return np.asarray(ends + turned[:count])


def _density_below(motion: Motion, highest: float) -> Array:
    """(3,) mean density (rad^2/Hz) of a motion over the upper half of what is restored of it."""
    step = float(np.median(np.diff(motion.t)))
    x = motion.angles - np.linspace(motion.angles[0], motion.angles[-1], len(motion.t))
    window = np.hanning(len(x))
    psd = 2.0 * step * np.abs(np.fft.rfft(x * window[:, None], axis=0)) ** 2 / np.sum(window**2)
    f = np.fft.rfftfreq(len(x), step)
    near = (f >= 0.5 * highest) & (f <= highest)
    return np.asarray(psd[near].mean(axis=0)) if near.any() else np.zeros(3)


def _interpolated(t: Array, values: Array, at: Array) -> Array:
    """Values (N, ...) known at `t`, linear between, at the times `at`."""
    flat = values.reshape(len(t), -1)
    columns = [np.interp(at, t, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(at), *values.shape[1:])
