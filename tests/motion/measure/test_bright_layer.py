"""What brightness tells of clouds, against drawn strips of which every cloudy window is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sightline.motion.measure.bright_layer import RowShifts, bright_windows, sum_along, sum_beside

ROWS, BLOCKS, STEP, SIGMA = 300, 7, 4.0, 0.03
GROUND, SPREAD, CLOUD = 1400.0, 150.0, 3100.0
#: px by which a metre of height shifts: 10 m pixels, two bands a tenth of a second apart at 786 km.
PER_METRE = 1e-5

Flags = NDArray[np.bool_]
Array = NDArray[np.float64]


def strip(seed: int, cloudy: Flags, departure: float = 12 * SIGMA) -> tuple[RowShifts, Array]:
    """Rows that move as they like, windows under clouds by `departure` more; and their brightness."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-0.86, 0.86, BLOCKS)
    level, slope = 3.0 * rng.standard_normal((2, ROWS, 1, 2))
    value = level + slope * x[:, None] + SIGMA * rng.standard_normal((ROWS, BLOCKS, 2))
    value[cloudy, 0] -= departure
    brightness = np.where(cloudy, CLOUD, GROUND) + SPREAD * rng.standard_normal((ROWS, BLOCKS))
    shifts = RowShifts(x, value, np.full(value.shape, SIGMA**2), np.ones(cloudy.shape, dtype=bool))
    return shifts, brightness


def scattered() -> Flags:
    """Clouds over five windows of seven in one place, and over two or three all along."""
    cloudy = np.zeros((ROWS, BLOCKS), dtype=bool)
    for k, first in enumerate(range(0, ROWS - 20, 30)):
        cloudy[first : first + 15, k % 5 : k % 5 + 2] = True
    cloudy[100:140, 1:6] = True
    return cloudy


def test_clouds_that_fill_most_of_a_row_are_found_by_what_is_seen_elsewhere():
    cloudy = scattered()
    got, tells = bright_windows(*strip(1, cloudy), np.ones(cloudy.shape, dtype=bool), STEP, PER_METRE)
    assert tells and got[cloudy].all()
    # of the ground 0.6 % is beyond 2.5 sigma, and costs its two neighbours above and below; clouds theirs
    away = sum_along(cloudy.astype(float), 2) == 0
    assert got[away].mean() < 0.05
    assert not got[100:140][:, [0, 6]].all(axis=0).any()


@pytest.mark.parametrize("departure", [12 * SIGMA, -12 * SIGMA])
def test_which_way_clouds_shift_does_not_matter(departure):
    cloudy = scattered()
    matched = np.ones(cloudy.shape, dtype=bool)
    got, tells = bright_windows(*strip(2, cloudy, departure), matched, STEP, PER_METRE)
    assert tells and got[cloudy].all()


def test_bright_ground_that_moves_with_the_rest_is_believed():
    cloudy = scattered()
    matched = np.ones(cloudy.shape, dtype=bool)
    # one strip of plain ground in 150 gets beyond CERTAIN by chance: of five none
    for seed in range(3, 8):
        got, tells = bright_windows(*strip(seed, cloudy, 0.0), matched, STEP, PER_METRE)
        assert not tells and not got.any()


def test_a_difference_too_small_to_matter_is_no_cloud():
    cloudy = scattered()
    matched = np.ones(cloudy.shape, dtype=bool)
    # 700 windows against 1400, lines removed: known to about sigma / 20, 0.4 sigma is eight standard errors
    assert not bright_windows(*strip(12, cloudy, 0.4 * SIGMA), matched, STEP, PER_METRE)[1]
    assert bright_windows(*strip(12, cloudy, 0.7 * SIGMA), matched, STEP, PER_METRE)[1]


def test_bright_ground_that_departs_by_less_than_a_low_cloud_is_ground():
    cloudy = scattered()
    matched = np.ones(cloudy.shape, dtype=bool)
    # textures of unlike colour err alike, by 30 standard errors; a cloud 40 m or 1000 m high shifts as much
    for height, cloud in ((40.0, False), (1000.0, True)):
        shifts, brightness = strip(13, cloudy, 1.5 * SIGMA)
        got, tells = bright_windows(shifts, brightness, matched, STEP, 1.5 * SIGMA / height)
        assert tells == cloud and got[cloudy].all() == cloud


def test_bright_windows_that_depart_in_one_place_alone_are_left_out_there_and_prove_nothing():
    cloudy = np.zeros((ROWS, BLOCKS), dtype=bool)
    cloudy[100:130, 1:4] = True
    got, tells = bright_windows(*strip(9, cloudy), np.ones(cloudy.shape, dtype=bool), STEP, PER_METRE)
    assert not tells and got[cloudy].all()
    # ABOUT: 20 rows from white, and of the ground there 0.6 % in its own rows and two beside
    assert not got[:78].any() and not got[152:].any()
    assert got[78:98].mean() < 0.15 and got[132:152].mean() < 0.15


