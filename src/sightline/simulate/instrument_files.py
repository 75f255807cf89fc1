"""Writes a strip of one of the instruments of ``instruments.py`` as a user would receive it.

Files: ``acquisition.toml``, images, ``positions.csv``, ``attitudes.csv`` or ``mirror.csv`` where the
instrument needs them; and the truth, ``truth.csv`` and ``truth-bands.csv``. Contents: ``docs/formats.md``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sightline.execution import Step, no_step, part_of
from sightline.geometry.rotations import to_quat_xyzw
from sightline.simulate.files import write_image, write_numbers
from sightline.simulate.instruments import (
    InstrumentScenario,
    mirror_angles,
    mirror_axes,
    nominal_attitude,
    table_times,
)
from sightline.simulate.texture import Array

_POSITION_STEP, _ATTITUDE_STEP = 0.5, 0.25
"""s between rows of the tables a user gets; cubics between them are good to a micrometre and a picoradian."""


def write_instrument(scenario: InstrumentScenario, folder: Path, step: Step = no_step) -> dict[str, Path]:
    """Render `scenario` into `folder`.

    Parameters
    ----------
    scenario : InstrumentScenario
    folder : Path
        Exists; files of the same names are replaced.
    step : callable
        Called with the number of lines that are rendered, and of all.

    Returns
    -------
    dict of str to Path
        What was written, by file name.
    """
    options = scenario.options
    written = []
    for index, camera in enumerate(scenario.cameras):
        path = folder / f"{scenario.bands[index].options.name}.tif"
        lines = part_of(step, index, len(scenario.cameras))
        written.append(write_image(path, camera.shape, scenario.chunks(index), lines))
    t = table_times(options, _POSITION_STEP)
    position, _ = scenario.orbit.earth_fixed(t)
    written.append(write_numbers(folder / "positions.csv", "t,x,y,z", np.column_stack([t, position])))
    if scenario.spin is None:
        t = table_times(options, _ATTITUDE_STEP)
        quaternions = to_quat_xyzw(nominal_attitude(options, scenario.orbit, t))
        table = np.column_stack([t, quaternions])
        written.append(write_numbers(folder / "attitudes.csv", "t,qx,qy,qz,qw", table))
    if options.scan == "mirror":
        table = np.column_stack(mirror_angles(options))
        written.append(write_numbers(folder / "mirror.csv", "t,angle", table))
    written.append(write_numbers(folder / "truth.csv", "t,roll,pitch,yaw", scenario.truth))
    written.append(_write_band_truth(folder / "truth-bands.csv", scenario))
    toml = folder / "acquisition.toml"
    toml.write_text(instrument_toml(scenario))
    return {path.name: path for path in [toml, *written]}


def instrument_toml(scenario: InstrumentScenario) -> str:
    """The ACQUISITION file of a strip: what a user would know, never the truth."""
    options = scenario.options
    lines = [
        "[acquisition]",
        f'name = "simulated {scenario.case}, seed {scenario.seed}"',
        'epoch = "2026-01-01T00:00:00Z"',
        "",
        "[platform]",
        *_platform_lines(scenario),
        "",
        "[instrument]",
        f"line_period = {options.line_period!r}",
    ]
    if options.scan == "mirror":
        axis, normal, camera = mirror_axes(options)
        lines += ["", "[camera]", f"body_from_camera = {_numbers(camera.as_quat())}", ""]
        lines += ["[pointing]", 'kind = "scan-mirror"', f"axis = {_numbers(axis)}"]
        lines += [f"normal = {_numbers(normal)}", 'angles = "mirror.csv"']
    for band in scenario.bands:
        detector = band.options
        lines += [
            "",
            "[[band]]",
            f'name = "{detector.name}"',
            f'image = "{detector.name}.tif"',
            f"ifov = {options.ifov * detector.fineness!r}",
            f"columns = {options.width(detector)}",
            f"look_ahead = {band.look_ahead!r}",
            f"offset_px = [0.0, {detector.aside!r}]",
            f"offset_sigma_px = {options.offset_sigma_px!r}",
            f"rotation_sigma = {options.rotation_sigma!r}",
        ]
    lines += ["", "[surface]", "height = 0.0"]
    if options.pairs:
        pairs = ", ".join(f'["{a}", "{b}"]' for a, b in options.pairs)
        lines += ["", "[matching]", f"pairs = [{pairs}]"]
    return "\n".join(lines) + "\n"


def _platform_lines(scenario: InstrumentScenario) -> list[str]:
    spin = scenario.spin
    if spin is None:
        return ['kind = "ephemeris"', 'positions = "positions.csv"', 'attitudes = "attitudes.csv"']
    return [
        'kind = "spin"',
        'positions = "positions.csv"',
        f"attitude = {_numbers(spin.attitude.as_quat())}",
        f"axis = {_numbers(spin.axis)}",
        f"rate = {spin.rate!r}",
    ]


def _numbers(values: Array) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _write_band_truth(path: Path, scenario: InstrumentScenario) -> Path:
    rows = ["name,lag,look_ahead,offset_line_px,offset_column_px,rotation"]
    for band in scenario.bands:
        lag = band.options.behind * scenario.options.line_period
        offset = f"{band.offset_px[0]!r},{band.offset_px[1]!r}"
        rows.append(f"{band.options.name},{lag!r},{band.look_ahead!r},{offset},{band.rotation!r}")
    path.write_text("\n".join(rows) + "\n")
    return path
