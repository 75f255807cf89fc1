"""Compiled inner loops of matching: the whitening filter, the warp and the Gauss-Newton fit of one window.

All are float32, release the interpreter lock and treat windows one by one, so that results do not depend on
the number of threads. Not their meaning: see `whitening`, `patches` and `correlate`.
"""

from __future__ import annotations

import numpy as np

from sightline.compiled import njit
from sightline.imaging.resample import fill_weights, sample_at

__all__ = [
    "BLOCKS",
    "COLUMNS",
    "correlate_windows",
    "filter_image",
    "refine_windows",
    "warp_windows",
    "window_curvature",
]

RADIUS = 6
"""Half-size of the whitening filter: 13 x 13 taps."""

HALO = 4
"""Half-size of the derivative filter."""

BLOCKS = 5
"""Most column blocks of a window for the error estimate."""

COLUMNS = 15
"""Numbers per window that `refine_windows` returns."""

# least-squares best 9-tap derivative up to 0.38 cycle/px, exact slope at 0 (checked in the tests). Fewer taps
# or a lower band fall short where whitening lifts: the curvature then comes out up to 10 % too small.
_D1, _D2 = np.float32(0.926738), np.float32(-0.359098)
_D3, _D4 = np.float32(0.158302), np.float32(-0.045862)


@njit(cache=True, nogil=True, fastmath=True)
def filter_image(image, taps, out):  # type: ignore[no-untyped-def]
    """Convolve with 13 x 13 taps that are symmetric along both axes; the 6 px border of `out` is set to zero.

    `taps` (7, 7): the quadrant, [0, 0] the centre.
    """
    lines, columns = image.shape
    fold = np.empty(columns, np.float32)
    for r in range(lines):
        line = out[r]
        line[:] = np.float32(0.0)
        if r < 6 or r >= lines - 6:
            continue
        for k in range(7):
            if k == 0:
                for c in range(columns):
                    fold[c] = image[r, c]
            else:
                up, down = image[r - k], image[r + k]
                for c in range(columns):
                    fold[c] = up[c] + down[c]
            t0, t1, t2, t3 = taps[k, 0], taps[k, 1], taps[k, 2], taps[k, 3]
            t4, t5, t6 = taps[k, 4], taps[k, 5], taps[k, 6]
            for c in range(6, columns - 6):
                line[c] += (
                    t0 * fold[c]
                    + t1 * (fold[c - 1] + fold[c + 1])
                    + t2 * (fold[c - 2] + fold[c + 2])
                    + t3 * (fold[c - 3] + fold[c + 3])
                    + t4 * (fold[c - 4] + fold[c + 4])
                    + t5 * (fold[c - 5] + fold[c + 5])
                    + t6 * (fold[c - 6] + fold[c + 6])
                )


@njit(cache=True, nogil=True, fastmath=True)
def correlate_windows(fa, fb, corner, low, size, out):  # type: ignore[no-untyped-def]
    """Normalised correlation of every window of `fa` with each place of its region of `fb`, term by term.

    `corner`, `low` (N, 2): first line and column of the window in `fa`, of the region in `fb`; `out`
    (N, places, places). Faster than the Fourier transform for a few hundred places.
    """
    height, width = size
    n = height * width
    for w in range(corner.shape[0]):
        top, left = corner[w, 0], corner[w, 1]
        sa, saa = np.float32(0.0), np.float32(0.0)
        for r in range(height):
            a = fa[top + r, left : left + width]
            for c in range(width):
                sa += a[c]
                saa += a[c] * a[c]
        own = saa - sa * sa / n
        for y in range(out.shape[1]):
            for x in range(out.shape[2]):
                i, j = low[w, 0] + y, low[w, 1] + x
                sb, sbb, sab = np.float32(0.0), np.float32(0.0), np.float32(0.0)
                for r in range(height):
                    a, b = fa[top + r, left : left + width], fb[i + r, j : j + width]
                    for c in range(width):
                        sb += b[c]
                        sbb += b[c] * b[c]
                        sab += a[c] * b[c]
                energy = own * (sbb - sb * sb / n)
                out[w, y, x] = (sab - sa * sb / n) / np.sqrt(max(energy, np.float32(1e-30)))


