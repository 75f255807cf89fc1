"""Matching against exactly shifted textures: accuracy, bias, honesty of the covariance, refusals."""

import numpy as np
import pytest

from matching.fourier_textures import information_bounds, shifted_pair
from sightline.errors import EstimationError, InputError
from sightline.imaging.source import ArrayImage
from sightline.matching import matches
from sightline.matching.coarse import common_shift
from sightline.matching.match_images import match_images
from sightline.matching.select import grid_points
from sightline.matching.whitening import estimate_whitening

SHAPE = (384, 512)
SHIFT = np.array([0.37, -0.81])


@pytest.fixture(scope="module")
def pairs():
    """Pairs made once: (same or cross band, SNR) -> images and their whitening."""
    made = {}

    def pair(cross=False, snr=100.0, seed=1):
        key = (cross, snr, seed)
        if key not in made:
            a, b = (ArrayImage(x) for x in shifted_pair(SHAPE, tuple(SHIFT), snr=snr, seed=seed, cross=cross))
            points = inner_points((16, 40))
            made[key] = (a, b, estimate_whitening(a, b, points, points))
        return made[key]

    return pair


def inner_points(window, margin=24):
    inside = grid_points((SHAPE[0] - 2 * margin, SHAPE[1] - 2 * margin), window=window)
    return inside + margin


def errors(found, points, shift=SHIFT):
    return (found.b - points - shift)[found.kept]


@pytest.mark.parametrize(
    ("cross", "snr", "window", "limit"),
    [
        (False, 100, (10, 100), 1.15),
        (False, 200, (32, 32), 1.25),
        (True, 100, (10, 100), 1.25),
        (True, 100, (2, 100), 1.25),
    ],
)
def test_the_error_reaches_the_bound_of_information(pairs, cross, snr, window, limit):
    # rms of n independent errors has a relative standard deviation 1/sqrt(2 n): two axes of >= 132 windows
    # give 4.4 %; the limit is met within two of these
    a, b, whitening = pairs(cross, float(snr))
    points = inner_points(window)
    found = match_images(a, b, points, points + SHIFT, window=window, whitening=whitening)
    e = errors(found, points)
    assert len(e) == len(points)
    bound = information_bounds(SHAPE, window[0] * window[1], snr=snr, cross=cross)
    rms = np.sqrt((e**2).mean())
    assert rms <= (limit + 2 / np.sqrt(2 * e.size)) * bound["coherence" if cross else "gradient"]


@pytest.mark.parametrize(("cross", "window"), [(False, (10, 100)), (True, (10, 100)), (True, (2, 100))])
def test_the_covariance_is_that_of_the_errors(pairs, cross, window):
    a, b, whitening = pairs(cross)
    points = inner_points(window)
    found = match_images(a, b, points, points + SHIFT, window=window, whitening=whitening)
    e = errors(found, points)
    z = e / found.sigma_px[found.kept]
    # 15 % is the requirement; 1/sqrt(2 n) is what the sample itself is uncertain by (two of these)
    tolerance = 0.15 + 2 / np.sqrt(2 * len(e))
    assert np.abs(np.sqrt((z**2).mean(axis=0)) - 1).max() < tolerance


def test_there_is_no_bias_at_any_sub_pixel_phase():
    # SNR 400: one window is good to about 2 mpx; the mean of 144 to 0.2 mpx, so 1 mpx is five sigma
    for phase in (0.0, 0.25, 0.5, 0.75):
        shift = np.array([phase, -phase])
        a, b = (ArrayImage(x) for x in shifted_pair((256, 384), tuple(shift), snr=400.0, seed=7))
        points = grid_points((208, 336), window=(12, 50)) + 24
        found = match_images(a, b, points, np.rint(points + shift), window=(12, 50), whitening=None)
        assert np.abs(errors(found, points, shift).mean(axis=0)).max() < 1e-3


@pytest.mark.parametrize("reach", [(5, 5), (9, 14)])  # term by term, and by Fourier transform
def test_the_search_finds_shifts_of_several_pixels(pairs, reach):
    a, b, whitening = pairs(True)
    points = inner_points((10, 100))
    rng = np.random.default_rng(0)
    wrong = points + SHIFT + rng.integers(-4, 5, points.shape)
    found = match_images(a, b, points, wrong, search_px=reach, whitening=whitening)
    exact = match_images(a, b, points, points + SHIFT, whitening=whitening)
    assert found.kept.mean() > 0.98
    both = found.kept & exact.kept
    # the fits end within the tolerance of the last step (0.01 px, quadratic convergence) of each other
    assert np.abs(found.b - exact.b)[both].max() < 2e-3


