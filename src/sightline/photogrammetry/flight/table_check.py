"""Whether what is given goes together: rough poses against how frames moved, everything against poses found.

Not here: control points (``control_check.py``), heights of the ground (``found_ground.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from sightline.errors import EstimationError
from sightline.geometry.checks import Array
from sightline.geometry.surface import Ellipsoid, Plane
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.point_priors import HeightPrior, level_axes
from sightline.photogrammetry.flight.outlook import ground_motion, overlap_of
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem

#: How often the images may move faster or slower than the rough poses say, or against them, unsaid.
_MOST = 2.0
#: Lengths of a frame by which successive ones lie apart at most, by the tables.
MOST_APART = 3.0
#: Frames' worth of ground that a flight passes over at least before its motion says anything.
_FRAMES_FLOWN = 0.25
#: Times their sigma by which rows of tables may miss the poses found, rms, before it is worth a word.
_MISSED = 1.5
#: Share of good flights in which chance alone goes so far.
_CHANCE = 1e-4
#: Sigmas from which on what is given contradicts itself too far for an answer, as of an orientation; and the
#: factor of scale from which on such a contradiction is material.
WORST_FIT, _MATERIAL = 10.0, 1.1
#: Axes of a constant error, by its unit.
_BIAS_AXES = {"m": ("x", "y", "z"), "rad": ("roll", "pitch", "yaw")}
#: Of its sigma, below which a constant error is shown as 0.
_SHOWN = 1e-3
#: Times the scale of a path is found without rows that are far off.
_ROUNDS = 3
#: Rows that are named.
_NAMED = 3
#: What is wrong where images and tables do not go together.
_CHECK = (
    "check units and axes of the positions ([world]), [surface] height, [camera] focal_length_px, "
    "principal_point_px and mount, quaternions (scalar last), and whether the tables are of these frames"
)
#: Median of chi squared of three numbers.
_CHI_SQUARED_3 = 2.366


def motion_warnings(problem: SequenceProblem, followed: Followed) -> list[str]:
    """A warning where the images move otherwise than the rough poses say."""
    ratio = _motion_ratio(problem, followed)
    if ratio is None or 1.0 / _MOST < ratio < _MOST:
        return []
    how = f"{ratio:.2g} times as fast as" if ratio > 0.03 else "otherwise than"
    return [
        f"the ground moves through the frames {how} the rough poses say; check heights and units of the "
        "positions, times, [surface] height, [camera] focal_length_px and mount, and whether the tables "
        "are of these frames"
    ]


def _motion_ratio(problem: SequenceProblem, followed: Followed) -> float | None:
    """Motion followed over that expected, by least squares; None where either is too little."""
    expected = ground_motion(problem)[0]
    k = np.flatnonzero((followed.before >= 0) & np.isfinite(expected).all(axis=1))
    k = k[np.isfinite(followed.motion[k, :2]).all(axis=1)]
    seen = followed.motion[k, :2]
    given = expected[k] * (problem.t[k] - problem.t[followed.before[k]])[:, None]
    least = _FRAMES_FLOWN * min(problem.detector.shape)
    if not len(k) or max(np.linalg.norm(given.sum(axis=0)), np.linalg.norm(seen.sum(axis=0))) < least:
        return None
    return float((seen * given).sum() / (given**2).sum())


def refuse_apart(problem: SequenceProblem) -> None:
    """EstimationError where frames that follow one another lie frames apart by the tables: no poses go with
    such tables and with images that share anything."""
    overlap = overlap_of(problem)
    if overlap is not None and overlap.step > MOST_APART * overlap.covered:
        raise EstimationError(f"successive frames have no ground in common{_spacing(problem)}; {_CHECK}")


def unsolved_words(problem: SequenceProblem) -> str:
    """What to check where no poses go with both images and tables."""
    return (
        "the poses do not come together: what the frames show does not go with the rough "
        f"poses{_spacing(problem)}; {_CHECK}"
    )


def _spacing(problem: SequenceProblem) -> str:
    """In brackets, how far frames lie apart by the tables."""
    overlap = overlap_of(problem)
    if overlap is None:
        return ""
    return (
        f" (by the tables a frame covers {overlap.covered:.3g} m, successive frames are {overlap.step:.3g} m "
        f"apart and share {overlap.usual:.0%})"
    )


@dataclass(frozen=True, eq=False)
class TableFit:
    """Rows of a table beside the poses found.

    Attributes
    ----------
    name : str
        "positions" or "attitudes".
    rows : (n,) int
        Frames of which it says something.
    error : (n, 3)
        Table less pose, less the constant error found: m, or rad about body axes.
    square : (n,)
        Sum of the three over their sigmas, squared: chi-square of three numbers at most, as the poses follow
        the table.
    constant : float
        The same of the constant error, over its sigma; 0 where none is sought.
    constants : int
        Numbers in that, 0 or 3.
    """

    name: str
    rows: NDArray[np.intp]
    error: Array
    square: Array
    constant: float
    constants: int

    @property
    def chi_squared(self) -> float:
        """Of all rows and the constant error."""
        return float(self.square.sum()) + self.constant

    @property
    def numbers(self) -> int:
        """How many numbers are in `chi_squared`."""
        return 3 * len(self.rows) + self.constants


def table_fits(problem: SequenceProblem, poses: FramePoses) -> list[TableFit]:
    """Positions and attitudes that are given, beside the poses found."""
    known = problem.known
    moved = problem.images.position - poses.position - poses.bias[:3]
    turned = (poses.world_from_body.inv() * problem.images.world_from_body).as_rotvec() - poses.bias[3:]
    out = []
    for name, error, sigma, bias, loose in (
        ("positions", moved, known.along_world(), poses.bias[:3], known.position_bias),
        ("attitudes", turned, known.attitude, poses.bias[3:], known.attitude_bias),
    ):
        rows = np.flatnonzero(np.isfinite(sigma).all(axis=1) & np.isfinite(error).all(axis=1))
        if len(rows):
            square = ((error[rows] / sigma[rows]) ** 2).sum(axis=1)
            constant = float((bias / loose) @ (bias / loose)) if loose > 0.0 else 0.0
            out.append(TableFit(name, rows, error[rows], square, constant, 3 if loose > 0.0 else 0))
    return out


@dataclass(frozen=True)
class Misfit:
    """Something given beforehand that the poses found do not go with.

    Attributes
    ----------
    words : str
        What, by how much, and which keys give it.
    hopeless : bool
        So far beyond chance that the poses mean nothing.
    """

    words: str
    hopeless: bool


def refuse_contradicted(problem: SequenceProblem, poses: FramePoses, rig: Sequence[str] = ()) -> None:
    """EstimationError where what is given contradicts itself by far more than chance: no poses go with it.

    What is said of the offsets of a `rig` is among the likely causes.
    """
    found = misfits(problem, poses)
    if any(misfit.hopeless for misfit in found):
        raise EstimationError(
            "what is given contradicts itself, so that the poses found would be confident and wrong: "
            + "; ".join([*rig, *(misfit.words for misfit in found)])
        )


def misfits(problem: SequenceProblem, poses: FramePoses) -> list[Misfit]:
    """What is given beforehand and missed by the poses found: rows, constant errors, scale of the scene.

    Parameters
    ----------
    problem : SequenceProblem
    poses : FramePoses
        Of all its frames.

    Notes
    -----
    Residuals of what is given spread no more than it does itself, as the solution follows it: sigmas given
    beforehand and quantiles of chi squared are bounds.
    """
    return [*_scale_misfits(problem, poses), *_bias_misfits(problem, poses), *_row_misfits(problem, poses)]


def _bias_misfits(problem: SequenceProblem, poses: FramePoses) -> list[Misfit]:
    """Constant errors of the tables beyond their sigmas."""
    out = []
    for what, name, bias, sigma, unit, check in (
        (
            "positions", "position_bias_sigma", poses.bias[:3], problem.known.position_bias, "m",
            "[camera] focal_length_px, [surface] height and its sigma, and what heights of the positions are "
            "above",
        ),
        (
            "attitudes", "attitude_bias_sigma", poses.bias[3:], problem.known.attitude_bias, "rad",
            "[camera] mount and principal_point_px, and axes and signs of the attitudes",
        ),
    ):  # fmt: skip
        if not sigma > 0.0:
            continue
        ratio = float(np.linalg.norm(bias)) / sigma
        if ratio**2 <= chdtri(3, _CHANCE):
            continue
        turned = "" if unit == "m" else f" ({np.degrees(np.linalg.norm(bias)):.3g} degrees in all)"
        named = ", ".join(f"{axis} {value:+.3g}" for axis, value in zip(_BIAS_AXES[unit], bias, strict=True))
        out.append(
            Misfit(
                f"the constant error found of the {what} ({named} {unit}{turned}) is {ratio:.3g} times "
                f"{name} = {sigma:.3g} {unit}: check {check}, or give a larger {name}",
                ratio > WORST_FIT,
            )
        )
    return out


def _scale_misfits(problem: SequenceProblem, poses: FramePoses) -> list[Misfit]:
    """Whether the lens, the height of the ground, and the positions agree on how high the frames flew.

    Images give heights above the ground in lengths of the path, for the focal length given: how far apart the
    positions are makes them metres, and so do heights of positions above the surface.
    """
    known, images = problem.known, problem.images
    rows = np.flatnonzero(np.isfinite(known.position).all(axis=1))
    points = poses.points[np.isfinite(poses.points).all(axis=1)]
    if not problem.height_sigma > 0.0 or len(rows) < 2 or not len(points):
        return []
    surface = HeightPrior(problem.surface, problem.height_sigma, problem.radii)
    above = surface.above(points)[0]
    given = surface.above(np.asarray(images.position[rows]))[0]
    found = surface.above(np.asarray(poses.position[rows]))[0]
    if not all(np.isfinite(heights).any() for heights in (above, given, found)):
        return []
    sigma = known.along_world()[rows]
    up = level_axes(np.asarray(images.position[rows]), problem.radii)[0]
    level = np.sqrt((sigma**2 * up**2).sum(axis=1))
    scale, loose = _scale(images.position[rows], poses.position[rows], sigma)
    by_heights, seen = float(np.nanmedian(given)), float(np.nanmedian(found) - np.nanmedian(above))
    by_path = scale * seen
    spread = np.sqrt(
        problem.height_sigma**2 + known.position_bias**2 + 1.0 / (level**-2.0).sum() + (seen * loose) ** 2
    )
    sigmas = abs(by_heights - by_path) / float(spread)
    if not sigmas**2 > chdtri(1, _CHANCE) or not min(by_heights, by_path) > 0.0:
        return []
    factor = by_heights / by_path
    focal = poses.detector(problem.detector).focal_length_px
    higher = by_heights - by_path
    return [
        Misfit(
            "[camera] focal_length_px, [surface] height and the positions contradict one another by "
            f"{sigmas:.3g} sigmas: heights of the positions above [surface] are {by_heights:.4g} m, the "
            f"images with distances between positions say {by_path:.4g} m; it would go together with "
            f"focal_length_px = {focal * factor:.4g} ({factor:.3g} times {focal:.6g}), or [surface] height "
            f"{_height_words(problem, higher)}, or positions {abs(higher):.3g} m "
            f"{'lower' if higher > 0.0 else 'higher'}, or {factor:.3g} times as far apart",
            bool(sigmas > WORST_FIT and abs(np.log(factor)) > np.log(_MATERIAL)),
        )
    ]


def _height_words(problem: SequenceProblem, higher: float) -> str:
    """Ground that lies so much higher than the given one."""
    if isinstance(problem.surface, Plane | Ellipsoid):
        return f"= {problem.surface.height + higher:.4g} m (now {problem.surface.height:g})"
    return f"{abs(higher):.3g} m {'higher' if higher > 0.0 else 'lower'}"


def _scale(given: Array, found: Array, sigma: Array) -> tuple[float, float]:
    """Times as long as the path found is the given one, and its sigma; inf where rows give none.

    Rows (m, 3) far from what the others say do not count.
    """
    weight = (sigma**-2.0) * np.expand_dims(np.isfinite(found).all(axis=1), 1)
    for _ in range(_ROUNDS):
        total = weight.sum(axis=0)
        if not (total > 0.0).all():
            return 1.0, np.inf
        x = found - (weight * found).sum(axis=0) / total
        y = given - (weight * given).sum(axis=0) / total
        information = float((weight * x**2).sum())
        if not information > 0.0:
            return 1.0, np.inf
        scale = float((weight * x * y).sum()) / information
        square = ((y - scale * x) ** 2 / sigma**2).sum(axis=1)
        near = np.array(square < chdtri(3, _CHANCE) * max(1.0, _usual(square[weight[:, 0] > 0.0])))
        weight = weight * np.expand_dims(near, 1)
    return scale, information**-0.5


def _usual(square: Array) -> float:
    """Robust size of squares of errors (n,) of three numbers over their sigmas: 1 where these are true."""
    return float(np.median(square)) / _CHI_SQUARED_3


def _row_misfits(problem: SequenceProblem, poses: FramePoses) -> list[Misfit]:
    """Rows of the tables that miss the poses found by more than their sigmas allow."""
    out = []
    for fit in table_fits(problem, poses):
        what, given, square = fit.name, fit.rows, fit.square
        factor, unit = (1.0, "m") if what == "positions" else (float(np.degrees(1.0)), "degrees")
        size = factor * np.linalg.norm(fit.error, axis=1)
        ratio = float(np.sqrt(_usual(square)))
        if ratio > _MISSED and square.sum() > chdtri(3 * len(given), _CHANCE):
            out.append(
                Misfit(
                    f"{what} of the tables miss the poses found by {float(np.median(size)):.2g} {unit}, "
                    f"{ratio:.2g} times their sigma: are the sigmas too small, or rows of other frames?",
                    False,
                )
            )
        gross = np.flatnonzero(square > max(1.0, ratio**2) * chdtri(3, _CHANCE / len(given)))
        if len(gross):
            worst = int(gross[np.argmax(square[gross])])
            names = [str(problem.frames[k]) for k in given[gross[:_NAMED]]]
            more = f" and {len(gross) - _NAMED} more" if len(gross) > _NAMED else ""
            out.append(
                Misfit(
                    f"{what} of frames {', '.join(names)}{more} miss the poses found by up to "
                    f"{size[worst]:.3g} {unit}, {np.sqrt(square[worst]):.3g} of their sigmas, far more than "
                    "other rows: they pull the poses near them; take those rows out, or give larger sigmas",
                    False,
                )
            )
    return out
