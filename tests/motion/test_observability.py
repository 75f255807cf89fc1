import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.errors import InputError
from sightline.motion.observability import (
    best_k,
    blind_frequencies,
    chain_gain,
    combined_gain,
    filter_response,
    intervals_above,
    merge,
    noise_gain,
    passbands,
    polynomial_gain,
    power_transfer,
    transfer,
)

lags = st.floats(1e-3, 1.0)


@given(lag=lags, frequency=st.floats(0.0, 500.0))
def test_a_lag_turns_a_sinusoid_into_itself_times_the_transfer(lag, frequency):
    t = np.linspace(0.0, 1.0, 7)
    tone = np.exp(2j * np.pi * frequency * t)
    shifted = np.exp(2j * np.pi * frequency * (t + lag))
    # Phases reach 2 pi 500 rad, known to 2e-16 of that.
    assert transfer(frequency, lag) * tone == pytest.approx(shifted - tone, abs=1e-11)
    assert power_transfer(frequency, lag) == pytest.approx(np.abs(transfer(frequency, lag)) ** 2, abs=1e-10)


@given(lag=lags)
def test_swapping_the_images_of_a_pair_changes_no_gain(lag):
    f = np.linspace(0.0, 300.0, 50)
    assert chain_gain(f, -lag, 0.1) == pytest.approx(chain_gain(f, lag, 0.1))
    assert blind_frequencies(-lag, 300.0) == pytest.approx(blind_frequencies(lag, 300.0))


def test_nothing_is_seen_at_a_blind_frequency_and_all_of_them_are_listed():
    blind = blind_frequencies(0.0222, 300.0)
    assert len(blind) == 6
    assert power_transfer(blind, 0.0222) == pytest.approx(0.0, abs=1e-20)
    assert filter_response(blind, 0.0222, 0.1) == pytest.approx(0.0, abs=1e-10)


@given(lag=lags, k=st.floats(1e-3, 2.0), level=st.floats(0.05, 0.6))
def test_the_edges_of_a_pass_band_have_exactly_the_level(lag, k, level):
    upper = 2.7 / lag
    for low, high in passbands(lag, upper, k=k, level=level):
        assert chain_gain(low, lag, k) == pytest.approx(level, rel=1e-6)
        if high < upper:
            assert chain_gain(high, lag, k) == pytest.approx(level, rel=1e-6)
        assert chain_gain(0.5 * (low + high), lag, k) > level


def test_joint_pass_bands_agree_with_the_sampled_gain():
    pair = [0.150, 0.0074]
    f = np.linspace(0.0, 200.0, 400001)
    gain = combined_gain(f, pair, 0.1)
    bands = passbands(pair, 200.0)
    sampled = intervals_above(f, gain, 0.5)
    assert len(bands) == len(sampled)
    assert np.array(bands) == pytest.approx(np.array(sampled), abs=1e-4)


def test_more_pairs_never_see_less():
    f = np.linspace(0.0, 200.0, 1001)
    one = combined_gain(f, [0.15], 0.1)
    best = combined_gain(f, [0.15, 0.0074], 0.1, "max-band")
    both = combined_gain(f, [0.15, 0.0074], 0.1)
    assert (best >= one - 1e-12).all() and (both >= best - 1e-12).all()


def test_no_pass_band_is_left_where_the_noise_is_too_large():
    # |G|^2 is at most 4: a gain of one half asks for k of 4 at most.
    assert passbands(0.01, 500.0, k=4.1) == ()


def test_overlapping_bands_merge_into_one():
    assert merge([(3.0, 5.0), (0.0, 1.0), (4.0, 6.0), (6.0, 7.0)]) == ((0.0, 1.0), (3.0, 7.0))


def test_the_best_k_of_a_white_motion_is_one_over_the_squared_snr():
    # Minimise noise^2 + snr^2 bias^2 over k numerically; sigma of noise 1, of motion snr.
    from sightline.motion.observability import bias_gain

    snr = 3.0
    k = np.geomspace(0.02, 0.6, 20001)
    error = [noise_gain(x) ** 2 + snr**2 * bias_gain(x) ** 2 for x in k]
    assert k[np.argmin(error)] == pytest.approx(best_k(snr), rel=1e-3)


def test_polynomial_gain_is_the_scatter_of_fits_to_noise():
    rng = np.random.default_rng(4)
    t, lag, at = np.linspace(0.0, 1.5, 80), 0.4, np.linspace(0.0, 1.9, 20)
    powers = np.arange(1, 4)
    rows = (t[:, None] + lag) ** powers - t[:, None] ** powers
    noise = rng.standard_normal((80, 4000))
    curves = at[:, None] ** powers @ np.linalg.lstsq(rows, noise, rcond=None)[0]
    curves -= curves.mean(axis=0)
    # 4000 draws know a standard deviation to 1/sqrt(8000) = 1.1 %; 4 of those.
    assert polynomial_gain(at, t, lag, degree=3) == pytest.approx(curves.std(axis=1), rel=0.045)


@pytest.mark.parametrize("lag", [0.0, np.nan])
def test_a_lag_of_nothing_is_refused(lag):
    with pytest.raises(InputError, match="lags must be finite and not zero"):
        blind_frequencies(lag, 100.0)