def test_the_answer_does_not_depend_on_threads_nor_on_the_other_windows_of_the_call(pairs):
    a, b, whitening = pairs(True)
    points = inner_points((10, 100))
    one = match_images(a, b, points, points, search_px=(2, 2), whitening=whitening, threads=1)
    two = match_images(a, b, points, points, search_px=(2, 2), whitening=whitening, threads=2)
    for name in ("b", "covariance_px", "score", "status"):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=name != "status")
    part = match_images(a, b, points[40:60], points[40:60], search_px=(2, 2), whitening=whitening)
    assert np.nanmax(np.abs(part.b - one.b[40:60])) < 1e-4


def test_a_fractional_point_is_answered_for_itself(pairs):
    a, b, whitening = pairs()
    points = inner_points((10, 100))
    moved = points + np.array([0.3, -0.45])
    found = match_images(a, b, moved, moved + SHIFT, whitening=whitening)
    exact = match_images(a, b, points, points + SHIFT, whitening=whitening)
    assert np.abs((found.b - moved) - (exact.b - points)).max() < 1e-4


def rotated(image, degrees, zoom):
    """Another view of an image by spline interpolation: b(p) = a(matrix p + offset)."""
    from scipy import ndimage

    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    matrix = np.array([[c, -s], [s, c]]) / zoom
    centre = 0.5 * (np.array(image.shape) - 1)
    offset = centre - matrix @ centre
    return ndimage.affine_transform(image.astype(float), matrix, offset, order=5), matrix, offset


@pytest.mark.parametrize(("degrees", "zoom"), [(2.0, 1.0), (25.0, 0.9), (-80.0, 1.1)])
def test_large_affines_are_warped_and_the_covariance_is_in_pixels_of_b(degrees, zoom):
    a, _ = shifted_pair((384, 384), (0.0, 0.0), snr=200.0, seed=4)
    b, matrix, offset = rotated(a, degrees, zoom)
    # windows lie on whole pixels: what that moves a point by is turned with it
    points = grid_points((200, 200), window=(24, 24)) + np.array([92.3, 91.6])
    to_b = np.linalg.inv(matrix)
    truth = (points - offset) @ to_b.T
    affine = np.broadcast_to(to_b, (len(points), 2, 2))
    rng = np.random.default_rng(0)
    found = match_images(
        ArrayImage(a), ArrayImage(b), points, truth + rng.uniform(-0.4, 0.4, truth.shape), window=(24, 24),
        affine=affine, whitening=None, search_px=(1, 1),
    )  # fmt: skip
    e = found.b - truth
    assert found.kept.mean() > 0.98
    # the second view shares the first one's noise, so only interpolation errs: a few thousandths
    assert np.sqrt(np.nanmean(e**2)) < 0.005


def test_whitening_is_estimated_and_applied_through_a_large_affine():
    a, other = shifted_pair((420, 420), (0.0, 0.0), snr=300.0, seed=4, cross=True)
    b, matrix, offset = rotated(other, 30.0, 1.05)
    to_b = np.linalg.inv(matrix)
    points = grid_points((220, 220), window=(32, 32), step=(16, 16)) + 100
    truth = (points - offset) @ to_b.T
    affine = np.broadcast_to(to_b, (len(points), 2, 2))
    options = {"window": (32, 32), "affine": affine}
    plain = match_images(ArrayImage(a), ArrayImage(b), points, truth, whitening=None, **options)
    white = match_images(ArrayImage(a), ArrayImage(b), points, truth, whitening="auto", **options)
    e_plain, e_white = (np.sqrt(np.nanmean((m.b - truth) ** 2)) for m in (plain, white))
    # at rho 0.95 the bound is a third of what unwhitened windows reach; half is asked for
    assert e_white < 0.5 * e_plain
    assert white.kept.mean() > 0.98


def test_small_frames_are_whitened_too():
    a, b = (ArrayImage(x) for x in shifted_pair((100, 100), (0.3, 0.2), snr=100.0, seed=6, cross=True))
    points = grid_points((60, 60), window=(16, 16), step=(8, 8)) + 20
    found = match_images(a, b, points, points, window=(16, 16))
    assert found.kept.mean() > 0.9


