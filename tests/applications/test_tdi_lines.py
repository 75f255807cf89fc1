"""Settings and tags of an image of signals: those of the table, or held from line to line."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio

import sightline
from sightline.applications import tdi_lines
from sightline.applications.tdi_choice import TdiProblem, choose_tdi
from sightline.applications.tdi_lines import SignalLines
from sightline.cli.main import run
from sightline.imaging.source import ArrayImage
from sightline.imaging.tdi_noise import NoiseLaw, snr
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.hysteresis import line_loss, merit_factors
from sightline.tdi.merit import SomeColumns, filled
from sightline.tdi.setting import ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.tagging import FIELDS, rounded_signal

NUMBERS = np.array([4, 5, 6, 7, 10, 11])  # 8 and 9 are not named


def problem(**more) -> TdiProblem:
    x = np.linspace(-1.0, 1.0, len(NUMBERS))
    columns = ScanColumns(NUMBERS, 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((len(x), 2), 0.3))
    detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0), full_well_sum=60_000.0)
    grid = TdiGrid(np.arange(3, 97), np.arange(1, 11) / 10.0)
    return TdiProblem(columns, np.geomspace(10.0, 4000.0, 24), grid, detector, **more)


@pytest.fixture(scope="module")
def free():
    return choose_tdi(problem())


@pytest.fixture(scope="module")
def steady():
    return choose_tdi(problem(hysteresis=0.02))


@pytest.fixture(scope="module")
def scene():
    """Electrons that drift and flicker, 80 lines x 8 columns, with what has no signal."""
    rng = np.random.default_rng(1)
    slow = np.cumsum(0.05 * rng.standard_normal((80, 8)), axis=0)
    signals = 300.0 * np.exp(slow + 0.1 * rng.standard_normal((80, 8)))
    signals[3, 2], signals[4, 2], signals[5, 2] = np.nan, -5.0, 0.0
    signals[6:9, 5], signals[9, 5] = 9000.0, 4.0
    return signals.astype(np.float32)


def settings_of(result, signals, **mask):
    """Stages and ratio index (L, C) and the tags, of all blocks together."""
    lines = SignalLines(result, ArrayImage(signals, **mask))
    blocks = list(lines.blocks())
    fields = {name: np.concatenate([getattr(b, name) for b in blocks]) for name in FIELDS}
    return fields, lines.counts


def setting_numbers(result, fields):
    """Settings (L, C) as the grid counts them."""
    grid = result.problem.grid
    return np.searchsorted(grid.stages, fields["stages"]) * len(grid.ratios) + fields["ratio_index"]


def test_settings_are_those_of_the_table(free, scene):
    fields, counts = settings_of(free, scene)
    stages, ratio = free.table.unpack(free.table.lookup(scene))
    assert np.array_equal(fields["stages"], stages)
    assert np.array_equal(free.problem.grid.ratios[fields["ratio_index"]], ratio)
    assert (fields["table"] == free.table.identity).all()
    assert (counts.without_signal, counts.below, counts.beyond) == (3, 1, 3)
    assert counts.changes == np.count_nonzero(
        (np.diff(stages, axis=0) != 0) | (np.diff(fields["ratio_index"].astype(int), axis=0) != 0)
    )
    assert (counts.fewest, counts.most, counts.total) == (stages.min(), stages.max(), stages.sum())


def test_tags_hold_what_is_expected_of_each_pixel(free, scene):
    fields, _ = settings_of(free, scene)
    detector, grid = free.problem.detector, free.problem.grid
    # columns that the file does not name are taken for the nearest that it does: 8 for 7, 9 for 10
    nearest = np.array([0, 1, 2, 3, 3, 4, 4, 5])
    columns = free.problem.columns
    assert fields["velocity"][11] == pytest.approx(columns.velocity[nearest], rel=1e-6)
    assert fields["slip"][11] == pytest.approx(columns.slip[nearest], rel=1e-6)
    system = (
        SomeColumns(free.problem.model, nearest).central(slice(0, 8)) * columns.static_mtf[nearest][:, None]
    )
    mtf = system[np.arange(8), setting_numbers(free, fields)]
    assert fields["mtf_across"] == pytest.approx(mtf[..., 0], rel=1e-6)
    assert fields["mtf_along"] == pytest.approx(mtf[..., 1], rel=1e-6)
    # signals are kept to 5 %, wells are judged by what was there
    clean = np.where(scene > 0.0, scene, 0.0).astype(float)
    assert fields["signal"] == pytest.approx(rounded_signal(clean, 0.05), rel=1e-6)
    assert np.abs(fields["signal"] / np.maximum(clean, 1.0) - 1.0)[clean > 0.0].max() < 0.026
    stages, ratio = fields["stages"], grid.ratios[fields["ratio_index"]]
    expected = snr(fields["signal"], stages, ratio, detector.noise, detector.exposure, detector.reference)
    assert fields["snr"] == pytest.approx(expected, rel=1e-5)
    _, total = filled(clean, stages, ratio, detector)
    assert np.array_equal(fields["saturated"] == 1, total > detector.full_well_sum)
    assert fields["saturated"][6:9, 5].all()


def test_masked_pixels_take_the_setting_of_the_lowest_signal(free, scene):
    mask = np.zeros(scene.shape, dtype=bool)
    mask[20:30, 1] = True
    fields, counts = settings_of(free, scene, unusable=mask)
    stages, _ = free.table.unpack(free.table.lookup(np.zeros(8, dtype=np.float32)))
    assert (fields["stages"][20:30, 1] == stages[1]).all()
    assert counts.without_signal == 13


@pytest.mark.parametrize("which", ["free", "steady"])
def test_blocks_of_any_size_give_the_same(which, scene, request, monkeypatch):
    result = request.getfixturevalue(which)
    whole, counts = settings_of(result, scene)
    monkeypatch.setattr(tdi_lines, "AT_ONCE", 8 * 7)
    parts, again = settings_of(result, scene)
    for name in FIELDS:
        assert np.array_equal(whole[name], parts[name])
    assert counts == again


def test_with_hysteresis_settings_are_held_and_little_merit_is_lost(free, steady, scene):
    # an even scene that flickers by 10 %, and one in which wells fill
    flicker = 0.1 * np.random.default_rng(2).standard_normal((60, 8))
    scene = np.concatenate([(90.0 * np.exp(flicker)).astype(np.float32), scene])
    (before, many), (after, few) = settings_of(free, scene), settings_of(steady, scene)
    at_rest = np.count_nonzero(np.diff(setting_numbers(steady, after)[:60], axis=0))
    assert at_rest < 0.2 * np.count_nonzero(np.diff(setting_numbers(steady, before)[:60], axis=0))
    assert few.changes < many.changes
    model, choice = steady.problem.model, steady.choice
    nearest = np.array([0, 1, 2, 3, 3, 4, 4, 5])
    clean = np.where(scene > 0.0, scene, 0.0).astype(float)
    setting = setting_numbers(steady, after)
    factors = merit_factors(model, choice)
    wide = replace(
        factors,
        by_column=factors.by_column[nearest],
        column_kept=factors.column_kept[nearest],
        first=factors.first[nearest],
    )
    of_columns = replace(choice, setting=choice.setting[nearest], columns=choice.columns.part(nearest))
    loss = line_loss(wide, of_columns, setting, clean)
    # a setting that fills a well at the very signal gives way to the table's, which may be another
    stages, ratio = steady.table.unpack(steady.table.lookup(scene))
    looked_up = {"stages": stages, "ratio_index": np.searchsorted(steady.problem.grid.ratios, ratio)}
    moved = setting != setting_numbers(steady, looked_up)
    assert loss[moved & (clean > 0.0)].max() <= 0.02 + 1e-6
    # no well is filled that the table keeps
    assert not ((after["saturated"] == 1) & (before["saturated"] == 0)).any()
    assert (after["table"] == 0).all()


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_the_files_hold_the_same_and_read_back(tmp_path, free, scene, capsys):
    np.save(tmp_path / "signals.npy", scene)
    rows = [f"{n},{v},{s}" for n, v, s in zip(NUMBERS, *some_columns(), strict=True)]
    (tmp_path / "columns.csv").write_text("\n".join(["column,scan_velocity,slip", *rows]))
    (tmp_path / "tdi.toml").write_text(TOML)
    out = tmp_path / "out"
    words = ["tdi", str(tmp_path / "tdi.toml"), "--out", str(out), "--no-pictures"]
    assert run([*words, "--signals", str(tmp_path / "signals.npy")]) == 0
    said = capsys.readouterr()
    assert f"{out / 'settings.tif'}, {out / 'tags.bin'}" in said.out
    assert "of the pixels of the image of signals have no signal above 0" in said.err
    with rasterio.open(out / "settings.tif") as source:
        stages, ratio = source.read()
        assert source.dtypes == ("uint16", "uint16") and source.descriptions == ("stages", "ratio index")
        ratios = np.array(source.tags()["INTEGRATION_RATIOS"].split(","), dtype=float)
    table = sightline.TdiTable.read(out)
    expected = table.unpack(table.lookup(scene))
    assert np.array_equal(stages, expected[0]) and np.array_equal(ratios[ratio], expected[1])
    tags = sightline.read_tdi_tags(out / "tags.bin")
    assert len(tags) == 80 and tags.columns == 8 and np.array_equal(tags.first_column, np.arange(8))
    assert np.array_equal(tags.stages, stages) and np.array_equal(tags.ratio_index, ratio)
    assert tags.table[0, 0] == table.identity
    summary = json.loads((out / "summary.json").read_text())
    image = summary["signal_image"]
    assert (image["lines"], image["columns"], image["without_signal"]) == (80, 8, 3)
    assert image["stages"]["mean"] == pytest.approx(stages.mean())
    assert image["tags_bytes"] == (out / "tags.bin").stat().st_size
    assert "signals.npy" in summary["inputs"]
    # without an image none of its files stays behind
    assert run([*words, "--overwrite"]) == 0
    assert not (out / "settings.tif").exists() and not (out / "tags.bin").exists()


@pytest.mark.parametrize(
    ("shape", "says"),
    [
        ((20, 9), "the image of signals has 9 columns, [columns] of the choice 8 (numbers 4 to 11)"),
        (None, "no such file"),
    ],
)
def test_an_image_that_does_not_fit_is_refused_before_anything_is_chosen(
    tmp_path, shape, says, capsys, monkeypatch
):
    monkeypatch.setattr("sightline.applications.tdi_choice.choose_tdi", lambda *_: 1 / 0)
    rows = [f"{n},1.0,0.0" for n in NUMBERS]
    (tmp_path / "columns.csv").write_text("\n".join(["column,scan_velocity,slip", *rows]))
    (tmp_path / "tdi.toml").write_text(TOML)
    if shape is not None:
        np.save(tmp_path / "signals.npy", np.ones(shape))
    words = ["tdi", str(tmp_path / "tdi.toml"), "--out", str(tmp_path / "out")]
    assert run([*words, "--signals", str(tmp_path / "signals.npy")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def some_columns():
    """Velocity and slip of `problem`."""
    columns = problem().columns
    return columns.velocity, columns.slip


TOML = """
[grid]
stages = { from = 3, to = 96 }
integration_ratio = { from = 0.1, to = 1.0, step = 0.1 }
[head]
stages = 2
integration_ratio = 0.25
[noise]
gain = 9e-6
read = 12.0
[columns]
table = "columns.csv"
[signals]
from = 10
to = 4000
count = 24
[mtf]
optics_mtf = 0.3
[choice]
full_well_sum = 60000
"""
