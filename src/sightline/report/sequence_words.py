"""A solved sequence in plain words, and its tables.

Not here: the page (``sequence_page.py``); nothing is computed but medians, shares and units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from sightline.applications.sequence_poses import SequencePoses
from sightline.photogrammetry.block.point_priors import level_axes
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.flight.rig import OFFSETS
from sightline.photogrammetry.flight.table_check import table_fits
from sightline.photogrammetry.flight.warnings import BENT_PX, bent_px, focal_verdict
from sightline.report.sequence_view import PARAMETERS, UNITS, SequenceView
from sightline.report.stereo_words import several, with_sigma
from sightline.report.words import digits

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: rad; a trend of the angles known no better is said not to be observable: it bends the ground of a strip
#: by more than a hundredth of the flying height at its ends.
LOOSE_BOW = np.radians(1.0)
#: Share of the sigma that was known beforehand from which on it counts as not observable.
UNOBSERVABLE = 0.9
#: Rows of a table at most, and rows from which on it is folded up.
MOST_ROWS, FOLDED = 1000, 12

#: What a constant error is called, by its sigma over that known beforehand.
BIAS_VERDICTS = (
    (UNOBSERVABLE, "not observable: known no better than beforehand"),
    (0.5, "hardly observable"),
    (0.0, "observable"),
)
#: Of `table_rows`.
TABLE_HEADS = ["table", "frames", "chi-square", "99 % lie under", "farthest frame"]
BIAS_HEADS = ["constant error of the tables", "found", "1 sigma", "1 sigma beforehand", "verdict"]
BOW_HEADS = [
    "stretch", "frames", "length (m)", "duration (s)", "roll (deg)", "pitch (deg)", "yaw (deg)", "verdict",
]  # fmt: skip
SUBSET_HEADS = ["frame", "t (s)", "overlap (%)", "parallax (deg)", "why it was taken"]
IDLE_HEADS = ["frames", "how many", "t (s)", "why", "1 sigma on the ground (px)"]
STAGE_HEADS = ["stage", "CPU time (s)", "share (%)", "ms per frame"]
#: One more where stages of an earlier start were taken over.
TAKEN_OVER = "taken over"


def sentences(problem: SequenceProblem, found: SequencePoses, view: SequenceView) -> list[str]:
    """What was found, in words."""
    said = [
        _what(found, view),
        _how_well(view),
        _fit(found, view),
        _biases(problem, found),
        _focal(problem, found),
        _bow(problem, found, view),
        _ties(found),
        _unseen(problem, view),
    ]
    return [sentence for sentence in said if sentence]


def _what(found: SequencePoses, view: SequenceView) -> str:
    """Frames, how they came about, path."""
    count = [int((view.kind == kind).sum()) for kind in range(3)]
    pauses = len(view.of_stretches())
    size = float(view.along[-1])
    length = f"{digits(size / 1e3, 3)} km" if size >= 1e4 else f"{digits(size, 3)} m"
    text = (
        f"{several(len(view.t), 'frame')} over {digits(float(np.ptp(view.t)), 3)} s and {length} of path in "
        f"{'one stretch' if pauses == 1 else f'{pauses} stretches'} of the flight (frames "
        f"between pauses): {count[0]:,} solved (the subset), {count[1]:,} estimated from what they share "
        "with others, "
        + (
            "none interpolated."
            if not count[2]
            else "1 interpolated because its image shows too little."
            if count[2] == 1
            else f"{count[2]:,} interpolated because their images show too little."
        )
    )
    return text + " Every frame has a pose and a covariance." * bool(_all_known(view))


def _all_known(view: SequenceView) -> bool:
    return bool(np.isfinite(view.covariance).all())


def _how_well(view: SequenceView) -> str:
    """Typical sigmas."""
    ground = view.typical(view.ground_sigma_px[:, 0])
    sigma = [view.typical(view.sigma[:, k]) for k in range(6)]
    parts = [
        f"{name} {digits(s, 2)} {unit}" if np.isfinite(s) else f"{name} not known"
        for name, unit, s in zip(PARAMETERS, UNITS, sigma, strict=True)
    ]
    text = f"Known to (1 sigma, median over the frames): {'; '.join(parts)}."
    if np.isfinite(ground):
        text += (
            f" The middle of a frame meets the ground within {digits(ground, 2)} px "
            f"({digits(ground * view.typical(view.gsd), 2)} m) of where it is said to, errors of place and "
            "of tilt that make up for each other left out."
        )
    return text + (
        " These are sigmas of absolute poses: what all frames have wrong together (the datum) is in them."
        + _steps(view)
    )


def _steps(view: SequenceView) -> str:
    """How well a frame is known against the one before it."""
    moved, turned = (view.typical(view.step_sigma[:, k]) for k in range(2))
    if not np.isfinite([moved, turned]).all():
        return ""
    return (
        f" Against the frame before it each is known to {digits(moved, 2)} m and {digits(turned, 2)} deg (1 "
        "sigma per axis, median; covariance.npz)."
    )


def _fit(found: SequencePoses, view: SequenceView) -> str:
    """Residuals, and what was rejected."""
    rejected = np.asarray(found.poses.rejected)
    if rejected.all():
        return ""
    good = ~rejected
    rms = float(np.sqrt(0.5 * (found.poses.residual_px[good] ** 2).sum(axis=1).mean()))
    own = float(np.sqrt((found.followed.sigma_px**2).mean()))
    whole = float(np.sqrt((found.tracks.sigma_px[good] ** 2).mean()))
    points = int(np.isfinite(found.poses.points).all(axis=1).sum())
    gross = (
        f"{int(rejected.sum()):,} ({digits(100.0 * float(rejected.mean()), 2)} %)"
        if rejected.any()
        else "none"
    )
    text = (
        f"{several(int(good.sum()), 'sighting')} of {several(points, 'point')} are left with "
        f"{digits(rms, 2)} px rms per coordinate; the matcher states a noise of {digits(own, 2)} px. "
        f"{_capital(gross)} of the sightings were rejected as gross errors."
    )
    if whole > 1.2 * own:
        text += (
            f" Windows drift slowly while they are followed: the sigmas hold {digits(whole, 2)} px for "
            "that, which residuals do not show because the places of the points follow it."
        )
    return text


def table_rows(problem: SequenceProblem, found: SequencePoses) -> list[list[str]]:
    """Per table: name, frames, chi-square, what chance makes of it, the frame that it misses most."""
    rows = []
    # as solved: with angles of turned frames turned
    for fit in table_fits(found.problem or problem, found.poses):
        worst = int(np.argmax(fit.square))
        rows.append(
            [
                fit.name,
                f"{len(fit.rows)}",
                f"{fit.chi_squared:.3g} of {fit.numbers} numbers",
                f"{chdtri(fit.numbers, 0.01):.3g}",
                f"{problem.frames[int(fit.rows[worst])]}: {fit.square[worst]:.3g} of 3 numbers",
            ]
        )
    return rows


def bias_table(problem: SequenceProblem, found: SequencePoses) -> list[list[str]]:
    """Per constant error sought: name, value, sigma, sigma beforehand, verdict."""
    rows = []
    level = np.eye(6)
    if problem.radii is not None:
        # axes of computation are those of the Earth: here east, north, up in the middle of the flight
        middle = found.poses.position.mean(axis=0, keepdims=True)
        up, east, north = level_axes(middle, problem.radii)
        level[:3, :3] = np.concatenate([east, north, up])
    bias = level @ found.poses.bias
    sigmas = np.sqrt(np.diag(level @ found.poses.bias_covariance @ level.T))
    axes = ("east", "north", "up")
    names = [f"position {axis}" for axis in axes] + [f"angle {axis}" for axis in PARAMETERS[3:]]
    for k, name in enumerate(names):
        before = problem.known.position_bias if k < 3 else problem.known.attitude_bias
        if not before > 0.0:
            continue
        factor, unit = (1.0, "m") if k < 3 else (float(np.degrees(1.0)), "deg")
        value, sigma = factor * bias[k], factor * sigmas[k]
        share = sigma / (factor * before)
        verdict = next(words for least, words in BIAS_VERDICTS if share >= least)
        rows.append(
            [
                name,
                f"{with_sigma(value, sigma)} {unit}" if share < UNOBSERVABLE else "–",
                f"{digits(sigma, 2)} {unit}",
                f"{digits(factor * before, 2)} {unit}",
                verdict,
            ]
        )
    return rows


def _biases(problem: SequenceProblem, found: SequencePoses) -> str:
    """Constant errors of the tables."""
    rows = bias_table(problem, found)
    if not rows:
        return ""
    found_well = [f"{name} {value}" for name, value, _, _, verdict in rows if verdict == "observable"]
    hardly = [f"{name} {value}" for name, value, _, _, verdict in rows if verdict == "hardly observable"]
    other = [name for name, value, _, _, _ in rows if value == "–"]
    parts = []
    if found_well:
        parts.append(f"Constant errors found of the tables (table less truth): {'; '.join(found_well)}.")
    if hardly:
        parts.append(f"Hardly observable: {'; '.join(hardly)}.")
    if other:
        parts.append(
            f"The data do not show the constant error of {_listed(other)} better than was known before: "
            "control points would."
        )
    return " ".join(parts)


RIG_HEADS = (
    "camera", "roll (degrees)", "pitch", "yaw", "x (mm)", "y", "z", "focal length (px)", "residual (px)",
    "held at what was given",
)  # fmt: skip


def rig_rows(problem: SequenceProblem, found: SequencePoses) -> list[list[str]]:
    """A row per camera of a rig: offsets with sigmas, residual, what the images do not know."""
    assert found.rig is not None
    o, out = found.rig.offsets, []
    values = np.column_stack([np.degrees(o.orientation.as_rotvec()), 1e3 * o.position])
    sigmas = np.column_stack([np.degrees(o.sigma[:, :3]), 1e3 * o.sigma[:, 3:6]])
    for c, camera in enumerate(problem.rig):
        digit = [4, 4, 4, 1, 1, 1]
        cells = [
            f"{v:.{d}f} ± {s:.{d}f}" if c else "0"
            for v, s, d in zip(values[c], sigmas[c], digit, strict=True)
        ]
        held = [
            name
            for name, seen, prior in zip(OFFSETS[:6], o.observed[c], o.prior_sigma[c], strict=False)
            if c and not seen and prior > 0.0
        ]
        px = o.detector(c, camera.detector).focal_length_px
        out.append([camera.name, *cells, f"{px:.6g}", f"{o.residual_px[c]:.3g}", ", ".join(held)])
    return out


def focal_row(problem: SequenceProblem, found: SequencePoses) -> list[list[str]]:
    """As of `bias_table`: the focal length where it was sought, one row or none."""
    focal = found.poses.focal
    if focal is None:
        return []
    px = found.poses.detector(problem.detector).focal_length_px
    sigma, before = (problem.detector.focal_length_px * size for size in (focal.sigma, focal.prior))
    verdict = focal_verdict(focal)
    prior = f"{digits(before, 2)} px" if np.isfinite(before) else "not known"
    return [
        [
            "focal length",
            f"{with_sigma(px, sigma).lstrip(chr(43))} px",
            f"{digits(sigma, 2)} px",
            prior,
            verdict,
        ]
    ]


def readout_row(problem: SequenceProblem, found: SequencePoses) -> list[list[str]]:
    """As of `bias_table`: the readout time where it was sought, one row or none."""
    readout = found.poses.readout
    if readout is None:
        return []
    found_ms, sigma, before = (1e3 * s for s in (readout.seconds, readout.sigma, readout.prior))
    verdict = next(words for least, words in BIAS_VERDICTS if sigma / before >= least)
    return [
        [
            f"readout time (given: {1e3 * problem.readout_time:g} ms)",
            f"{with_sigma(found_ms, sigma).lstrip(chr(43))} ms",
            f"{digits(sigma, 2)} ms",
            f"{digits(before, 2)} ms",
            verdict,
        ]
    ]


def _focal(problem: SequenceProblem, found: SequencePoses) -> str:
    """The focal length, where it was sought."""
    rows = focal_row(problem, found)
    if not rows:
        return ""
    _, value, _, before, verdict = rows[0]
    given = f"{problem.detector.focal_length_px:.6g} px"
    beforehand = f"given was {given}" + (f", known to {before}" if before != "not known" else "")
    return (
        f"The focal length was found with the poses: {value} ({verdict}); {beforehand}. What is not known of "
        "it is in the sigmas of all poses."
    )


def bow_rows(problem: SequenceProblem, found: SequencePoses, view: SequenceView) -> list[list[str]]:
    """Per stretch: frames, length, duration, sigma of the trend of each angle, verdict."""
    rows, detector = [], found.poses.detector(problem.detector)
    for number, frames in enumerate(view.of_stretches()):
        bow = found.poses.bow[number]
        rows.append(
            [
                str(number + 1),
                f"{len(frames):,}",
                digits(float(np.ptp(view.along[frames])), 4),
                digits(float(np.ptp(view.t[frames])), 4),
                *(digits(float(np.degrees(b)), 2) for b in bow),
                bow_verdict(problem, bow, frames, bent_px(detector, bow)),
            ]
        )
    return rows


def bow_verdict(problem: SequenceProblem, bow: Array, frames: Index, px: Array) -> str:
    """Whether images or tables show how a stretch is bent; `px` as of `bent_px`."""
    if len(frames) < 2:
        return "a single frame has none"
    loose = [axis for axis, b in zip(PARAMETERS[3:], bow, strict=True) if not b < LOOSE_BOW]
    if loose:
        return f"not observable about {_listed(loose)}"
    known = (
        "observable" if px.max() < BENT_PX else f"known to {digits(float(px.max()), 2)} px at the ends only"
    )
    with np.errstate(divide="ignore"):
        by_table = (problem.known.attitude[frames] ** -2.0).sum(axis=0) ** -0.5
    alone = [axis for axis, b, s in zip(PARAMETERS[3:], bow, by_table, strict=True) if b > UNOBSERVABLE * s]
    if alone:
        return f"{known}; held by the given attitudes alone about {_listed(alone)}"
    return known


def _bow(problem: SequenceProblem, found: SequencePoses, view: SequenceView) -> str:
    """How each stretch may be bent."""
    groups = [(n, rows) for n, rows in enumerate(view.of_stretches()) if len(rows) > 1]
    if not groups:
        return ""
    bows = np.array([found.poses.bow[n] for n, _ in groups])
    px = bent_px(found.poses.detector(problem.detector), bows)
    verdicts = {
        n + 1: bow_verdict(problem, bow, rows, moved)
        for (n, rows), bow, moved in zip(groups, bows, px, strict=True)
    }
    hidden = [
        f"{verdict.partition(' about ')[2]} in stretch {n}"
        for n, verdict in verdicts.items()
        if "not observable" in verdict
    ]
    shown = hidden if len(hidden) <= FOLDED else [*hidden[:FOLDED], "others"]
    worst = np.degrees(np.where(bows < LOOSE_BOW, bows, 0.0).max(axis=0))
    parts = [
        f"{axis} {digits(float(b), 2)} deg" for axis, b in zip(PARAMETERS[3:], worst, strict=True) if b > 0.0
    ]
    said = []
    if hidden:
        said.append(
            f"The bow is not observable about {_listed(shown)}: nothing shows how these angles err from the "
            "first frame to the last."
        )
    if parts:
        whose = "" if len(groups) == 1 else " of the worst stretch"
        ends = float(np.where(bows < LOOSE_BOW, px, 0.0).max())
        which = (
            "What is observable of the bow"
            if hidden
            else "The bow is observable"
            if ends < BENT_PX
            else "The bow is observable, but not to a pixel, so that the flight may be bent"
        )
        said.append(
            f"{which}: 1 sigma of an even trend of the angles' errors from the first frame to the "
            f"last{whose}, rms along it, is {'; '.join(parts)}, which moves the ground at its ends by up to "
            f"{digits(ends, 2)} px."
        )
    return " ".join(said)


def _ties(found: SequencePoses) -> str:
    """What stretches whose frames look alike share with each other."""
    numbers = np.unique(found.stretch[found.stretch >= 0])
    if len(numbers) < 2:
        return ""
    kept = ~np.asarray(found.poses.rejected) & (found.stretch[found.tracks.image] >= 0)
    point, number = found.tracks.point[kept], found.stretch[found.tracks.image[kept]]
    seen = np.unique(np.stack([point, number], axis=1), axis=0)
    shared = np.flatnonzero(np.bincount(seen[:, 0]) > 1)
    tied = np.unique(seen[np.isin(seen[:, 0], shared), 1])
    text = f"Frames link to each other in {len(numbers)} chains"
    if not len(shared):
        return f"{text}; no point is seen from two of them, so that only the tables hold them to each other."
    loose = len(numbers) - len(tied)
    said = f"{text}; {several(len(shared), 'point')} seen from two or more of them tie them together"
    return f"{said}, but {loose} only by the tables." if loose else f"{said}."


def _unseen(problem: SequenceProblem, view: SequenceView) -> str:
    """What the data could not show."""
    out = []
    if not np.isfinite(problem.known.attitude).any():
        out.append("no table gives attitudes")
    if not np.isfinite(problem.known.position).any():
        out.append("no table gives positions")
    names = [name for k, name in enumerate(PARAMETERS) if not np.isfinite(view.sigma[:, k]).all()]
    if names:
        out.append(f"nothing ties {_listed(names)}, whose sigmas are infinite where that is so")
    if problem.height_sigma == 0.0 and problem.control is None:
        out.append("no height of the ground was given with a sigma, nor any control point")
    return f"What could not be seen: {'; '.join(out)}." if out else ""


def subset_rows(problem: SequenceProblem, found: SequencePoses) -> list[list[str]]:
    """Per frame of the subset: name, time, overlap, parallax, why."""
    subset = found.subset
    rows = [
        [
            problem.frames[frame],
            f"{problem.t[frame]:.6g}",
            _number(100.0 * subset.overlap[k], ".0f"),
            _number(float(np.degrees(subset.parallax[k])), ".1f"),
            subset.reason[k],
        ]
        for k, frame in enumerate(subset.frames[:MOST_ROWS])
    ]
    return rows


def idle_rows(problem: SequenceProblem, found: SequencePoses, view: SequenceView) -> list[list[str]]:
    """Interpolated frames, those in a row with one reason together: names, number, times, why, sigma."""
    rows = []
    for first, last in _alike(found.reason, np.flatnonzero(view.kind == 2)):
        frames = np.arange(first, last + 1)
        name = problem.frames[first]
        t = f"{view.t[first]:.5g}"
        if last > first:
            name, t = f"{name} to {problem.frames[last]}", f"{t} to {view.t[last]:.5g}"
        ground = view.ground_sigma_px[frames, 0]
        worst = digits(float(ground.max()), 2) if np.isfinite(ground).all() else "not known"
        rows.append([name, f"{len(frames):,}", t, found.reason[first], worst])
    return rows[:MOST_ROWS]


def _alike(reasons: Sequence[str], frames: Index) -> list[tuple[int, int]]:
    """First and last of frames in a row with the same reason."""
    out: list[tuple[int, int]] = []
    for frame in map(int, frames):
        if out and out[-1][1] == frame - 1 and reasons[frame - 1] == reasons[frame]:
            out[-1] = (out[-1][0], frame)
        else:
            out.append((frame, frame))
    return out


def stage_rows(found: SequencePoses, cube: Mapping[str, float] | None = None) -> list[list[str]]:
    """Per stage: CPU seconds, share, ms per frame, what was taken over if anything was; the sum last.

    Parameters
    ----------
    found : SequencePoses
    cube : mapping, optional
        CPU seconds of the stages of the maps.
    """
    if not found.seconds:
        return []
    every = dict(found.seconds) | {f"maps: {name}": s for name, s in (cube or {}).items()}
    whole, count = sum(every.values()), len(found.source)
    rows = []
    for name, seconds in (*every.items(), ("all", whole)):
        share = 100.0 * seconds / max(whole, 1e-9)
        row = [name, f"{seconds:.2f}", f"{share:.0f}", f"{1e3 * seconds / count:.1f}"]
        if found.taken_over:
            row.append(_taken_over(seconds, found.taken_over.get(name, 0.0)))
        rows.append(row)
    return rows


def _taken_over(seconds: float, of_earlier: float) -> str:
    """Whether a stage was taken over from a start that was stopped."""
    if not of_earlier > 0.0:
        return ""
    # what reading the result takes counts as the stage's too
    return "of an earlier start" if of_earlier > 0.95 * seconds else f"{of_earlier:.2f} s of an earlier start"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "–"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