def test_every_refusal_has_its_reason():
    rng = np.random.default_rng(5)
    a, b = shifted_pair((200, 300), (0.2, 0.1), snr=100.0, seed=2)
    a[40:80, 0:120] = 1000.0 + 10 * rng.standard_normal((40, 120))  # no texture: noise alone in both
    b[40:80, 0:120] = 1000.0 + 10 * rng.standard_normal((40, 120))
    a[100:130, 0:120] = 500.0  # constant
    b[100:130, 150:290] = 4095.0  # saturated
    unusable = np.zeros(a.shape, bool)
    unusable[150:170, 0:120] = True
    b[150:170, 170:290] = np.nan
    lines = [20.0, 2.0, 60.0, 115.0, 115.0, 160.0, 160.0, np.nan]
    points = np.column_stack([lines, [150.0, 150.0, 60.0, 60.0, 220.0, 60.0, 230.0, 50.0]])
    near = points + np.array([0.2, 0.1])
    found = match_images(
        ArrayImage(a, unusable), ArrayImage(b), points, near, whitening=None, saturation=4095.0
    )
    expected = [
        {matches.KEPT}, {matches.OUTSIDE}, {matches.LOW_SCORE, matches.NO_CONVERGENCE, matches.TEXTURELESS},
        {matches.TEXTURELESS}, {matches.SATURATED}, {matches.MASKED}, {matches.MASKED}, {matches.OUTSIDE},
    ]  # fmt: skip
    for status, allowed in zip(found.status, expected, strict=True):
        assert status in allowed
    assert np.isnan(found.b[[1, 3, 4, 5, 6, 7]]).all()


def test_noise_without_texture_is_hardly_ever_kept():
    rng = np.random.default_rng(8)
    a, b = (ArrayImage(rng.normal(1000, 10, (400, 400)).astype(np.float32)) for _ in range(2))
    for window in ((10, 100), (2, 100)):
        points = grid_points((360, 400), window=window) + np.array([20.0, 0.0])
        found = match_images(a, b, points, points, window=window, whitening=None)
        assert found.kept.mean() < 0.01


@pytest.mark.parametrize("angle", [0.0, 0.6, 1.2])
@pytest.mark.parametrize(("window", "search"), [((10, 100), (0, 0)), ((16, 16), (3, 3)), ((32, 32), (8, 8))])
def test_stripes_with_noise_of_their_own_are_hardly_ever_kept(angle, window, search):
    """Alike as a whole, with nothing along the stripes but noise, which agrees somewhere in every search."""
    rng = np.random.default_rng(9)
    y, x = np.mgrid[0:400, 0:400]
    frequencies = rng.uniform(0.005, 0.2, 60)
    phases = rng.uniform(0.0, 2.0 * np.pi, 60)

    def stripes(shift):
        across = np.cos(angle) * (x - shift[1]) + np.sin(angle) * (y - shift[0])
        waves = [
            np.cos(2.0 * np.pi * f * across + p) / (5.0 * f) for f, p in zip(frequencies, phases, strict=True)
        ]
        return ArrayImage((1000 + 20 * np.sum(waves, axis=0) + rng.normal(0, 10, x.shape)).astype(np.float32))

    a, b = stripes((0.0, 0.0)), stripes(SHIFT)
    points = grid_points((300, 300), window=window, step=(10, 25)) + 50.0
    found, refused = (
        match_images(a, b, points, points + np.rint(SHIFT), window=window, search_px=search, both_ways=both)
        for both in (False, True)
    )
    # noise passes in one window of a hundred; windows overlap, so that what passes comes several times
    assert refused.kept.mean() <= 0.05 < 0.1 < found.kept.mean()
    assert (refused.status[found.kept & ~refused.kept] == matches.TEXTURELESS).all()


def test_texture_in_both_directions_is_kept_both_ways(pairs):
    for cross, snr in ((False, 100.0), (True, 100.0)):
        a, b, whitening = pairs(cross, snr)
        points = inner_points((16, 40))
        found = match_images(
            a, b, points, points, window=(16, 40), search_px=(3, 3), whitening=whitening, both_ways=True
        )
        assert found.kept.all()


def test_a_cloud_under_a_mask_does_not_move_the_windows_beside_it(pairs):
    a, b, whitening = pairs(True)
    cloudy = b.array.copy()
    cloudy[150:200, 200:300] = 5000.0
    mask = np.zeros(cloudy.shape, bool)
    mask[150:200, 200:300] = True
    points = inner_points((10, 100))
    found = match_images(a, ArrayImage(cloudy, mask), points, points + SHIFT, whitening=whitening)
    assert found.counts()["masked"] > 0
    e = (found.b - points - SHIFT) / found.sigma_px
    beside = found.kept & (np.abs(points[:, 0] - 175) < 40) & (np.abs(points[:, 1] - 250) < 160)
    assert beside.sum() > 10
    # NEES of n pairs of unit normals: mean 2, standard deviation 2 / sqrt(n)
    assert (e[beside] ** 2).sum(axis=1).mean() < 2 + 6 / np.sqrt(beside.sum())


