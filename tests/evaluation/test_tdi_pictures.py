"""A target imaged by chosen settings and by one: what is measured on it is what was predicted."""

from __future__ import annotations

import numpy as np
import pytest

from sightline.errors import InputError
from sightline.evaluation.tdi_pictures import column_group, flat_snr, strip_pictures
from sightline.imaging.mtf import aperture_mtf
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.report.tdi_page import WHITE, grey, pictures_section
from sightline.tdi.choose import choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid

APERTURE = (0.9, 0.9)


def choice(static=0.2):
    """Nine columns, the outer ones in a slip that blurs what the centre's setting takes."""
    x = np.linspace(-1.0, 1.0, 9)
    columns = ScanColumns(np.arange(9.0), 1.0 + 0.01 * x**2, np.radians(4.0 * x), np.full((9, 2), static))
    grid = TdiGrid(np.arange(3, 25), np.array([0.4, 0.6, 0.8, 1.0]))
    rules, detector = ChoiceRules(), TdiDetector(Exposure(2, 0.25), NoiseLaw(read=12.0))
    drift = DriftMtf(columns, grid, detector.exposure, rules)
    return choose_settings(drift, np.array([50.0, 200.0, 800.0]), grid, detector, rules)


@pytest.fixture(scope="module")
def pictures():
    return strip_pictures(choice(), aperture=APERTURE, signal=210.0)


def test_what_is_measured_is_what_was_predicted(pictures):
    crops = (*pictures.chosen, *pictures.single)
    for crop in crops:
        found, said = crop.measured, crop.predicted
        for k in range(2):
            # the magnitude of a small MTF is its noise: half a sigma more
            assert abs(found.mtf[k] - said.mtf[k]) < 4.5 * found.mtf_sigma[k] < 0.08
        assert abs(found.snr - said.snr) < 4.0 * found.snr_sigma < 0.15 * said.snr
    assert crops[0].radiance.shape == (184, 144)


def test_the_outer_columns_gain_by_their_own_setting(pictures):
    for outer in (0, 2):
        own, one = pictures.chosen[outer].measured, pictures.single[outer].measured
        assert own.mtf[0] > one.mtf[0] + 5.0 * np.hypot(own.mtf_sigma[0], one.mtf_sigma[0])
    # one image of the centre, which has its own setting in both
    assert pictures.chosen[1] is pictures.single[1]


def test_settings_are_those_of_the_nearest_signal(pictures):
    made = choice()
    assert [crop.group.stages for crop in pictures.chosen] == made.stages[[0, 4, 8], 1].tolist()
    assert {crop.group.stages for crop in pictures.single} == {int(made.stages[4, 1])}


def test_blur_and_aperture_have_the_static_mtf_of_the_choice():
    group = column_group(choice(0.2), 3, 3, 0, APERTURE)
    assert group.static_mtf(0.5, 0.0) == pytest.approx(0.2, rel=1e-12)
    assert group.static_mtf(0.0, 0.5) == pytest.approx(0.2, rel=1e-12)


def test_a_static_mtf_beyond_the_aperture_is_refused():
    alone = float(aperture_mtf(0.5, 0.9))
    assert column_group(choice(alone), 0, 0, 0, APERTURE).blur == pytest.approx((0.0, 0.0), abs=1e-6)
    with pytest.raises(InputError, match="is none of an aperture"):
        column_group(choice(alone + 0.01), 0, 0, 0, APERTURE)


def test_flat_snr_counts_what_columns_keep():
    rng = np.random.default_rng(0)
    flat = 100.0 + 2.0 * rng.normal(size=(300, 200)) + 3.0 * rng.normal(size=200)
    found, sigma = flat_snr(flat)
    # 200 columns hold most of the variance, 9 of 13
    assert sigma == pytest.approx(0.5 * found * 9.0 / 13.0 * np.sqrt(2.0 / 199.0), rel=0.1)
    assert found == pytest.approx(100.0 / np.sqrt(13.0), abs=4.0 * sigma)


class TestPage:
    def test_all_pictures_have_the_same_greys(self):
        picture = grey(np.array([[0.0, 0.5 * WHITE, WHITE, 5.0, -1.0]]))
        assert picture[0, :, 0].tolist() == [0, 128, 255, 255, 0]
        assert picture.shape == (1, 5, 3)

    def test_the_page_says_what_was_measured_and_predicted(self, pictures):
        html = "".join(map(str, pictures_section(pictures).parts))
        assert html.count('<img src="data:image/png;base64,') == 8
        crop = pictures.chosen[0]
        for words in (
            f"Column 0: {crop.group.stages} stages, Kt {crop.group.ratio:.2f}",
            f"across {crop.measured.mtf[0]:.3f} ± {crop.measured.mtf_sigma[0]:.3f}",
            f"(predicted {crop.predicted.snr:.0f})",
            "All columns by the setting of the centre column",
        ):
            assert words in html
