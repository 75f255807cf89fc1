"""What stereo orientation would give before anything is flown or matched: bounds, and what would better them.

The Cramer-Rao bound at the planned poses: no unbiased estimate has a smaller covariance; ml-track reaches it.

Not here: how settings are made and varied (``photogrammetry/pair/settings.py``), the bound's algebra
(``photogrammetry/block/bundle.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sightline.errors import EstimationError, GeometryError, InputError, computes
from sightline.execution import one_blas_thread
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.geometry.units import ARCSEC
from sightline.photogrammetry.block.bundle import bound
from sightline.photogrammetry.block.observability import Observability
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.pair.settings import (
    Setting,
    StereoPlan,
    moved,
    setting_of_plan,
    setting_of_problem,
    with_control,
    with_heights,
    with_noise,
    with_points,
    with_shots,
    with_window,
)
from sightline.result import Result, makes_result

#: Estimators that have a bound: points tracked through all shots, and points new in every shot.
BOUNDED = ("ml-track", "ml-pair")
#: What quantities are multiplied by in the tables.
FACTORS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
#: Most shots and points that a table goes up to.
MOST_SHOTS, MOST_POINTS = 256, 1200
#: Sightings up to which tables are made and it is reckoned what would better the angles: tens of bounds, each
#: as long as a step of the solution.
MOST_TABLED = 200_000
#: In a radian.
#: What is offered to better a plan.
DEM_SIGMA, CONTROL_POINTS, CONTROL_SIGMA = 10.0, 5, 1.0


@dataclass(frozen=True, eq=False)
class SigmaTable(ReadOnlyArrays):
    """Bounds against one quantity, all else as planned.

    Attributes
    ----------
    quantity, unit : str
        Of `values`; no unit where they are counted.
    values : (V,)
        Increasing.
    planned : float
        The plan's own value; one of `values`.
    methods : tuple of str
    sigmas : (methods, V, 3C)
        rad; roll, pitch, yaw of each camera; inf where not observable.
    weakest : (methods, V)
        rad, along the direction least known.
    how : str
        How the quantity was varied, in words.
    """

    quantity: str
    unit: str
    values: Array
    planned: float
    methods: tuple[str, ...]
    sigmas: Array
    weakest: Array
    how: str


@dataclass(frozen=True, eq=False)
class Improvement(ReadOnlyArrays):
    """A change, and the bounds it would give.

    Attributes
    ----------
    change : str
        In words.
    sigmas : (3C,)
        rad; roll, pitch, yaw of each camera; inf where not observable.
    ratio : (3C,)
        Of these to the bounds without the change; 0 where only the change makes an angle observable, NaN
        where it stays unobservable.
    """

    change: str
    sigmas: Array
    ratio: Array


@dataclass(frozen=True, eq=False, repr=False)
class StereoPrediction(Result, ReadOnlyArrays):
    """Bounds of a plan or of a problem as planned.

    Attributes
    ----------
    method : str
        Whose bound it is.
    cameras : tuple of str
    covariance : (3C, 3C)
        rad^2; roll, pitch, yaw of each camera; inf and NaN where not observable.
    observability : Observability
        Principal directions of these angles.
    points, shots, sightings : int
        How many the bound is for.
    baseline : float
        m, mean distance of the first and the last camera of a shot.
    window : float
        s
    how : str
        Where the points come from, in words.
    tables : tuple of SigmaTable
    improvements : tuple of Improvement
        The one that betters the worst angle most comes first.
    """

    method: str
    cameras: tuple[str, ...]
    covariance: Array
    observability: Observability
    points: int
    shots: int
    sightings: int
    baseline: float
    window: float
    how: str
    tables: tuple[SigmaTable, ...]
    improvements: tuple[Improvement, ...]

    @property
    def sigmas(self) -> Array:
        """(C, 3) rad; inf where not observable."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class _Sweep:
    """A quantity, its planned value, and the setting of any other value."""

    quantity: str
    unit: str
    planned: float
    values: list[float]
    of: Callable[[float], Setting]
    how: str


@makes_result
@one_blas_thread
@computes("the bound")
def predict(problem: StereoProblem, method: str = "ml-track", *, tables: bool = True) -> StereoPrediction:
    """Bounds of a problem at its planned poses, with tables and what would better them.

    Parameters
    ----------
    problem : StereoProblem
        Its measured pixels only show where the points are; without matches points are laid out.
    method : str
        ``ml-track`` or ``ml-pair``.
    tables : bool
        Whether tables against each quantity are wanted; they take tens of bounds.

    Returns
    -------
    StereoPrediction
    """
    setting = setting_of_problem(problem)
    sweeps = _of_setting(setting) if tables else []
    return _predicted(problem.cameras, setting, method, sweeps, _changes(setting))


@makes_result
@one_blas_thread
@computes("the bound")
def predict_plan(plan: StereoPlan, method: str = "ml-track", *, tables: bool = True) -> StereoPrediction:
    """Bounds of a pass not yet flown, with tables and what would better them.

    Parameters
    ----------
    plan : StereoPlan
    method, tables
        As of `predict`.

    Returns
    -------
    StereoPrediction
    """
    setting = setting_of_plan(plan)
    sweeps = _of_plan(plan) if tables else []
    return _predicted(plan.cameras, setting, method, sweeps, _plan_changes(plan, setting))