def test_gain_and_offset_between_the_images_do_not_matter(pairs):
    a, b, whitening = pairs()
    points = inner_points((10, 100))
    plain = match_images(a, b, points, points + SHIFT, whitening=whitening)
    other = match_images(a, ArrayImage(0.25 * b.array + 300), points, points + SHIFT, whitening=whitening)
    assert np.abs(plain.b - other.b).max() < 1e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points_a": np.zeros((2, 5))}, "did you mean points_a.T"),
        ({"predicted_b": np.zeros((4, 2))}, "same N for both"),
        ({"window": (1, 100)}, "at least 2 lines and 8 columns"),
        ({"affine": np.eye(2)}, "one matrix per point"),
        ({"search_px": (-1, 0)}, "0 or more pixels"),
        ({"whitening": "yes"}, '"auto", None or a Whitening'),
    ],
)
def test_wrong_arguments_are_named_with_what_is_allowed(change, words):
    image = ArrayImage(np.ones((50, 200)))
    given = {"points_a": np.full((3, 2), 25.0), "predicted_b": np.full((3, 2), 25.0), "whitening": None}
    given |= change
    with pytest.raises(InputError, match=words):
        match_images(image, image, given.pop("points_a"), given.pop("predicted_b"), **given)


def test_whitening_that_cannot_be_estimated_says_why():
    rng = np.random.default_rng(0)
    a, b = (ArrayImage(rng.normal(size=(200, 400))) for _ in range(2))
    points = grid_points((200, 400), window=(10, 50))
    with pytest.raises(EstimationError, match=r"coherence of .* check the predicted"):
        match_images(a, b, points, points)
    with pytest.raises(EstimationError, match="at least 8"):
        match_images(a, b, points[:3], points[:3])


def test_no_points_give_no_matches():
    image = ArrayImage(np.ones((50, 200)))
    assert len(match_images(image, image, np.zeros((0, 2)), np.zeros((0, 2)), whitening=None)) == 0


@pytest.mark.parametrize(
    ("search", "off"), [((12, 2), (11.3, -1.2)), ((2, 12), (1.2, -11.3))], ids=["lines", "columns"]
)
def test_a_search_reaches_as_far_along_each_axis_as_it_is_given(pairs, search, off):
    a, b, whitening = pairs()
    points = inner_points((16, 40))
    found = match_images(
        a, b, points, points + SHIFT + off, window=(16, 40), whitening=whitening, search_px=search
    )
    assert found.kept.mean() > 0.95
    assert np.abs(errors(found, points)).max() < 0.1
    short = match_images(
        a, b, points, points + SHIFT + off, window=(16, 40), whitening=whitening, search_px=search[::-1]
    )
    assert short.kept.mean() < 0.05


def test_windows_are_kept_up_to_the_largest_sigma_of_any_direction(pairs):
    a, b, whitening = pairs(snr=30.0)
    points = inner_points((16, 40))
    free = match_images(a, b, points, points + SHIFT, window=(16, 40), whitening=whitening)
    largest = np.sqrt(np.linalg.eigvalsh(free.covariance_px[free.kept])[:, 1])
    most = float(np.median(largest))
    held = match_images(a, b, points, points + SHIFT, window=(16, 40), whitening=whitening, max_sigma_px=most)
    # common factors of the covariance are learned from those that are kept: they may change by as much as
    # half of some hundred windows tell, a few per cent
    clear = np.abs(largest / most - 1.0) > 0.05
    np.testing.assert_array_equal(held.kept[free.kept][clear], (largest <= most)[clear])
    assert (largest[clear] <= most).mean() == pytest.approx(0.5, abs=0.2)


@pytest.mark.parametrize("bare", ["constant", "no data"])
def test_a_second_image_without_texture_where_it_is_searched_is_named(bare):
    texture = np.random.default_rng(1).normal(100.0, 5.0, (240, 240)).astype(np.float32)
    second = np.full_like(texture, 100.0 if bare == "constant" else np.nan)
    with pytest.raises(InputError, match="the second image has no texture within 20 px"):
        common_shift(ArrayImage(texture), ArrayImage(second), reach=20.0)
