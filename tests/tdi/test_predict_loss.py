"""Predicted loss of a choice, and merits of draws, on columns written out by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.errors import InputError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import choose_settings
from sightline.tdi.merit import DriftMtf, column_factors, robust_merit
from sightline.tdi.predict_loss import predict_loss
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid

GRID = TdiGrid(np.array([4, 16]), np.array([1.0]))
DETECTOR = TdiDetector(Exposure(), NoiseLaw(0.0, 1.0, 0.0))
SIGNALS = np.array([100.0])
#: MTF across of 4 and 16 stages: two draws of two lines each. SNR doubles from 4 to 16 stages.
ACROSS = np.array([[1.0, 0.9], [0.8, 0.7], [0.6, 0.1], [0.6, 0.2]])


@dataclass(frozen=True)
class ByHand:
    columns: ScanColumns
    nodes_per_draw: int = 2

    def central(self, which):
        return self.drawn(which).mean(axis=0)

    def drawn(self, which):
        across = np.tile(ACROSS[:, None], (1, len(self.columns), 1))[:, which]
        return np.stack([across, np.ones_like(across)], axis=-1)

    def robust_merit(self, which, rules):
        return robust_merit(self, which, rules)


def columns(count=1):
    return ScanColumns(np.arange(float(count)), np.ones(count), np.zeros(count), np.ones((count, 2)))


def test_a_draw_is_the_mean_of_its_lines():
    """Strips: (0.9, 0.8) and (0.6, 0.15); the mean of both, and the lower quartile between them."""
    model = ByHand(columns())
    mean = column_factors(model, slice(0, 1), GRID, ChoiceRules(merit="x")).merit
    assert_allclose(mean, [[0.75, 0.475]])
    low = column_factors(model, slice(0, 1), GRID, ChoiceRules(merit="x", quantile=0.25)).merit
    assert_allclose(low, [[0.6 + 0.25 * 0.3, 0.15 + 0.25 * 0.65]])


def test_loss_is_what_each_draw_would_have_given_more():
    """16 stages are worth twice their MTF: chosen by the mean (0.95 to 0.75), lost where 0.3 falls to 0.6."""
    model, rules = ByHand(columns()), ChoiceRules(merit="x")
    choice = choose_settings(model, SIGNALS, GRID, DETECTOR, rules)
    assert choice.stages.tolist() == [[16]]
    loss = predict_loss(choice, model)
    assert_allclose(loss.draws[:, 0, 0], [0.0, 0.5], atol=1e-12)
    assert loss.mean[0, 0] == pytest.approx(0.25)
    assert loss.upper(0.95)[0, 0] == pytest.approx(0.475)


def test_a_setting_that_is_not_allowed_is_no_rival():
    model, rules = ByHand(columns()), ChoiceRules(merit="x", mtf_min=0.5)
    choice = choose_settings(model, SIGNALS, GRID, DETECTOR, rules)
    assert choice.stages.tolist() == [[4]]  # 16 stages have 0.475
    assert_allclose(predict_loss(choice, model).draws, 0.0)


def test_robust_choice_gives_up_less_where_it_may_go_wrong():
    """The quartile strip has 0.675 and 0.3125: 4 stages, which lose 0.9/1.6 at the first draw at most."""
    model, rules = ByHand(columns()), ChoiceRules(merit="x", quantile=0.25)
    choice = choose_settings(model, SIGNALS, GRID, DETECTOR, rules)
    assert choice.stages.tolist() == [[4]]
    assert_allclose(predict_loss(choice, model).draws[:, 0, 0], [1.0 - 0.9 / 1.6, 0.0], atol=1e-12)


def test_what_is_known_loses_nothing_and_other_columns_are_refused():
    rules = ChoiceRules()
    exact = DriftMtf(columns(5), GRID, DETECTOR.exposure, rules)
    choice = choose_settings(exact, SIGNALS, GRID, DETECTOR, rules)
    loss = predict_loss(choice, exact)
    assert loss.column.tolist() == [0.0, 2.0, 4.0]
    assert_allclose(loss.draws, 0.0)
    with pytest.raises(InputError, match="columns mismatch: the choice has 5 columns, the model 1"):
        predict_loss(choice, DriftMtf(columns(), GRID, DETECTOR.exposure, rules))