@one_blas_thread
def improvements(problem: StereoProblem, method: str = "ml-track") -> tuple[Improvement, ...]:
    """What would better the angles of a problem, most useful first.

    Parameters
    ----------
    problem : StereoProblem
    method : str
        ``ml-track`` or ``ml-pair``; any other is judged like the latter.
    """
    setting = setting_of_problem(problem)
    pairs = method != "ml-track"
    return _improved(_sigmas(_bound(setting, pairs)), _changes(setting), pairs)


def _bound(setting: Setting, pairs: bool) -> Observability:
    """Principal directions of the angles of a setting."""
    angles, _ = bound(
        setting.sightings(), setting.noise, setting.places, priors=setting.priors, new_points_per_shot=pairs
    )
    return angles


def _sigmas(known: Observability) -> Array:
    """(3C,) rad; inf where not observable."""
    return np.asarray(np.sqrt(np.diag(known.covariance())))


def _predicted(
    cameras: tuple[str, ...],
    setting: Setting,
    method: str,
    sweeps: list[_Sweep],
    changes: Iterator[tuple[str, Callable[[], Setting]]],
) -> StereoPrediction:
    """The prediction of a setting."""
    if method not in BOUNDED:
        raise InputError(f"bounds are those of {' and '.join(BOUNDED)}, got method {method!r}")
    pairs = method == "ml-pair"
    known = _bound(setting, pairs)
    better = _improved(_sigmas(known), changes, pairs) if len(setting.image) <= MOST_TABLED else ()
    return StereoPrediction(
        method, cameras, frozen(known.covariance()), known, len(setting.places), setting.shots,
        len(setting.image), setting.baseline, setting.window, setting.how,
        tuple(_table(sweep) for sweep in sweeps), better,
    )  # fmt: skip


def _table(sweep: _Sweep) -> SigmaTable:
    """Bounds of both estimators at each value that can be had."""
    values, sigmas, weakest = [], [], []
    for value in sweep.values:
        try:
            setting = sweep.of(value)
            found = [_bound(setting, pairs) for pairs in (False, True)]
        except (EstimationError, GeometryError):
            # the horizon ends a pass, few points tie nothing: the table ends there
            continue
        values.append(value)
        sigmas.append([_sigmas(known) for known in found])
        weakest.append([known.sigmas.max() for known in found])
    return SigmaTable(
        sweep.quantity, sweep.unit, frozen(np.array(values)), sweep.planned, BOUNDED,
        frozen(np.moveaxis(np.array(sigmas), 0, 1)), frozen(np.array(weakest).T), sweep.how,
    )  # fmt: skip


def _improved(
    now: Array, changes: Iterator[tuple[str, Callable[[], Setting]]], pairs: bool
) -> tuple[Improvement, ...]:
    """Bounds after each change that can be had, the most useful first."""
    out = []
    for words, make in changes:
        try:
            sigmas = _sigmas(_bound(make(), pairs))
        except (EstimationError, GeometryError):
            continue
        ratio = np.where(np.isfinite(now), sigmas / np.where(np.isfinite(now), now, 1.0), 0.0)
        ratio = np.where(np.isfinite(now) | np.isfinite(sigmas), ratio, np.nan)
        out.append(Improvement(words, frozen(sigmas), frozen(ratio)))
    return tuple(sorted(out, key=lambda found: float(np.max(found.sigmas))))


def _factors(planned: float, factors: tuple[float, ...] = FACTORS) -> list[float]:
    return [planned * factor for factor in factors]


def _counts(planned: int, most: int) -> list[float]:
    """Whole numbers about `planned`, as many as `most` unless more are planned."""
    counts = {int(round(planned * factor)) for factor in FACTORS}
    return [float(n) for n in sorted(counts) if 1 <= n <= max(most, planned)]


def _noise_sweeps(setting: Setting) -> Iterator[_Sweep]:
    """Sweeps of the three noises that are not nought."""
    factors = (0.25, 0.5, 1.0, 2.0, 4.0)
    px, noise = float(np.median(setting.sigma_px)), setting.noise
    yield _Sweep(
        "image noise", "px", px, _factors(px, factors), lambda v: with_noise(setting, image=v / px),
        "all sightings alike",
    )  # fmt: skip
    if noise.position > 0.0:
        yield _Sweep(
            "position noise", "m", noise.position, _factors(noise.position, factors),
            lambda v: with_noise(setting, position=v / noise.position), "per axis and shot",
        )  # fmt: skip
    if noise.attitude > 0.0:
        yield _Sweep(
            "attitude noise", "rad", noise.attitude, _factors(noise.attitude, factors),
            lambda v: with_noise(setting, attitude=v / noise.attitude), "per axis and shot",
        )  # fmt: skip


