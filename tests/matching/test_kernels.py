"""Each compiled kernel against plain numpy."""

import numpy as np
import pytest
from scipy import ndimage, signal

from sightline.compiled import only_read
from sightline.imaging.resample import delay_weights, kernel_table
from sightline.matching import kernels
from sightline.matching.correlate import correlation_surface

D = np.array([-0.045862, 0.158302, -0.359098, 0.926738])  # taps 4, 3, 2, 1 px away


def plain(function):
    """The Python body of a kernel, whether or not it is compiled."""
    return getattr(function, "py_func", function)


def full_taps(quadrant):
    k = np.abs(np.arange(-6, 7))
    return quadrant[np.ix_(k, k)]


def test_the_filter_is_a_convolution_with_the_unfolded_quadrant():
    rng = np.random.default_rng(0)
    image, taps = rng.normal(size=(25, 40)).astype(np.float32), rng.normal(size=(7, 7)).astype(np.float32)
    out = np.empty_like(image)
    kernels.filter_image(image, *only_read(taps), out)
    expected = signal.convolve2d(image, full_taps(taps), mode="same")
    assert np.abs(out - expected)[6:-6, 6:-6].max() < 1e-4 * np.abs(expected).max()
    assert not out[:6].any() and not out[:, -6:].any()


def test_the_derivative_taps_are_the_best_for_the_band_and_exact_at_low_frequency():
    f = np.linspace(0, 0.38, 400)
    columns = 2 * np.sin(2 * np.pi * np.outer(f, [1, 2, 3, 4]))
    slope = 2.0 * np.array([1, 2, 3, 4])
    system = np.block([[columns.T @ columns, slope[:, None]], [slope, np.zeros(1)]])
    best = np.linalg.solve(system, np.r_[columns.T @ (2 * np.pi * f), 1.0])[:4]
    assert np.abs(best - D[::-1]).max() < 1e-4


def reference_fit(fa, fb, corner, centre, size, shift):
    """One evaluation of the normal equations in float64, by other means: separable filters of scipy."""
    h, w = size
    i, j = corner
    y, x = centre + shift - 0.5 * (np.array(size) - 1) - 4
    iy, ix = int(np.floor(y)), int(np.floor(x))
    wy, wx = delay_weights(np.array([y - iy, x - ix]))
    region = fb[iy - 3 : iy + 5 + h + 7, ix - 3 : ix + 5 + w + 7].astype(float)
    b = ndimage.correlate1d(ndimage.correlate1d(region, wy, axis=0, origin=-1), wx, axis=1, origin=-1)
    b = b[3 : 3 + h + 8, 3 : 3 + w + 8]
    a = fa[i - 4 : i + h + 4, j - 4 : j + w + 4].astype(float)
    line = np.r_[-D, 0, D[::-1]]
    inner = (slice(4, -4), slice(4, -4))
    gradients = [[ndimage.correlate1d(p, line, axis=k)[inner].ravel() for k in (0, 1)] for p in (a, b)]
    va, vb = a[inner].ravel(), b[inner].ravel()
    va, vb = va - va.mean(), vb - vb.mean()
    gain = np.sqrt((va @ va) / (vb @ vb))
    ga, gb = np.array(gradients[0]), gain * np.array(gradients[1])
    g, r = 0.5 * (ga + gb), va - gain * vb
    h0 = 0.5 * (ga @ gb.T + gb @ ga.T)
    offset, level = g.sum(axis=1), gain * g @ vb
    curvature = h0 - np.outer(offset, offset) / len(va) - np.outer(level, level) / (va @ va)
    by_column = np.stack([g * r, g * g]).reshape(2, 2, h, w).sum(axis=2)
    correlation = (va @ vb) / np.sqrt(va @ va * (vb @ vb))
    return curvature, g @ r, g @ g.T, r @ r / (len(va) - 4), correlation, block_variances(*by_column)


