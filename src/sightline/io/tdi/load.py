"""A TDI.toml as a TdiProblem, and in words.

Not here: keys and allowed values (``schema.py``), the results (``io/results/tdi.py``).
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.expected_cost import tdi_cost
from sightline.applications.tdi_choice import TdiProblem, check_slip
from sightline.errors import FormatError, InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.io.acquisition.acquired import InputFolder, input_files
from sightline.io.config import read_toml, validate
from sightline.io.formats.tables import header_of, read_columns, sigma_columns
from sightline.io.tdi.columns import (
    COLUMNS,
    OPTICS,
    SIGMAS,
    SeenColumns,
    check_optics,
    columns_of_acquisition,
    optics_of,
    static_mtf,
)
from sightline.io.tdi.noise_table import NOISE, WELLS, read_noise_table, with_noise_table
from sightline.io.tdi.schema import MOST_COLUMNS, SLIP_SIGMA, VELOCITY_SIGMA, ChoiceSection, TdiFile
from sightline.result import set_source
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.table import check_words_fit

Array = NDArray[np.float64]

#: Cycles of slip over all stages that no image shows.
UNSEEN = 1e-3
#: A scene that moves so many times as fast as the clock, or as slowly, is not scanned by TDI.
FAR = 2.0


def load_tdi(path: str | Path, motion: str | Path | None = None) -> TdiProblem:
    """The problem of a TDI.toml.

    Parameters
    ----------
    path : str or Path
    motion : str or Path, optional
        Folder that ``recover`` wrote for the acquisition of ``[columns]``.

    Raises
    ------
    FormatError
        Names file, key, value, what is allowed; also for the table it names.
    InputError
        A motion without an acquisition, or of another one; a motion that does not cover the stages.
    """
    path = Path(path)
    file = validate(TdiFile, read_toml(path), path)
    with input_files(path, file) as files:
        problem = _problem(path, file, files, motion)
    set_source(problem, tuple(tdi_inputs(path, None if motion is None else Path(motion))))
    return problem


def _problem(path: Path, file: TdiFile, files: InputFolder, motion: str | Path | None) -> TdiProblem:
    """The file with everything that it names."""
    signals = np.array(file.signals.electrons)
    head, choice = file.head, file.choice
    detector = TdiDetector(
        Exposure(head.stages, head.integration_ratio, choice.align),
        NoiseLaw(**file.noise.model_dump(exclude={"table"})),
        file.signals.integration_ratio,
        choice.full_well_line,
        choice.full_well_sum,
    )
    grid, rules = (
        TdiGrid(np.array(file.grid.stage_list), np.array(file.grid.ratio_list)),
        _rules(choice, file),
    )
    if file.columns.acquisition is None and motion is not None:
        raise InputError(
            f"{path}: --motion belongs to an acquisition, whose cameras turn it into image motion; name it "
            "with [columns] acquisition = FILE in place of count or table"
        )
    seen: SeenColumns | None = None
    if file.columns.acquisition is not None:
        seen = columns_of_acquisition(file, files, None if motion is None else Path(motion))
    columns = _columns(file, files) if seen is None else seen.columns
    if file.noise.table is not None:
        table = files(file.noise.table)
        values = read_noise_table(table, path, file, columns.column)
        columns, detector = with_noise_table(columns, detector, file, values, table)
    moved = None if seen is None else replace(seen, columns=columns).mtf(grid, detector.exposure, rules)
    notes = () if seen is None else seen.notes
    if not (columns.static_mtf > 0.0).all():
        raise FormatError(
            f"{path}: optics, pixel and diffusion leave no contrast at mtf.frequencies = "
            f"{list(rules.frequencies)} cycles per pixel: nothing can be judged there; give lower "
            "frequencies, or correct optics_cutoff and apertures"
        )
    problem = TdiProblem(
        columns=columns,
        signals=signals,
        grid=grid,
        detector=detector,
        rules=rules,
        motion=moved,
        notes=notes + _without_effect(file, columns, moved is not None),
        max_loss=file.table.max_loss,
        hysteresis=choice.hysteresis,
        largest_step=choice.max_step,
        aperture=(file.mtf.aperture_x, file.mtf.aperture_y),
        name=file.name,
    )
    try:
        check_slip(problem.columns, problem.rules)
        check_words_fit(grid)
        tdi_cost(problem).check()
    except InputError as error:
        raise FormatError(f"{path}: {error}") from None
    return problem


def _without_effect(file: TdiFile, columns: ScanColumns, moved: bool) -> tuple[str, ...]:
    """Keys that were given and change nothing, and columns that were not given."""
    said = []
    uncertain = moved or columns.covariance is not None or file.signals.sigma > 0.0
    if file.choice.quantile is not None and not uncertain:
        said.append("[choice] quantile changes nothing: velocity, slip and signals are given as exact")
    if "motion" in file.model_fields_set and not moved:
        said.append("[motion] changes nothing without --motion")
    gaps = int(columns.column[-1] - columns.column[0]) + 1 - len(columns)
    if gaps:
        said.append(
            f"{gaps:,} columns between those of the table of columns are not named: the table of settings "
            "gives them what the nearest named one has, and its certificate does not hold for them; name "
            "every column"
        )
    return tuple(said)


def _rules(choice: ChoiceSection, file: TdiFile) -> ChoiceRules:
    return ChoiceRules(
        model=choice.model,
        merit=choice.merit,
        frequencies=file.mtf.frequencies,
        main_lobe_only=choice.main_lobe_only,
        snr_min=choice.snr_min,
        mtf_min=choice.mtf_min,
        mtf_max=choice.mtf_max,
        slip_limit=np.inf if choice.slip_limit == "allow" else choice.slip_limit,
        quantile=choice.quantile,
        signal_sigma=file.signals.sigma,
    )


def _columns(file: TdiFile, files: InputFolder) -> ScanColumns:
    """Columns by their count, a table, or the cameras of an acquisition."""
    section = file.columns
    static = static_mtf(file.mtf)
    if section.count is not None:
        column, velocity, slip = (
            np.arange(float(section.count)),
            np.ones(section.count),
            np.zeros(section.count),
        )
        return _with_sigmas(column, velocity, slip, np.tile(static, (section.count, 1)), file, {})
    return _read_columns(files(str(section.table)), static, file)


def _read_columns(path: Path, static: Array, file: TdiFile) -> ScanColumns:
    """A table of columns; its MTFs of the optics stand in for that of the file."""
    header = header_of(path)
    _refuse_misspelt(path, header)
    given = [name for name in (*OPTICS, *SIGMAS) if name in header]
    if len(set(given) & set(OPTICS)) == 1:
        raise FormatError(f"{path}: give both {OPTICS[0]} and {OPTICS[1]}, or neither")
    table = {
        name: np.asarray(v, dtype=np.float64) for name, v in read_columns(path, (*COLUMNS, *given)).items()
    }
    column = table["column"]
    if (column != np.round(column)).any() or (column < 0.0).any() or (np.diff(column) <= 0.0).any():
        raise FormatError(
            f"{path}: `column` must hold whole numbers from 0 up, rising, none twice; sort the rows"
        )
    if column[-1] >= MOST_COLUMNS:
        raise FormatError(
            f"{path}: column {column[-1]:.0f} is beyond {MOST_COLUMNS - 1}, the last that is allowed"
        )
    strange = ~((table["scan_velocity"] > 1.0 / FAR) & (table["scan_velocity"] < FAR))
    if strange.any():
        row = int(np.flatnonzero(strange)[0])
        raise FormatError(
            f"{path}: scan_velocity of column {column[row]:g} is "
            f"{table['scan_velocity'][row]:g}; pixels per line period along the column, near 1 (in step "
            "with the clock), are expected; is the sign of the scan reversed, or the unit another?"
        )
    check_optics(path, table)
    for name, bounds in zip(SIGMAS, (VELOCITY_SIGMA, SLIP_SIGMA), strict=True):
        if name in table:
            sigma_columns(path, table, [name], bounds)
    mtf = np.tile(static, (len(column), 1))
    if OPTICS[0] in table:
        without = static / optics_of(file.mtf)
        mtf = without * np.column_stack([table[name] for name in OPTICS])
    return _with_sigmas(column, table["scan_velocity"], table["slip"], mtf, file, table)


def _refuse_misspelt(path: Path, header: list[str]) -> None:
    """A column that looks like one of ours and is none is a mistake: it would count for nothing."""
    known = [*COLUMNS, *OPTICS, *SIGMAS]
    for name in header:
        close = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.75)
        if name not in known and close and close[0] not in header:
            raise FormatError(f"{path}: column {name!r} is not known; did you mean {close[0]}?")


def _with_sigmas(
    column: Array, velocity: Array, slip: Array, mtf: Array, file: TdiFile, table: Mapping[str, Array]
) -> ScanColumns:
    """Columns with the covariance that their sigmas make."""
    section = file.columns
    sigmas = np.column_stack(
        [np.broadcast_to(table.get(name, getattr(section, name)), column.shape) for name in SIGMAS]
    )
    covariance = sigmas[:, :, None] ** 2 * np.eye(2) if sigmas.any() else None
    return ScanColumns(column, velocity, slip, mtf, covariance)


def tdi_inputs(path: Path, motion: Path | None = None) -> list[Path]:
    """The TDI.toml, the files that it names, and what was read of a recovered motion."""
    file = validate(TdiFile, read_toml(path), path)
    names = (file.columns.table, file.columns.acquisition, file.noise.table)
    named = [path.parent / name for name in names if name is not None]
    read = ("motion.csv", "summary.json", "spectrum.csv", "hidden.csv", "covariance.npz")
    recovered = [] if motion is None else [motion / name for name in read if (motion / name).is_file()]
    return [path, *named, *recovered]


def describe_tdi(problem: TdiProblem) -> dict[str, Any]:
    """A problem in words: ``understood``, ``missing``, ``observable``, lists of sentences."""
    return {
        "understood": _understood(problem),
        "missing": _missing(problem),
        "observable": _consequences(problem),
        "settings": len(problem.grid),
    }


def _understood(problem: TdiProblem) -> list[str]:
    grid, detector, columns = problem.grid, problem.detector, problem.columns
    head = detector.exposure
    signals = problem.signals
    return [
        f"{problem.name}: {len(columns)} columns, {len(signals)} signals, {len(grid)} settings each",
        f"{grid.stages[0]} to {grid.stages[-1]} stages, integration ratio {_range(grid.ratios)}",
        f"{head.head_stages} head lines at an integration ratio of {head.head_ratio:g} measure the signal"
        if head.head_stages
        else f"no head lines: signals are given for an integration ratio of {detector.signal_ratio:g}",
        f"signals of {signals[0]:g} to {signals[-1]:g} electrons a line",
        f"velocity 1 {columns.velocity.min() - 1.0:+.3g} to 1 {columns.velocity.max() - 1.0:+.3g} px a line, "
        f"slip {np.degrees(columns.slip.min()):.4g} to {np.degrees(columns.slip.max()):.4g} degrees",
        *_kinds(detector),
        f"MTF of what stands still: {_range(columns.static_mtf[:, 0])} across, "
        f"{_range(columns.static_mtf[:, 1])} along, at {problem.rules.frequencies} cycles per px",
    ]


def _kinds(detector: TdiDetector) -> list[str]:
    """How unlike the columns are in noise and wells."""
    if not detector.kinds:
        return []
    values = {name: np.array([getattr(kind.noise, name) for kind in detector.kinds]) for name in NOISE}
    values |= {name: np.array([getattr(kind, name) for kind in detector.kinds]) for name in WELLS}
    unlike = [f"{name} {_range(each)}" for name, each in values.items() if each.min() < each.max()]
    return [f"columns of {len(detector.kinds):,} kinds: {', '.join(unlike)}"]


def _range(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"


def _missing(problem: TdiProblem) -> list[str]:
    kinds = problem.detector.kinds or (problem.detector,)
    said = []
    if all(kind.noise.read == 0.0 and kind.noise.output == 0.0 for kind in kinds):
        said.append("[noise] read or output: without them short integrations cost nothing")
    if all(np.isinf(kind.full_well_line) and np.isinf(kind.full_well_sum) for kind in kinds):
        said.append("[choice] full_well_line, full_well_sum: nothing says when the detector saturates")
    if problem.columns.covariance is None and problem.motion is None:
        said.append("sigmas of velocity and slip, or --motion: the choice will trust them as exact")
    return said


def _consequences(problem: TdiProblem) -> list[str]:
    """How many stages the drift alone allows: N |phi| = 0.371 is best for photons, 1 ends the main lobe."""
    columns, (fx, fy) = problem.columns, problem.rules.frequencies
    across = np.abs(columns.velocity * np.tan(columns.slip)) * fx
    along = np.abs(columns.velocity - 1.0) * fy
    worst = float(np.maximum(across, along).max())
    if worst * float(problem.grid.stages[-1]) < UNSEEN:
        return ["the scene moves in step with every column: drift limits no number of stages"]
    return [
        f"the column that drifts most is served best by about {0.371 / worst:.3g} stages and blurred out by "
        f"{1.0 / worst:.3g}"
    ]
