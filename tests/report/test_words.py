"""The plain words: numbers as people write them, hidden directions named, nothing claimed without ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sightline.report import words
from sightline.report.spectrum_figures import tones_of


@pytest.fixture
def said(recovery):
    tones = tones_of(recovery.summary["tones"])
    return " ".join(words.sentences(recovery.result, recovery.summary, tones)).replace("\u00a0", " ")


def test_numbers_have_significant_digits_and_no_exponent():
    assert words.digits(0.0069312, 2) == "0.0069"
    assert words.digits(223.4, 2) == "220"
    assert words.digits(1.0, 3) == "1"
    assert words.digits(float("inf"), 2) == "–"


def test_the_words_name_images_windows_axes_and_tones(said, recovery):
    matches = recovery.summary["matches"]
    assert f"compared in {matches['tried']:,} windows, of which {matches['kept']:,}" in said
    for axis in ("roll", "pitch", "yaw"):
        assert f"{axis} moved by" in said.lower()
    for axis, tones in recovery.summary["tones"].items():
        for tone in sorted(tones, key=lambda tone: -tone["amplitude"])[:4]:
            assert f"{tone['frequency']:.1f} Hz" in said.split("Tones")[1], axis


def test_what_is_hidden_is_said_with_what_it_means_for_the_files(said):
    assert "cannot show a constant of roll, pitch and yaw, a drift of roll, pitch and yaw" in said
    assert "sigma_absolute in motion.csv is infinite" in said


def test_a_hidden_part_that_is_tied_is_not_called_infinite(recovery):
    tied = replace(recovery.result, absolute_sigma=np.full_like(recovery.result.absolute_sigma, 1e-6))
    assert "other knowledge ties it" in " ".join(words.sentences(tied, recovery.summary, []))


def test_a_hidden_part_that_is_tied_in_one_axis_is_said_of_that_axis(recovery):
    sigma = np.full_like(recovery.result.absolute_sigma, np.inf)
    sigma[:, 1] = 1e-6
    said = " ".join(words.sentences(replace(recovery.result, absolute_sigma=sigma), recovery.summary, []))
    assert "ties it in pitch" in said and "not in roll and yaw, where it is infinite" in said


def test_without_tones_none_is_claimed(recovery):
    assert "No tone stands out" in " ".join(words.sentences(recovery.result, recovery.summary, []))


def test_a_motion_within_its_sigma_is_not_told_from_none(recovery, said):
    covariance = 1e6 * recovery.result.motion.covariance
    unknown = replace(recovery.result, motion=replace(recovery.result.motion, covariance=covariance))
    assert " ".join(words.sentences(unknown, recovery.summary, [])).count("not told from no motion") == 3
    assert "not told from no motion" not in said


def test_a_tone_that_is_hardly_seen_is_reported_as_such_and_how_large_it_may_be(recovery):
    tone = tones_of(recovery.summary["tones"])[0]
    scale = float(recovery.result.scale[0])
    doubtful = replace(tone, frequency=55.5, amplitude=0.2 * scale, sigma_amplitude=0.1 * scale)
    summary = {**recovery.summary, "tones_hardly_seen": {"roll": [vars(doubtful)], "pitch": [], "yaw": []}}
    said = " ".join(words.sentences(recovery.result, summary, [tone])).replace("\u00a0", " ")
    assert "there may be no tone, or a larger one: roll at 55.5 Hz (0.2 px)" in said
    first, second = words.tone_rows(recovery.result, [tone], [doubtful])
    assert "hardly seen" not in first[4]
    assert second[4] == "hardly seen: 0 to 0.4 px"


def test_the_words_say_from_which_frequency_tones_are_sought(said, recovery):
    start, end = recovery.result.motion.span
    lowest = f"{8.0 / (end - start):.3g} Hz, eight cycles in all"
    assert f"None is sought below {lowest}" in said
    without = " ".join(words.sentences(recovery.result, recovery.summary, [])).replace("\u00a0", " ")
    assert f"above {lowest}" in without


def test_the_tables_have_a_row_for_every_pair_static_and_tone(recovery):
    tones = tones_of(recovery.summary["tones"])
    assert len(words.tone_rows(recovery.result, tones)) == len(tones) >= 3
    assert len(words.static_rows(recovery.result)) == len(recovery.result.statics)
    tried = [pair for pair in recovery.result.pairs if pair.tried]
    assert len(words.pair_table(recovery.result)) == len(tried)


def test_where_only_constants_are_hidden_no_detector_line_is_blamed(recovery):
    result = replace(
        recovery.result,
        hidden=recovery.result.hidden[:, :, :3],
        hidden_names=recovery.result.hidden_names[:3],
    )
    said = " ".join(words.sentences(result, recovery.summary, []))
    assert "a constant of roll, pitch and yaw: a constant changes nothing between them; nothing given" in said