@njit(cache=True, nogil=True, fastmath=True)
def warp_windows(image, centres, linear, size, table, out, unusable):  # type: ignore[no-untyped-def]
    """Image b on the pixel grid of image a, one patch under the other.

    Patch n holds ``image(centres[n] + (I + linear[n]) u)`` with u the pixel's offset from the patch centre.
    Pixels that cannot be read are zero and flagged in `unusable`.
    """
    height, width = size
    wy, wx = np.empty(8, np.float32), np.empty(8, np.float32)
    for n in range(centres.shape[0]):
        for r in range(height):
            uy = r - 0.5 * (height - 1)
            for c in range(width):
                ux = c - 0.5 * (width - 1)
                line = centres[n, 0] + uy + linear[n, 0, 0] * uy + linear[n, 0, 1] * ux
                column = centres[n, 1] + ux + linear[n, 1, 0] * uy + linear[n, 1, 1] * ux
                if 3 <= line < image.shape[0] - 5 and 3 <= column < image.shape[1] - 5:
                    out[n * height + r, c] = sample_at(image, line, column, table, wy, wx)
                else:
                    out[n * height + r, c] = np.float32(0.0)
                    unusable[n * height + r, c] = True


@njit(cache=True, nogil=True, fastmath=True)
def _interpolate(image, line, column, linear, height, width, parts, table, wy, wx, row, out):  # type: ignore[no-untyped-def]
    """Fill `out` (height + 8, width + 8) with image b around a window centred at (line, column).

    Columns are cut in `parts`; inside one the shift is constant, so that the kernel is separable.
    """
    for part in range(parts):
        first = (width + 8) * part // parts
        last = (width + 8) * (part + 1) // parts
        ux = 0.5 * (first + last - 1) - 4.0 - 0.5 * (width - 1)
        y = line + linear[0, 1] * ux - 0.5 * (height - 1) - 4.0
        x = column + linear[1, 1] * ux - 0.5 * (width - 1) - 4.0 + first
        top, left = int(np.floor(y)), int(np.floor(x))
        fill_weights(table, y - top, wy)
        fill_weights(table, x - left, wx)
        a0, a1, a2, a3, a4, a5, a6, a7 = wy[0], wy[1], wy[2], wy[3], wy[4], wy[5], wy[6], wy[7]
        b0, b1, b2, b3, b4, b5, b6, b7 = wx[0], wx[1], wx[2], wx[3], wx[4], wx[5], wx[6], wx[7]
        count = last - first
        for r in range(height + 8):
            i, j0, j1 = top - 3 + r, left - 3, left + 4 + count
            s0, s1, s2, s3 = image[i, j0:j1], image[i + 1, j0:j1], image[i + 2, j0:j1], image[i + 3, j0:j1]
            s4, s5, s6, s7 = (
                image[i + 4, j0:j1],
                image[i + 5, j0:j1],
                image[i + 6, j0:j1],
                image[i + 7, j0:j1],
            )
            for c in range(count + 7):
                row[c] = (
                    a0 * s0[c] + a1 * s1[c] + a2 * s2[c] + a3 * s3[c]
                    + a4 * s4[c] + a5 * s5[c] + a6 * s6[c] + a7 * s7[c]
                )  # fmt: skip
            line_out = out[r, first:last]
            for c in range(count):
                line_out[c] = (
                    b0 * row[c] + b1 * row[c + 1] + b2 * row[c + 2] + b3 * row[c + 3]
                    + b4 * row[c + 4] + b5 * row[c + 5] + b6 * row[c + 6] + b7 * row[c + 7]
                )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=True)
