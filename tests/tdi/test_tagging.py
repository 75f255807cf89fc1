"""Tags of lines, their run-length code, and the image in one unit again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sightline.errors import FormatError, InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import choose_settings
from sightline.tdi.hysteresis import nearest_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.tagging import (
    FIELDS,
    decode_field,
    encode_field,
    recalibrate,
    rounded_signal,
    seam_sigma,
    tag_lines,
)

GROUPS, WIDTH = 8, 5


def a_case(**wells):
    x = np.linspace(-1.0, 1.0, GROUPS)
    scan = ScanColumns(
        np.arange(GROUPS) * WIDTH, 0.999 + 0.004 * x**2, np.radians(0.1 + 1.2 * x), np.full((GROUPS, 2), 0.3)
    )
    detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0, dark=20.0), **wells)
    grid, rules = TdiGrid(np.arange(3, 65), np.arange(1, 11) / 10.0), ChoiceRules()
    model = DriftMtf(scan, grid, detector.exposure, rules)
    return model, choose_settings(model, np.geomspace(5.0, 4000.0, 30), grid, detector, rules)


def some_tags(signals, **wells):
    """Tags of lines set by their signals (L, G)."""
    model, choice = a_case(**wells)
    return choice, tag_lines(
        model, nearest_settings(choice, signals), signals, choice.grid, choice.detector,
        first_column=np.arange(GROUPS) * WIDTH, columns=GROUPS * WIDTH, table=7,
    )  # fmt: skip


def test_tags_say_what_the_choice_said():
    signals = np.tile(a_case()[1].signals[:, None], GROUPS)
    choice, tags = some_tags(signals)
    assert np.array_equal(tags.stages, choice.stages.T)
    assert np.array_equal(tags.ratios[tags.ratio_index], choice.integration_ratio.T)
    # single precision keeps 24 bits
    assert tags.mtf_across == pytest.approx(choice.mtf[..., 0].T, rel=1e-7)
    assert tags.mtf_along == pytest.approx(choice.mtf[..., 1].T, rel=1e-7)
    assert tags.snr == pytest.approx(choice.snr.T, rel=1e-7)
    assert tags.velocity[3] == pytest.approx(choice.columns.velocity, rel=1e-7)
    assert tags.slip[3] == pytest.approx(choice.columns.slip, rel=1e-7)
    assert (tags.table == 7).all() and not tags.saturated.any() and len(tags) == 30
    body = tags.stages - 2.0
    assert tags.integration_time == pytest.approx(0.5 + body * tags.ratios[tags.ratio_index], rel=1e-12)


def test_a_full_well_is_flagged():
    # the head of 0.25 fills at 4 x 5000 electrons per line period, less the dark current: 4995 electrons
    signals = np.tile([[100.0], [6000.0]], (1, GROUPS))
    _, tags = some_tags(signals, full_well_line=5000.0)
    assert tags.saturated.tolist() == [[0] * GROUPS, [1] * GROUPS]


@pytest.mark.parametrize("form", sorted(set(FIELDS.values())))
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (40, 1), (60, 13)])
@pytest.mark.parametrize("levels", [1, 2, 200])
def test_a_field_comes_back_bit_by_bit(form, shape, levels):
    rng = np.random.default_rng(levels)
    values = rng.integers(0, levels, shape).astype(form)
    if form == "<f4":
        values = (values * np.float32(np.pi) - 1.0).astype("<f4")
        values[-1, -1], values[0, 0] = np.nan, -0.0
    back = decode_field(encode_field(values), shape, form)
    assert back.dtype == values.dtype and back.tobytes() == values.tobytes()


def test_what_stays_costs_nothing():
    steady = np.tile(np.arange(64, dtype="<f4"), (10_000, 1))
    # 64 values of 4 bytes with a count each; 639,936 times the line before in one token of 3 bytes
    assert len(encode_field(steady)) == 64 * 5 + 3
    assert len(encode_field(np.full((10_000, 64), 3, dtype="<u2"))) == 3 + 2


def test_a_change_within_a_line_costs_only_itself():
    values = np.tile(np.arange(64, dtype="<u2"), (100, 1))
    before = len(encode_field(values))
    values[50:, 20] = 999
    # a count and the value, and the run of copies ends and begins anew (2 bytes)
    assert len(encode_field(values)) == before + 3 + 2


@pytest.mark.parametrize(
    "code",
    [
        b"",  # nothing
        b"\x0c",  # a value is announced, none follows
        b"\x0c\x05\x00\xff",  # one byte too many
        b"\x0e\x05\x00",  # 7 values for a table of 6
        b"\x0d",  # a copy of the line before the first
        b"\x00\x05\x00",  # no time
        b"\xff" * 12,  # a count without end
        b"\x06\x05\x00",  # 3 of 6
    ],
)
def test_a_damaged_code_is_refused(code):
    assert decode_field(b"\x0c\x05\x00", (2, 3), "<u2").tolist() == [[5, 5, 5]] * 2
    with pytest.raises(FormatError, match="run-length"):
        decode_field(code, (2, 3), "<u2")


def test_rounded_signals_are_near_and_few():
    signals = np.geomspace(1.0, 5000.0, 10_000)
    rounded = rounded_signal(signals, 0.05)
    assert np.abs(np.log(rounded / signals)).max() <= 0.5 * np.log(1.05) * (1.0 + 1e-9)
    assert len(np.unique(rounded)) <= np.log(5000.0) / np.log(1.05) + 2
    assert rounded_signal([-3.0, 0.0]).tolist() == [0.0, 0.0]
    with pytest.raises(InputError, match="step"):
        rounded_signal(1.0, 0.0)


def test_a_flat_field_is_flat_again():
    _, tags = some_tags(np.full((40, GROUPS), 300.0))
    rng = np.random.default_rng(0)
    gain = 1.0 + 0.02 * rng.standard_normal(GROUPS * WIDTH)
    time = tags.integration_time[:, tags.group_of_columns()]
    samples = gain * 300.0 / 0.25 * time + 20.0 * time
    assert np.ptp(samples[0]) > 0.2 * samples.mean()
    flat = recalibrate(samples, tags, dark=20.0, column_gain=gain)
    assert flat.signal == pytest.approx(300.0, rel=1e-12)
    assert not flat.sigma.any()


def test_noise_hides_the_seams_once_recalibrated():
    _, tags = some_tags(np.full((600, GROUPS), 300.0))
    law, rng = a_case()[1].detector.noise, np.random.default_rng(0)
    group = tags.group_of_columns()
    stages, ratio = tags.stages[:, group] - 2.0, tags.ratios[tags.ratio_index][:, group]
    time = tags.integration_time[:, group]
    own = (stages + 2.0) * law.read**2 + law.gain * 1200.0**2 * (2.0 * 0.25**2 + stages * ratio**2)
    samples = rng.poisson((1200.0 + law.dark) * time) + np.sqrt(own) * rng.standard_normal(time.shape)

    def steps(image):
        of_groups = np.diff(image.reshape(600, GROUPS, WIDTH).mean(axis=2), axis=1)
        return of_groups.mean(axis=0), of_groups.std(axis=0) / np.sqrt(600)

    image = recalibrate(samples, tags, dark=law.dark).signal
    step, sigma = steps(image)
    # 7 borders: five sigma; one pixel is noisier than a step by sqrt(600 lines x 5 columns / 2 sides) = 39
    assert np.abs(step / sigma).max() < 5.0
    assert np.abs(step).max() < 5.0 / 39.0 * image.std(axis=0).min()
    assert image.std(axis=0) == pytest.approx(300.0 / tags.snr[0, group], rel=0.15)  # 2.9 % each, five sigma
    # without recalibration the settings stand out
    raw, raw_sigma = steps(samples)
    assert np.abs(raw / raw_sigma).max() > 100.0


@pytest.mark.parametrize(
    ("dark", "dark_sigma", "gain_sigma"), [(0.0, 0.0, 0.0), (200.0, 0.0, 0.0), (20.0, 0.5, 2e-3)]
)
def test_stated_sigmas_are_the_spread_of_drawn_errors(dark, dark_sigma, gain_sigma):
    draws, rng = 4000, np.random.default_rng(1)
    _, tags = some_tags(np.full((draws, GROUPS), 60.0))
    tags = replace(tags, ratio_index=np.tile([0, 3, 3, 9, 9, 5, 5, 2], (draws, 1)))
    errors = {"ratio_sigma": np.linspace(2e-4, 1e-3, 10), "head_sigma": 2e-3}
    # every line has its own errors of all ratios, and of head, gains and dark current
    ratios = tags.ratios + errors["ratio_sigma"] * rng.standard_normal((draws, 10))
    time = 2.0 * (0.25 + 2e-3 * rng.standard_normal((draws, 1)))
    time = time + (tags.stages - 2.0) * np.take_along_axis(ratios, tags.ratio_index.astype(int), axis=1)
    gain = 1.0 + gain_sigma * rng.standard_normal((draws, tags.columns))
    current = dark + dark_sigma * rng.standard_normal(gain.shape)
    samples = (gain * 240.0 + current) * time[:, tags.group_of_columns()]
    found = recalibrate(
        samples, tags, dark=dark, dark_sigma=dark_sigma, column_gain_sigma=gain_sigma, **errors
    )
    # a standard deviation of 4000 draws is known to 1.1 %; five of them, for 40 columns
    assert found.sigma.mean(axis=0) == pytest.approx(found.signal.std(axis=0), rel=0.056)
    if not gain_sigma:
        steps = np.diff(found.signal[:, ::WIDTH], axis=1).std(axis=0)
        assert 60.0 * seam_sigma(tags, dark=dark, **errors)[0] == pytest.approx(steps, rel=0.056)


def test_groups_of_one_setting_have_no_seam():
    _, tags = some_tags(np.full((3, GROUPS), 300.0))
    same = replace(tags, stages=np.full((3, GROUPS), 20), ratio_index=np.full((3, GROUPS), 4))
    assert not seam_sigma(same, ratio_sigma=1e-3, head_sigma=1e-3).any()
    assert seam_sigma(tags, ratio_sigma=1e-3).any()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"first_column": np.arange(GROUPS) + 1}, "first_column"),
        ({"columns": GROUPS - 1}, "first_column"),
        ({"signal_ratio": 0.0}, "signal_ratio"),
        ({"snr": np.ones((3, GROUPS + 1))}, "snr"),
        ({"stages": np.full((3, GROUPS), 70_000)}, "stages"),
        ({"stages": np.zeros((3, GROUPS))}, "no stage"),
        ({"ratio_index": np.full((3, GROUPS), 10)}, "not in the list"),
        ({"table": np.full((3, GROUPS), -1)}, "table"),
    ],
)
def test_tags_that_cannot_be_are_refused(change, says):
    _, tags = some_tags(np.full((3, GROUPS), 300.0))
    with pytest.raises(InputError, match=says):
        replace(tags, **change)


@pytest.mark.parametrize(
    ("shape", "options", "says"),
    [
        ((3, 39), {}, "samples"),
        ((3, 40), {"column_gain": 0.0}, "column_gain"),
        ((3, 40), {"ratio_sigma": -1.0}, "ratio_sigma"),
        ((3, 40), {"head_sigma": np.nan}, "head_sigma"),
    ],
)
def test_a_recalibration_that_cannot_be_is_refused(shape, options, says):
    _, tags = some_tags(np.full((3, GROUPS), 300.0))
    with pytest.raises(InputError, match=says):
        recalibrate(np.ones(shape), tags, **options)
