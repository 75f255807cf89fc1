"""Signal and noise of a TDI column against draws of its electrons."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.imaging.tdi_noise import NoiseLaw, snr, summed_signal
from sightline.imaging.tdi_transfer import Exposure


@pytest.mark.parametrize(
    ("signal", "stages", "ratio", "law"),
    [
        (400.0, 20, 0.8, NoiseLaw(9e-6, 1.0, 12.0)),
        (30.0, 12, 0.4, NoiseLaw(0.0, 1.0, 5.0, dark=20.0, output=15.0)),
        (2000.0, 40, 0.6, NoiseLaw(1e-4, 1.0, 12.0, column_fixed=4e-6)),
    ],
)
def test_snr_is_that_of_drawn_electrons(signal, stages, ratio, law):
    exposure, draws = Exposure(3, 0.5), 40_000
    rng = np.random.default_rng(2)
    ratios = np.where(np.arange(stages) < 3, 0.5, ratio)
    mean = signal / 0.5 * ratios
    lines = rng.poisson(mean, (draws, stages)) * 1.0
    lines += mean * np.sqrt(law.gain) * rng.standard_normal((draws, stages))
    lines += rng.poisson(law.dark * ratios, (draws, stages)) - law.dark * ratios
    lines += law.read * rng.standard_normal((draws, stages))
    total = lines.sum(axis=1) + law.output * rng.standard_normal(draws)
    total += mean.sum() * np.sqrt(law.column_fixed) * rng.standard_normal(draws)
    assert summed_signal(signal, stages, ratio, exposure) == pytest.approx(mean.sum(), rel=1e-12)
    # a standard deviation of 40,000 draws is known to 1 / sqrt(2 x 40,000) = 0.35 %; four of them
    assert snr(signal, stages, ratio, law, exposure) == pytest.approx(mean.sum() / total.std(), rel=0.014)


def test_photons_alone_count_as_their_root():
    assert snr(100.0, 16, 1.0, NoiseLaw(), Exposure()) == pytest.approx(40.0)


def test_short_lines_after_long_ones_may_lower_it():
    # read noise dominates: lines of less than half the head's exposure cost more than they bring
    law, exposure = NoiseLaw(read=1000.0), Exposure(4, 1.0)
    assert snr(10.0, 8, 0.3, law, exposure) < snr(10.0, 4, 0.3, law, exposure)


def test_a_column_pattern_caps_it():
    law = NoiseLaw(column_fixed=1e-4)
    assert snr(1e9, 64, 1.0, law, Exposure()) == pytest.approx(100.0, rel=1e-4)


def test_without_noise_or_signal():
    law = NoiseLaw(shot=0.0)
    assert snr([0.0, 5.0], 4, 1.0, law, Exposure()).tolist() == [0.0, np.inf]


@pytest.mark.parametrize("name", ["gain", "shot", "read", "dark", "output", "column_fixed"])
def test_negative_noise_is_refused(name):
    with pytest.raises(InputError, match=f"noise `{name}` is -1"):
        NoiseLaw(**{name: -1.0})


def test_a_signal_of_no_exposure_is_refused():
    with pytest.raises(InputError, match="above 0, up to 1"):
        snr(10.0, 4, 1.0, NoiseLaw(), Exposure(), reference=0.0)