class TestWhiteRows:
    """Rows that are white from side to side, or not at all: they may move as they like."""

    @pytest.mark.parametrize("blocks", [1, 2, 3])
    def test_are_not_believed_where_no_row_compares(self, blocks):
        cloudy = np.zeros((ROWS, blocks), dtype=bool)
        cloudy[100:140] = True
        shifts, brightness = strip(11, np.repeat(cloudy[:, :1], BLOCKS, axis=1))
        shifts = RowShifts(
            shifts.x[:blocks], shifts.value[:, :blocks], shifts.variance[:, :blocks], shifts.seen[:, :blocks]
        )
        got, _ = bright_windows(shifts, brightness[:, :blocks], shifts.seen, STEP, PER_METRE)
        assert got[cloudy].all()
        assert not got[:78].any() and not got[162:].any()

    def test_are_believed_where_others_say_that_white_lies_as_low_as_the_rest(self):
        cloudy = scattered()
        cloudy[180:190] = True
        shifts, brightness = strip(12, cloudy, departure=0.0)
        got, tells = bright_windows(shifts, brightness, shifts.seen, STEP, PER_METRE)
        assert not tells and not got.any()

    @pytest.mark.parametrize(("blocks", "cloudy"), [(3, False), (BLOCKS, True), (BLOCKS, False)])
    def test_of_a_star_that_is_all_white_are_known_by_the_rest_of_the_strip(self, blocks, cloudy):
        whole, brightness = strip(13, np.zeros((ROWS, BLOCKS), dtype=bool))
        brightness[120:] += CLOUD - GROUND  # three fifths; it may be land beside water
        some = slice(200, 240), slice(0, blocks)
        shifts = RowShifts(whole.x[:blocks], whole.value[some], whole.variance[some], whole.seen[some])
        alone, _ = bright_windows(shifts, brightness[some], shifts.seen, STEP, PER_METRE)
        assert not alone.any()
        everywhere = brightness[::5].ravel()
        got, _ = bright_windows(
            shifts, brightness[some], shifts.seen, STEP, PER_METRE, everywhere, cloudy=cloudy
        )
        assert (got == (cloudy or blocks == 3)).all()

    @pytest.mark.parametrize("per_metre", [PER_METRE, PER_METRE / 10])
    def test_are_believed_in_rows_long_enough_to_tell_that_do_not(self, per_metre):
        cloudy = np.zeros((ROWS, BLOCKS), dtype=bool)
        cloudy[100:190] = True  # as straight as a border can be: none of its rows compares
        shifts, brightness = strip(14, cloudy, departure=0.0)
        got, _ = bright_windows(shifts, brightness, shifts.seen, STEP, per_metre)
        assert not got.any()


class TestFlatWhite:
    """A bank from side to side: in its midst nothing is matched, its edges depart alike."""

    def bank(self, level: float = CLOUD) -> Flags:
        shifts, brightness = strip(10, np.zeros((ROWS, BLOCKS), dtype=bool))
        brightness[120:190] = level
        # edges of six rows: half cloud
        brightness[114:120] = brightness[190:196] = 0.5 * (GROUND + level)
        matched = np.ones((ROWS, BLOCKS), dtype=bool)
        matched[120:190] = False
        seen = RowShifts(shifts.x, shifts.value, shifts.variance, matched)
        got, tells = bright_windows(seen, brightness, matched, STEP, PER_METRE)
        assert not tells  # not of the rest of the strip
        return got

    def test_bright_windows_at_its_edge_are_not_believed(self):
        got = self.bank()
        assert got[112:198].all()

    def test_ground_beyond_its_edge_is(self):
        got = self.bank()
        # ABOUT: 20 rows from white; of these some bright ground and its neighbours, elsewhere nothing
        assert not got[:90].any() and not got[220:].any()
        assert got[90:110].mean() < 0.15 and got[200:220].mean() < 0.15

    def test_dark_water_costs_nothing(self):
        assert not self.bank(GROUND - 4 * SPREAD).any()


def test_unknown_brightness_tells_nothing():
    cloudy = scattered()
    shifts, brightness = strip(11, cloudy)
    matched = np.ones(cloudy.shape, dtype=bool)
    got, tells = bright_windows(shifts, np.full(cloudy.shape, np.nan), matched, STEP, PER_METRE)
    assert not tells and not got.any()
    brightness[::2] = np.nan
    got, tells = bright_windows(shifts, brightness, matched, STEP, PER_METRE)
    assert got[1::2][cloudy[1::2]].all()


def test_sums_stop_at_the_ends_and_sides():
    ones = np.ones((5, 3))
    assert sum_along(ones, 1)[:, 0].tolist() == [2, 3, 3, 3, 2]
    assert sum_beside(ones)[0].tolist() == [2, 3, 2]
