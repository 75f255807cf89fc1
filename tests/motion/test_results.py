"""What a recovery says about its pairs, from a record written out by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from motion.strips import plain_star
from sightline.geometry.conjugate import predict_match
from sightline.geometry.trajectory import Motion
from sightline.matching.matches import KEPT, LOW_SCORE, MASKED, OUTSIDE
from sightline.motion.measure.stars import StarRecord
from sightline.motion.results import LineOfSight, without_common_ground
from sightline.motion.strip.strip import RecoverOptions


@pytest.fixture
def result() -> LineOfSight:
    """One hub, two partners, eight windows: the second partner matched nowhere."""
    star = plain_star(2, 4, 2, sigma=0.1)
    status = np.full((8, 2), KEPT, np.uint8)
    status[:, 0] = [OUTSIDE, MASKED, LOW_SCORE, KEPT, KEPT, KEPT, KEPT, KEPT]
    status[:, 1] = OUTSIDE
    residual = np.where((status == KEPT)[..., None], 1.0, np.nan)
    weight = np.ones((8, 2))
    weight[7, 0] = 0.0
    star = replace(star, residual_px=residual, weight=weight, correlation=np.diag([4.0, 4.0, 1.0, 1.0]))
    after = np.full((8, 2, 2), np.nan)
    after[3:8, 0] = [[0.3, -0.4], [0.3, 0.4], [-0.3, 0.4], [0.3, 0.4], [90.0, 90.0]]
    angles = np.zeros((3, 3))
    covariance = np.tile(np.diag([1.0, 4.0, 9.0]), (3, 1, 1))
    return LineOfSight(
        motion=Motion(np.arange(3.0), angles, covariance),
        absolute_sigma=np.full((3, 3), np.inf),
        hidden=np.zeros((3, 3, 0)),
        hidden_names=(),
        observed=np.ones(3, bool),
        scale=np.ones(3),
        ifov=5e-6,
        half_field=8e-4,
        statics=(),
        spectra=None,
        records=(StarRecord(star, status, np.ones((8, 2))),),
        before_px=(residual,),
        after_px=(after,),
        cameras=(),
        image_names=("a", "b", "c"),
        changes=(),
    )


def test_sigma_is_the_root_of_the_diagonal(result):
    assert_allclose(result.sigma, [[1.0, 2.0, 3.0]] * 3)


def test_a_motion_without_covariance_has_no_sigma(result):
    bare = replace(result, motion=Motion(np.arange(3.0), np.zeros((3, 3))))
    assert_allclose(bare.sigma, 0.0)


def test_windows_beyond_the_partner_were_not_tried_and_the_others_are_accounted_for(result):
    first, _ = result.pairs
    assert first.images == (0, 1)
    assert (first.tried, first.kept) == (7, 4)
    assert first.rejected == {"masked": 1, "low score": 1, "outlier": 1}
    assert first.tried == first.kept + sum(first.rejected.values())


def test_masked_windows_stay_masked_where_the_partner_has_ground_for_them(recovery):
    result, surface = recovery.result, recovery.acquisition.surface
    record = result.records[0]
    masked = replace(record, status=np.full_like(record.status, MASKED))
    said = without_common_ground(masked, result.cameras, surface, RecoverOptions().window).status
    star, lines = record.star, recovery.acquisition.bands[0].camera.lines
    for k, image in enumerate(star.images):
        found = predict_match(result.cameras[star.hub], result.cameras[image], surface, star.pixels)[:, 0]
        # a dozen lines from the ends no kernel reaches beyond them, whatever its size
        within, beyond = (found > 12) & (found < lines - 13), ~((found > 0) & (found < lines - 1))
        assert within.any() and beyond.any()
        assert (said[:, k][beyond] == OUTSIDE).all()
        columns = star.pixels[:, 1] == np.median(star.pixels[:, 1])
        assert (said[:, k][within & columns] == MASKED).all()


def test_figures_are_of_the_kept_windows_only(result):
    first, _ = result.pairs
    assert_allclose(first.rms_before_px, 1.0)
    # squares 0.09 and 0.16 by turns
    assert_allclose(first.rms_after_px, np.sqrt(0.125))
    # claimed 0.1 px, found to be twice that
    assert_allclose(first.sigma_px, 0.2)
    assert_allclose(first.lag, 0.02)


def test_residuals_are_compared_with_what_single_matches_err_by(result):
    # long means feel four times the variance claimed, single matches have twice along lines and half across
    (record,) = result.records
    single = np.tile(np.diag([2.0, 0.5]), (2, 1, 1))
    first, _ = replace(result, records=(replace(record, star=replace(record.star, single=single)),)).pairs
    assert_allclose(first.sigma_px, 0.1 * np.sqrt((2.0 + 0.5) / 2.0))


def test_a_pair_without_matches_has_no_figures(result):
    _, second = result.pairs
    assert (second.images, second.tried, second.kept) == ((0, 2), 0, 0)
    assert np.isnan([second.lag, second.rms_before_px, second.rms_after_px, second.sigma_px]).all()


def test_pairs_of_a_rendered_strip_leave_what_their_errors_allow(recovery):
    result: SimpleNamespace = recovery.result
    assert all(record.star.single is not None for record in result.records)
    for pair in result.pairs:
        assert pair.kept + sum(pair.rejected.values()) == pair.tried
        # the fit takes some of the errors away (a tenth, of hundreds of windows per node), weights of 3 to 5
        # sigma leave a little more than Gaussian; the matcher's sigma is corrected by the strip's scatter;
        # the few windows at the ends of a band scatter by chance, their rms of 2 n numbers by 1 / sqrt(4 n)
        slack = 0.3 + 3.0 / np.sqrt(4.0 * max(pair.kept, 1))
        assert 1.0 - slack < pair.rms_after_px / pair.sigma_px < 1.0 + slack
        assert pair.rms_before_px > 3 * pair.rms_after_px