def _gradients(image, top, left, height, width, value, gy, gx):  # type: ignore[no-untyped-def]
    """Values and derivatives of a window with its first pixel at (top, left), flattened by rows."""
    last = left + width
    for r in range(height):
        first = r * width
        v, y, x = value[first : first + width], gy[first : first + width], gx[first : first + width]
        i = top + r
        mid = image[i, left - 4 : last + 4]
        for c in range(width):
            v[c] = mid[c + 4]
        for c in range(width):
            x[c] = (
                _D1 * (mid[c + 5] - mid[c + 3])
                + _D2 * (mid[c + 6] - mid[c + 2])
                + _D3 * (mid[c + 7] - mid[c + 1])
                + _D4 * (mid[c + 8] - mid[c])
            )
        up1, up2 = image[i - 1, left:last], image[i - 2, left:last]
        up3, up4 = image[i - 3, left:last], image[i - 4, left:last]
        down1, down2 = image[i + 1, left:last], image[i + 2, left:last]
        down3, down4 = image[i + 3, left:last], image[i + 4, left:last]
        for c in range(width):
            y[c] = (
                _D1 * (down1[c] - up1[c])
                + _D2 * (down2[c] - up2[c])
                + _D3 * (down3[c] - up3[c])
                + _D4 * (down4[c] - up4[c])
            )


@njit(cache=True, nogil=True, fastmath=True)
def _centre(values, m, count, n):  # type: ignore[no-untyped-def]
    """Take the weighted mean out of values; return their sum of squares, 0 if that is rounding alone."""
    total = np.float32(0.0)
    for i in range(n):
        total += m[i] * values[i]
    mean = np.float32(total / count)
    squares = np.float32(0.0)
    for i in range(n):
        values[i] -= mean
        squares += m[i] * values[i] * values[i]
    return squares if squares > np.float32(1e-10) * count * mean * mean else np.float32(0.0)


@njit(cache=True, nogil=True, fastmath=True)
def _product(a, b, m, n):  # type: ignore[no-untyped-def]
    """Weighted sum of products."""
    total = np.float32(0.0)
    for i in range(n):
        total += m[i] * a[i] * b[i]
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _normal(a, b, m, gay, gax, gby, gbx, gain, n, s):  # type: ignore[no-untyped-def]
    """Sums of the normal equations of the symmetric fit, written to `s` (12)."""
    half = np.float32(0.5)
    sy = sx = hyy = hyx = hxx = fy = fx = cy = cx = rr = gyy = gxx = gyx = np.float32(0.0)
    for i in range(n):
        value = gain * b[i]
        r = m[i] * (a[i] - value)
        by, bx = gain * gby[i], gain * gbx[i]
        y, x = half * (gay[i] + by), half * (gax[i] + bx)
        sy += y * r
        sx += x * r
        rr += r * r
        ym, xm = m[i] * y, m[i] * x
        hyy += m[i] * gay[i] * by
        hxx += m[i] * gax[i] * bx
        hyx += m[i] * half * (gay[i] * bx + gax[i] * by)
        gyy += ym * y
        gxx += xm * x
        gyx += ym * x
        fy += ym
        fx += xm
        cy += ym * value
        cx += xm * value
    s[0], s[1], s[2], s[3], s[4], s[5], s[6] = sy, sx, hyy, hyx, hxx, fy, fx
    s[7], s[8], s[9], s[10], s[11], s[12] = cy, cx, rr, gyy, gyx, gxx