def _of_setting(setting: Setting) -> list[_Sweep]:
    """Sweeps of a problem, by moving its images."""
    base, window, shots, points = setting.baseline, setting.window, setting.shots, len(setting.places)
    out = []
    if base > 0.0:
        out.append(
            _Sweep(
                "baseline", "m", base, _factors(base, (0.125, 0.25, 0.5, 1.0, 1.5)),
                lambda v: moved(setting, setting.images.t, v / base),
                "cameras of a shot moved along their baseline, looking at the same ground",
            )
        )  # fmt: skip
    if window > 0.0:
        out.append(
            _Sweep(
                "window", "s", window, _factors(window, (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0)),
                lambda v: with_window(setting, v / window),
                "as many shots, on the cameras' own paths, about the same middle",
            )
        )  # fmt: skip
        out.append(
            _Sweep(
                "shots", "", shots, _counts(shots, MOST_SHOTS), lambda v: with_shots(setting, int(v)),
                "spread evenly over the same window",
            )
        )  # fmt: skip
    out.append(
        _Sweep(
            "points", "", points, _counts(points, MOST_POINTS), lambda v: with_points(setting, int(v)),
            "some of them, drawn with equal chances, or each of them several times",
        )
    )  # fmt: skip
    return [*out, *_noise_sweeps(setting)]


def _of_plan(plan: StereoPlan) -> list[_Sweep]:
    """Sweeps of a plan, by making it anew."""
    pair = plan.pair

    def of(**changed: object) -> Setting:
        return setting_of_plan(replace(plan, **changed))  # type: ignore[arg-type]

    scene = plan.scene_size
    out = []
    if pair.separation > 0.0:
        out.append(
            _Sweep(
                "separation", "s", pair.separation,
                _factors(pair.separation, (0.125, 0.25, 0.5, 1.0, 1.5, 2.0)),
                lambda v: of(pair=replace(pair, separation=v)), "in time, on the same orbits",
            )
        )  # fmt: skip
    return [
        *out,
        _Sweep(
            "window", "s", plan.window, _factors(plan.window, (0.03125, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0)),
            lambda v: of(window=v), "as many shots, spread evenly, about the same middle",
        ),
        _Sweep(
            "shots", "", plan.shots, _counts(plan.shots, MOST_SHOTS), lambda v: of(shots=int(v)),
            "spread evenly over the same window",
        ),
        _Sweep(
            "points", "", plan.points, _counts(plan.points, MOST_POINTS),
            lambda v: of(points=int(v), scene_size=scene), "laid out evenly over the same square",
        ),
        *_noise_sweeps(setting_of_plan(plan)),
    ]  # fmt: skip


def _changes(setting: Setting) -> Iterator[tuple[str, Callable[[], Setting]]]:
    """What a problem could do better, and the settings of it."""
    if setting.window > 0.0:
        yield "twice the window, as many shots", lambda: with_window(setting, 2.0)
        yield "twice as many shots in the same window", lambda: with_shots(setting, 2 * setting.shots)
    if setting.baseline > 0.0:
        longer = 1.5 * setting.baseline / 1e3
        yield (
            f"a baseline half as long again ({longer:.3g} km)",
            lambda: moved(setting, setting.images.t, 1.5),
        )
    yield from _other_changes(setting)


def _plan_changes(plan: StereoPlan, setting: Setting) -> Iterator[tuple[str, Callable[[], Setting]]]:
    """What a plan could do better, and the settings of it."""
    yield (
        f"twice the window ({2.0 * plan.window:.4g} s), as many shots",
        lambda: setting_of_plan(replace(plan, window=2.0 * plan.window)),
    )
    yield (
        f"twice as many shots ({2 * plan.shots}) in the same window",
        lambda: setting_of_plan(replace(plan, shots=2 * plan.shots)),
    )
    longer = 1.5 * plan.pair.separation
    if longer > 0.0:
        yield (
            f"a separation half as long again ({longer:.4g} s)",
            lambda: setting_of_plan(replace(plan, pair=replace(plan.pair, separation=longer))),
        )
    yield from _other_changes(setting)


def _other_changes(setting: Setting) -> Iterator[tuple[str, Callable[[], Setting]]]:
    """What can be changed without another flight."""
    if setting.heights is None or setting.heights.sigma > DEM_SIGMA:
        yield f"an elevation model of {DEM_SIGMA:g} m", lambda: with_heights(setting, DEM_SIGMA)
    more = "more " if setting.control is not None else ""
    yield (
        f"{CONTROL_POINTS} {more}control points of {CONTROL_SIGMA:g} m",
        lambda: with_control(setting, CONTROL_POINTS, CONTROL_SIGMA),
    )
    half = float(np.median(setting.sigma_px)) / 2.0
    yield f"half the image noise ({half:.3g} px)", lambda: with_noise(setting, image=0.5)
    if setting.noise.position > 0.0:
        yield (
            f"half the position noise ({setting.noise.position / 2.0:.3g} m)",
            lambda: with_noise(setting, position=0.5),
        )
    if setting.noise.attitude > 0.0:
        half = 0.5 * setting.noise.attitude / ARCSEC
        yield (
            f"half the attitude noise from shot to shot ({half:.3g} arcsec)",
            lambda: with_noise(setting, attitude=0.5),
        )
