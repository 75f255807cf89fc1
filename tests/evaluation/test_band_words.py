"""Passbands as text."""

from __future__ import annotations

from sightline.evaluation.band_words import passband_words
from sightline.motion.observability import passbands


def test_a_single_lag_is_described_by_its_blind_frequencies():
    bands = passbands(0.15, 500.0, k=0.001)
    # gaps of 2 asin(sqrt(k) / 2) / (pi lag) = 0.067 Hz at multiples of 1 / 0.15 s
    low, high = f"{bands[0][0]:.4g}", f"{bands[-1][1]:.4g}"
    assert passband_words(bands) == f"{low}–{high} Hz but for gaps of 0.067 Hz at multiples of 6.67 Hz"


def test_irregular_gaps_are_counted():
    bands = [(1.0, 5.0), (5.5, 17.0), (18.0, 21.0), (22.0, 90.0)]
    assert passband_words(bands) == "1–5, 5.5–17, 22–90 Hz and 1 narrower"


def test_few_bands_are_given_by_their_ends():
    assert passband_words([]) == "nowhere"
    assert passband_words([(2.0, 9.9), (10.1, 19.9), (20.1, 30.0)]) == "2–9.9, 10.1–19.9, 20.1–30 Hz"


def test_gaps_of_many_widths_are_described_by_the_median_and_the_widest():
    bands = [(1.0, 9.5), (10.5, 19.9), (20.1, 29.4), (30.6, 40.0)]
    assert passband_words(bands) == "1–40 Hz but for gaps of 1 Hz (at most 1.2 Hz) at multiples of 10 Hz"