def block_variances(score, squares):
    """Variance of scores (2, columns) by blocks and their neighbours, and how much of it a fit leaves."""
    width = score.shape[1]
    count = min(5, max(3, width // 4))
    edges = [width * q // count for q in range(count)]
    score, squares = (np.add.reduceat(part, edges, axis=1) for part in (score, squares))
    share = squares / squares.sum(axis=1, keepdims=True)
    left = score - share * score.sum(axis=1, keepdims=True)
    near = np.eye(count) + np.eye(count, k=1) + np.eye(count, k=-1)
    return [(z @ near @ z, 1.0 - p @ near @ p) for z, p in zip(left, share, strict=True)]


def refine(fa, fb, corner, centre, size, function=kernels.refine_windows, **options):
    n = len(corner)
    out = np.empty((n, kernels.COLUMNS))
    none = np.zeros((0, 0), np.bool_)
    function(
        fa, fb, options.get("bad_a", none), options.get("bad_b", none), corner, centre,
        options.get("linear", np.zeros((n, 2, 2))), options.get("start", np.zeros((n, 2))), size,
        kernel_table(), options.get("parts", 1), 12, options.get("tolerance", 0.01), 1.5, out,
    )  # fmt: skip
    return out


@pytest.fixture(scope="module")
def smooth_pair():
    rng = np.random.default_rng(3)
    fa = ndimage.gaussian_filter(rng.normal(size=(60, 160)), 1.2).astype(np.float32)
    fb = ndimage.shift(fa.astype(float), (0.3, -0.2), order=5, mode="mirror") * 1.3 + 0.1
    return fa, (fb + 0.003 * rng.normal(size=fb.shape)).astype(np.float32)


@pytest.mark.parametrize("size", [(10, 100), (16, 16), (3, 41)])
def test_the_fit_equals_the_plain_numpy_equations(smooth_pair, size):
    fa, fb = smooth_pair
    corner = np.array([[22, 25]])
    centre = corner + 0.5 * (np.array(size) - 1) + np.array([0.285, -0.19])
    # a tolerance above any step ends the fit after its first evaluation, at shift zero
    got = refine(fa, fb, corner, centre, size, tolerance=1e9)[0]
    assert got[14] == 1
    curvature, score, spread, variance, correlation, blocks = reference_fit(
        fa, fb, corner[0], centre[0], size, np.zeros(2)
    )
    step = np.linalg.solve(curvature, score)
    variance -= step @ score / (size[0] * size[1] - 4)
    assert np.abs(got[:2] - step).max() < 1e-3
    scale = np.abs(curvature).max()
    assert np.abs([[got[2], got[3]], [got[3], got[4]]] - curvature).max() < 2e-3 * scale
    assert np.abs([[got[5], got[6]], [got[6], got[7]]] - spread).max() < 2e-3 * scale
    assert got[8] == pytest.approx(variance, rel=0.02)
    assert got[9] == pytest.approx(correlation, abs=2e-4)
    # scores are sums of residuals, of which interpolation makes as much as of their variance
    assert got[10:14].reshape(2, 2)[:, 1] == pytest.approx([share for _, share in blocks], abs=2e-3)
    assert got[10:14].reshape(2, 2)[:, 0] == pytest.approx([value for value, _ in blocks], rel=0.05)


def test_values_and_derivatives_of_a_window_are_those_of_nine_taps():
    """By the compiled loop and by its Python body, of which the slices must end where they do."""
    image = np.random.default_rng(5).normal(size=(22, 31)).astype(np.float32)
    line, inside = np.r_[-D, 0.0, D[::-1]], (slice(6, 11), slice(9, 22))
    expected = [
        image.astype(float),
        *(ndimage.correlate1d(image.astype(float), line, axis=k) for k in (0, 1)),
    ]
    for function in (kernels._gradients, plain(kernels._gradients)):
        found = np.full((3, 5 * 13), np.nan, np.float32)
        function(image, np.int64(6), np.int64(9), 5, 13, *found)
        # eight products of numbers up to 4 in single precision
        np.testing.assert_allclose(found.reshape(3, 5, 13), [one[inside] for one in expected], atol=5e-6)


def test_the_compiled_fit_equals_its_python_body(smooth_pair):
    # the same code without the compiler: what NUMBA_DISABLE_JIT would run
    fa, fb = smooth_pair
    corner = np.array([[22, 25]])
    centre = corner + np.array([2.0, 11.5])
    compiled = refine(fa, fb, corner, centre, (5, 24))
    python = refine(fa, fb, corner, centre, (5, 24), function=plain(kernels.refine_windows))
    assert np.abs(compiled[0, :2] - python[0, :2]).max() < 1e-4
    assert np.allclose(compiled[0, 2:14], python[0, 2:14], rtol=5e-3, atol=1e-6)


def test_a_window_of_unusable_pixels_is_outside(smooth_pair):
    # a search may lead to where nothing of the other image can be used
    fa, fb = smooth_pair
    corner = np.array([[22, 25]])
    got = refine(fa, fb, corner, corner + np.array([2.0, 11.5]), (5, 24), bad_b=np.ones(fb.shape, np.bool_))
    assert got[0, 14] == -1.0


def test_column_parts_follow_an_affine_that_changes_along_the_window(smooth_pair):
    # b is a, sheared: lines move by 0.003 px per column; the fit at the centre must not see it
    fa, _ = smooth_pair
    y, x = np.mgrid[0:60, 0:160].astype(float)
    shear = 0.003
    fb = ndimage.map_coordinates(fa.astype(float), [y - shear * (x - 79.5), x], order=5, mode="mirror")
    linear = np.array([[[0.0, shear], [0.0, 0.0]]])
    corner = np.array([[25, 30]])
    centre = np.array([[29.5, 79.5]])
    many = refine(fa, fb.astype(np.float32), corner, centre, (10, 100), linear=linear, parts=10)
    # parts of 10.6 columns leave +-0.016 px inside a part; their effect averages out below a thousandth
    assert np.abs(many[0, :2]).max() < 2e-3
    assert many[0, 9] > refine(fa, fb.astype(np.float32), corner, centre, (10, 100))[0, 9]


def test_masked_pixels_do_not_count(smooth_pair):
    fa, fb = smooth_pair
    corner, centre = np.array([[22, 25]]), np.array([[26.5, 74.5]])
    good = refine(fa, fb, corner, centre, (10, 100))
    spoilt = fb.copy()
    spoilt[24:29, 60:66] += 5.0
    bad = np.zeros(fb.shape, np.bool_)
    bad[18:35, 54:72] = True  # what the spoilt pixels reach through interpolation and derivative
    same = refine(fa, spoilt, corner, centre, (10, 100), bad_b=bad)
    clean = refine(fa, fb, corner, centre, (10, 100), bad_b=bad)
    # untouched pixels only: equal to float32 rounding
    assert np.abs(same[0, :2] - clean[0, :2]).max() < 1e-4
    assert np.abs(same[0, :2] - good[0, :2]).max() < 0.02


def test_a_constant_window_has_no_texture_and_a_window_at_the_border_left_the_image(smooth_pair):
    fa, fb = smooth_pair
    flat = np.zeros_like(fa)
    corner = np.array([[22, 25]])
    assert refine(flat, fb, corner, np.array([[26.5, 74.5]]), (10, 100))[0, 14] == -2
    assert refine(fa, fb, corner, np.array([[6.0, 74.5]]), (10, 100))[0, 14] == -1


def test_warping_by_an_affine_equals_sampling_its_positions(smooth_pair):
    fa, _ = smooth_pair
    linear = np.array([[[0.05, -0.3], [0.28, -0.04]]])
    out, outside = np.zeros((9, 11), np.float32), np.zeros((9, 11), np.bool_)
    kernels.warp_windows(fa, np.array([[30.2, 80.7]]), linear, (9, 11), kernel_table(), out, outside)
    uy, ux = np.mgrid[-4:5, -5:6].astype(float)
    place = np.stack([30.2 + uy + 0.05 * uy - 0.3 * ux, 80.7 + ux + 0.28 * uy - 0.04 * ux])
    expected = ndimage.map_coordinates(fa.astype(float), place, order=5)
    assert not outside.any()
    # two interpolators of a smooth image: each within a percent of its std (0.24)
    assert np.abs(out - expected).max() < 0.01


def test_window_curvature_is_the_sum_of_gradient_products():
    rng = np.random.default_rng(2)
    image = rng.normal(size=(20, 30)).astype(np.float32)
    out = np.empty((1, 3))
    kernels.window_curvature(*only_read(image), np.array([[3, 4]]), (8, 12), out)
    gy, gx = (g[3:11, 4:16] for g in np.gradient(image.astype(float)))
    assert np.allclose(out[0], [(gy * gy).sum(), (gy * gx).sum(), (gx * gx).sum()], rtol=1e-4)


def test_correlation_term_by_term_equals_that_by_fourier_transform():
    rng = np.random.default_rng(6)
    fa, fb = (rng.normal(size=(40, 60)).astype(np.float32) for _ in range(2))
    corner, low = np.array([[5, 7], [20, 30]]), np.array([[3, 4], [18, 25]])
    out = np.empty((2, 5, 7), np.float32)
    kernels.correlate_windows(fa, fb, corner, low, (8, 20), out)
    regions = np.stack([fb[i : i + 12, j : j + 26] for i, j in low])
    windows = np.stack([fa[i : i + 8, j : j + 20] for i, j in corner])
    assert np.abs(out - correlation_surface(windows, regions)).max() < 1e-5
    plain_value = np.corrcoef(windows[1].ravel(), fb[20:28, 29:49].ravel())[0, 1]
    assert out[1, 2, 4] == pytest.approx(plain_value, abs=1e-5)


@pytest.mark.parametrize(
    "start", [(0.0, 0.0), (3.0, -4.0)], ids=["where it is expected", "where search led to"]
)
def test_a_mask_of_the_other_image_lies_where_the_window_does(smooth_pair, start):
    """Half the window's pixels masked in either image, shifts whole: the same pixels are left."""
    fa, fb = smooth_pair
    corner = np.array([[22, 25]])
    centre = np.array([[27.5, 76.5]]) - start  # a line down and two columns to the right in b
    bad = np.random.default_rng(0).random(fa.shape) < 0.5
    other, moved = (np.roll(one, (1, 2), axis=(0, 1)) for one in (fb, bad))
    by_own, by_other = (
        refine(fa, other, corner, centre, (10, 100), start=np.array([start]), **mask)
        for mask in ({"bad_a": bad}, {"bad_b": moved})
    )
    assert np.isfinite(by_own).all() and np.array_equal(by_own, by_other)