@njit(cache=True, nogil=True, fastmath=True)
def _block_sums(a, b, m, gay, gax, gby, gbx, gain, height, width, blocks, line, sums):  # type: ignore[no-untyped-def]
    """Score and curvature of each block of columns: `sums` (blocks, 4) = s_y, s_x, g_yy, g_xx."""
    half = np.float32(0.5)
    sums[:, :] = 0.0
    for k in range(4):
        line[:width] = np.float32(0.0)
        for r in range(height):
            f = r * width
            av, bv, mv = a[f : f + width], b[f : f + width], m[f : f + width]
            if k == 0 or k == 2:
                ga, gb = gay[f : f + width], gby[f : f + width]
            else:
                ga, gb = gax[f : f + width], gbx[f : f + width]
            if k < 2:
                for c in range(width):
                    line[c] += mv[c] * half * (ga[c] + gain * gb[c]) * (av[c] - gain * bv[c])
            else:
                for c in range(width):
                    g = half * (ga[c] + gain * gb[c])
                    line[c] += mv[c] * g * g
        for q in range(blocks):
            total = np.float32(0.0)
            for c in range(width * q // blocks, width * (q + 1) // blocks):
                total += line[c]
            sums[q, k] = total


@njit(cache=True, nogil=True)
def _block_variance(sums, blocks, k, out):  # type: ignore[no-untyped-def]
    """Variance of a score from its blocks (neighbours included), and the share of it that the fit left in.

    With p the block's share of the curvature, the fit takes ``p Z`` from each block score z; what is left in
    ``sum z z + 2 sum z z_next`` is ``1 - sum p p - 2 sum p p_next`` of the variance.
    """
    total, curvature = 0.0, 0.0
    for q in range(blocks):
        total += sums[q, k]
        curvature += sums[q, k + 2]
    variance, share = 0.0, 1.0
    before_z, before_p = 0.0, 0.0
    for q in range(blocks):
        p = sums[q, k + 2] / curvature
        z = sums[q, k] - p * total
        variance += z * z + 2.0 * z * before_z
        share -= p * p + 2.0 * p * before_p
        before_z, before_p = z, p
    out[0], out[1] = variance, share


@njit(cache=True, nogil=True)
def refine_windows(  # type: ignore[no-untyped-def]
    fa, fb, bad_a, bad_b, corner, centre, linear, start, size, table, parts, iterations, tolerance, reach, out
):
    """Fit the shift of every window by a symmetric Gauss-Newton with gain and offset projected out.

    Parameters
    ----------
    fa, fb : (lines, columns) float32
        Filtered images (blocks of them).
    bad_a, bad_b : (lines, columns) bool
        Pixels not to use; arrays of size 0 when there are none.
    corner : (N, 2) int64
        First line and column of each window in `fa`.
    centre : (N, 2) float64
        Predicted position of the window's centre in `fb`.
    linear : (N, 2, 2) float64
        Local affine less the identity.
    start : (N, 2) float64
        Shift to start from.
    size : (int, int)
        Lines and columns of the window.
    table, parts, iterations, tolerance, reach
        Interpolation table; column parts of constant shift; limit of iterations; step (px) that ends the
        fit; largest move from `start`.
    out : (N, COLUMNS) float64
        shift line, column; h_yy, h_yx, h_xx (curvature, free of noise); g_yy, g_yx, g_xx (of the mean
        gradient); residual variance; score; block variance y, share y, block variance x, share x;
        iterations used, negative: 0 did not converge, -1 left the image, -2 no texture.

    Notes
    -----
    With A the template, B the interpolated window, r = A - alpha B (both without mean, alpha the ratio of
    their norms) and g = (grad A + alpha grad B) / 2, the step solves H step = sum g r with
    H = sum grad A (alpha grad B)', the derivative of the score, less what gain and offset can imitate.
    The product of the two gradients carries no bias from the noise of either image.
    """
    height, width = size
    n = height * width
    blocks = min(BLOCKS, max(3, width // 4))
    a, gay, gax = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    b, gby, gbx = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    m = np.ones(n, np.float32)
    patch = np.empty((height + 8, width + 8), np.float32)
    row = np.empty(width + 16, np.float32)
    wy, wx, s = np.empty(8, np.float32), np.empty(8, np.float32), np.empty(13, np.float64)
    sums, pair = np.zeros((BLOCKS, 4), np.float64), np.zeros(2, np.float64)
    masked = bad_a.size > 0 or bad_b.size > 0
    edge = np.int64(4)  # of a type, not a literal: what it is given to would be compiled for either
    for w in range(corner.shape[0]):
        out[w, :] = np.nan
        i0, j0 = corner[w, 0], corner[w, 1]
        _gradients(fa, i0, j0, height, width, a, gay, gax)
        count = np.float32(n)
        if masked:
            count = np.float32(0.0)
            top = int(np.rint(centre[w, 0] + start[w, 0] - 0.5 * (height - 1)))
            left = int(np.rint(centre[w, 1] + start[w, 1] - 0.5 * (width - 1)))
            for r in range(height):
                for c in range(width):
                    bad = False
                    if bad_a.size > 0:
                        bad = bad_a[i0 + r, j0 + c]
                    if bad_b.size > 0:
                        rb = min(max(top + r, 0), bad_b.shape[0] - 1)
                        bad = bad or bad_b[rb, min(max(left + c, 0), bad_b.shape[1] - 1)]
                    m[r * width + c] = np.float32(0.0) if bad else np.float32(1.0)
                    count += m[r * width + c]
        if not count > 4.0:
            # the search led to where (almost) nothing can be used: fewer pixels than the fit has parameters
            out[w, 14] = -1.0
            continue
        var_a = _centre(a, m, count, n)
        dy, dx = start[w, 0], start[w, 1]
        done = 0.0
        placed = False
        if not var_a > 0.0:
            out[w, 14] = -2.0
            continue
        for iteration in range(1, iterations + 1):
            line, column = centre[w, 0] + dy, centre[w, 1] + dx
            if not (
                line - 0.5 * height - 9 >= 0 and line + 0.5 * height + 10 <= fb.shape[0]
                and column - 0.5 * width - 9 >= 0 and column + 0.5 * width + 10 <= fb.shape[1]
            ):  # fmt: skip
                done = -1.0
                break
            _interpolate(fb, line, column, linear[w], height, width, parts, table, wy, wx, row, patch)
            _gradients(patch, edge, edge, height, width, b, gby, gbx)
            var_b = _centre(b, m, count, n)
            if not var_b > 0.0:
                done = -2.0
                break
            gain = np.float32(np.sqrt(var_a / var_b))
            _normal(a, b, m, gay, gax, gby, gbx, gain, n, s)
            hyy = s[2] - s[5] * s[5] / count - s[7] * s[7] / var_a
            hyx = s[3] - s[5] * s[6] / count - s[7] * s[8] / var_a
            hxx = s[4] - s[6] * s[6] / count - s[8] * s[8] / var_a
            det = hyy * hxx - hyx * hyx
            placed = det > 1e-6 * s[10] * s[12] and hyy > 0.0
            if not placed:
                hyy, hyx, hxx = s[10], s[11], s[12]
                det = hyy * hxx - hyx * hyx
                if not det > 0.0:
                    done = -2.0
                    break
            step_y = (hxx * s[0] - hyx * s[1]) / det
            step_x = (hyy * s[1] - hyx * s[0]) / det
            length = np.sqrt(step_y * step_y + step_x * step_x)
            limit = 1.0 if length < 0.7 else 0.7 / length
            dy += limit * step_y
            dx += limit * step_x
            if length < tolerance:
                done = iteration
                break
            if np.hypot(dy - start[w, 0], dx - start[w, 1]) > reach:
                break
        if done > 0.0 and not placed:
            done = -2.0  # what the two images share does not place the window in both directions
        out[w, 14] = done
        if done <= 0.0:
            continue
        out[w, 0], out[w, 1] = dy, dx
        out[w, 2], out[w, 3], out[w, 4] = hyy, hyx, hxx
        out[w, 5], out[w, 6], out[w, 7] = s[10], s[11], s[12]
        # the last step takes this much from the residual, which was summed before it
        gone = min(step_y * s[0] + step_x * s[1], 0.5 * s[9])
        out[w, 8] = (s[9] - gone) / max(count - 4.0, 1.0)
        out[w, 9] = _product(a, b, m, n) / np.sqrt(var_a * var_b)
        _block_sums(a, b, m, gay, gax, gby, gbx, gain, height, width, blocks, row, sums)
        for k in range(2):
            _block_variance(sums, blocks, k, pair)
            out[w, 10 + 2 * k], out[w, 11 + 2 * k] = pair[0], pair[1]


@njit(cache=True, nogil=True, fastmath=True)
def window_curvature(pixels, corner, size, out):  # type: ignore[no-untyped-def]
    """Sums over windows of the products of central differences: `out` (N, 3) = yy, yx, xx."""
    half = np.float32(0.5)
    for w in range(corner.shape[0]):
        i0, j0 = corner[w, 0], corner[w, 1]
        out[w, :] = 0.0
        for r in range(i0, i0 + size[0]):
            up, down = pixels[r - 1, j0 : j0 + size[1]], pixels[r + 1, j0 : j0 + size[1]]
            mid = pixels[r, j0 - 1 : j0 + size[1] + 1]
            a, b, c = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for k in range(size[1]):
                y, x = half * (down[k] - up[k]), half * (mid[k + 2] - mid[k])
                a += y * y
                b += y * x
                c += x * x
            out[w, 0] += a
            out[w, 1] += b
            out[w, 2] += c
