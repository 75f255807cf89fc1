"""S2's epipolar estimator (equations 9 to 13): six angles from coplanar rays, whatever the relief.

A ray of each camera and the baseline b lie in one plane: S = r1 . (r2 x b) = 0. S and its derivatives with
the six angles are bilinear in the tangents m1, m2 of a pair: z_i = m1^T Z_i m2 with seven matrices Z_i per
shot. All that the observations enter by is then one 9 x 9 matrix of moments per shot.

`raw` is S2's (13): ordinary least squares. Its regressors are as noisy as its right side, which biases it; by
default the expected products of noises are taken out of the normal equations. Derivation: docs/theory/s2.md.

Not here: which sightings make a pair (``pairs.py``), the adjustment of all observations
(``photogrammetry/block/bundle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.estimation.robust import robust_sigma
from sightline.geometry.checks import Array
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.estimating_equations import observe
from sightline.photogrammetry.pair.pairs import PairOrientation, SightingPairs, position_turns

#: Most times that the equations are linearised anew, and the step (rad) at which that ends.
_STEPS, _STEP = 10, 1e-10
#: Rounds of rejection.
_ROUNDS = 10
#: Turning about each axis: [e_i]x.
_TURNS = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)
#: Products of two of (x, y, 1) that are kept, and where each stands in the 3 x 3 matrix of all.
_WHERE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True)
class _Rays:
    """One image of each pair: tangents x, y (N,), their covariance for a noise of 1 px, its variance (px^2).

    products : (6, N), of two of (x, y, 1).
    """

    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array
    variance: Array
    products: Array

    @classmethod
    def of(cls, pairs: SightingPairs) -> tuple[_Rays, _Rays]:
        """Of the first images and of the second."""
        both = []
        for rows in pairs.rows:
            x, y = np.ascontiguousarray(pairs.sightings.tangents[rows].T)
            a, b, c, d = np.ascontiguousarray(pairs.sightings.px_per_tangent[rows].reshape(-1, 4).T)
            scale = 1.0 / (a * d - b * c) ** 2
            xx, xy, yy = (d * d + b * b) * scale, -(d * c + b * a) * scale, (c * c + a * a) * scale
            products = np.stack([x * x, x * y, x, y * y, y, np.ones_like(x)])
            both.append(cls(x, y, xx, xy, yy, pairs.sightings.sigma_px[rows] ** 2, products))
        return both[0], both[1]

    def clean(self) -> Array:
        """Products (6, N) whose expectation is free of the noise of the image."""
        clean = self.products.copy()
        for row, noise in ((0, self.xx), (1, self.xy), (3, self.yy)):
            clean[row] -= self.variance * noise
        return clean

    def slope(self, by_x: Array, by_y: Array) -> Array:
        """Square (N,) of the change per px of what changes with the tangents by `by_x` and `by_y`."""
        return np.asarray(self.xx * by_x**2 + 2.0 * self.xy * by_x * by_y + self.yy * by_y**2)


def orient_by_epipolar(pairs: SightingPairs, noise: PoseNoise, *, raw: bool = False) -> PairOrientation:
    """S2's epipolar estimate, its bias removed.

    Parameters
    ----------
    pairs : SightingPairs
        At least six.
    noise : PoseNoise
        Of the poses in hand; the noise of the sightings is their own `sigma_px`.
    raw : bool
        Ordinary least squares as S2 has it, linearised once, biased.

    Returns
    -------
    PairOrientation
        `residual_px` as `epipolar_residuals` has it.

    Raises
    ------
    InputError
        Fewer than six pairs, cameras in one place.

    Notes
    -----
    The covariance is of first order in the noise of sightings, of second in that of poses, which all pairs of
    a shot share. It does not know of mismatches: see `epipolar_outliers`.
    """
    _check(pairs)
    rays = _Rays.of(pairs)
    measured = _shot_sums(pairs, rays[0].products, rays[1].products)
    # the noises of the two images are independent: the mean of the product is the product of the means
    clean = _shot_sums(pairs, rays[0].clean(), rays[1].clean())
    turns = position_turns(pairs, noise)
    angles = np.zeros((2, 3))
    arms = _arms(pairs, angles)
    forms, errors = _forms(*arms), _pose_errors(pairs, noise, turns, arms)
    plain = _normal(forms, measured)
    ordinary = observe(plain[:6, :6])
    first = ordinary.solve(plain[:6, 6]).reshape(2, 3)
    for count in range(_STEPS):
        better = _normal(forms, clean) - _normal(errors, clean)
        equations = observe(better[:6, :6], _normal(forms, measured)[:6, :6])
        step = equations.solve(better[:6, 6]).reshape(2, 3)
        angles = (Rotation.from_rotvec(angles) * Rotation.from_rotvec(step)).as_rotvec()
        if len(equations.unobservable):
            # what is not observable is reported for the planned attitudes, not of those some noise leads to
            break
        arms = _arms(pairs, angles)
        forms = _forms(*arms)
        if np.abs(step).max() < _STEP:
            break
        if count == 0:
            errors = _pose_errors(pairs, noise, turns, arms)
    found = first if raw else angles
    equations = ordinary if raw else equations
    volume, slopes = _volumes(pairs, rays, _forms(*_arms(pairs, found))[:, 6])
    variance = slopes[0] * rays[0].variance + slopes[1] * rays[1].variance
    by_image = _normal(forms, _shot_sums(pairs, rays[0].products * variance, rays[1].products))[:6, :6]
    covariance, information = equations.covariance(by_image + _pose_meat(forms, errors, clean))
    return PairOrientation(
        np.where(equations.touched.reshape(2, 3), np.nan, found),
        covariance,
        information,
        equations.unobservable,
        first - angles,
        volume / np.sqrt(slopes.sum(axis=0)),
    )


def epipolar_residuals(pairs: SightingPairs, angles: Array) -> tuple[Array, Array]:
    """Distances from the epipolar lines, not linearised.

    Parameters
    ----------
    pairs : SightingPairs
    angles : (2, 3)
        rad, of the first camera and of the second, as in `PairOrientation`.

    Returns
    -------
    residual_px : (N,)
        px, signed; squared it is the least sum of squares, over both images, by which the pair must move for
        its rays to meet (Sampson's first order). Its 1-sigma is that of the sightings where both have the
        same.
    sigma_px : (N,)
        px, 1-sigma of the residual by the noise of the sightings alone.
    """
    rays = _Rays.of(pairs)
    volume, slopes = _volumes(pairs, rays, _forms(*_arms(pairs, np.asarray(angles, dtype=np.float64)))[:, 6])
    slope = np.sqrt(slopes.sum(axis=0))
    variance = slopes[0] * rays[0].variance + slopes[1] * rays[1].variance
    return volume / slope, np.sqrt(variance) / slope


def epipolar_outliers(
    pairs: SightingPairs, noise: PoseNoise, *, threshold: float = 4.0, angles: Array | None = None
) -> NDArray[np.bool_]:
    """Pairs whose rays miss each other by more than noise explains.

    Parameters
    ----------
    pairs : SightingPairs
    noise : PoseNoise
    threshold : float
        In 1-sigmas of the residual.
    angles : (2, 3) or None
        rad, to judge by; None: found in turns with the outliers.

    Returns
    -------
    (N,) bool
        Pairs to reject. A point displaced along its epipolar line meets the other ray at a wrong depth and is
        not found: no pair alone can show it.

    Notes
    -----
    What all pairs of a shot share is the shot's pose error: the median residual, drawn towards 0 by as much
    as its own noise is to be expected in it. The 1-sigma is the declared one, or the median absolute
    deviation of all residuals where that is larger.
    """
    _check(pairs)
    rays = _Rays.of(pairs)
    judge = np.zeros((2, 3)) if angles is None else np.asarray(angles, dtype=np.float64)
    rejected = _far(pairs, rays, noise, judge, threshold, estimated=angles is not None)
    for _ in range(_ROUNDS if angles is None else 0):
        kept = pairs.kept(~rejected)
        if len(kept) < 6:
            break
        before, judge = rejected, np.nan_to_num(orient_by_epipolar(kept, noise).angles)
        rejected = _far(pairs, rays, noise, judge, threshold, estimated=True)
        if np.array_equal(rejected, before):
            break
    return rejected


def noise_ratios(pairs: SightingPairs, noise: PoseNoise, angles: Array) -> tuple[float, float]:
    """Variance of the residuals over what was declared: of sightings, within shots; of poses, between them.

    Parameters
    ----------
    pairs : SightingPairs
    noise : PoseNoise
        As declared.
    angles : (2, 3)
        rad, found.

    Returns
    -------
    image, pose : float
        1 where the declared sigmas are true; the second is as good as sqrt(2 / shots), 1 where no pose noise
        is declared.
    """
    residual, sigma = epipolar_residuals(pairs, angles)
    arms = _arms(pairs, np.asarray(angles, dtype=np.float64))
    slope = _volumes(pairs, _Rays.of(pairs), _forms(*arms)[:, 6])[1].sum(axis=0)
    count = np.diff(pairs.starts)
    middle = np.add.reduceat(residual, pairs.starts[:-1]) / count
    image = robust_sigma((residual - middle[pairs.shot]) / sigma) ** 2
    shared = float(_pose_variance(pairs, noise, arms, slope).sum())
    own = image * float((np.add.reduceat(sigma**2, pairs.starts[:-1]) / count**2).sum())
    return image, max(float((middle**2).sum()) - own, 0.0) / shared if shared > 0.0 else 1.0


def _far(
    pairs: SightingPairs,
    rays: tuple[_Rays, _Rays],
    noise: PoseNoise,
    angles: Array,
    threshold: float,
    *,
    estimated: bool,
) -> NDArray[np.bool_]:
    """Pairs (N,) further than `threshold` sigmas from where their shot is: its median, before an estimate."""
    arms = _arms(pairs, angles)
    volume, slopes = _volumes(pairs, rays, _forms(*arms)[:, 6])
    slope = slopes.sum(axis=0)
    residual = volume / np.sqrt(slope)
    variance = (slopes[0] * rays[0].variance + slopes[1] * rays[1].variance) / slope
    count = np.diff(pairs.starts)
    order = np.lexsort((residual, pairs.shot))
    lower, upper = (residual[order[pairs.starts[:-1] + half]] for half in ((count - 1) // 2, count // 2))
    middle = 0.5 * (lower + upper)
    spread = robust_sigma(residual - middle[pairs.shot]) ** 2
    variance = np.maximum(variance, spread)
    trust, left = np.ones_like(middle), np.zeros_like(middle)
    if estimated:
        shared = _pose_variance(pairs, noise, arms, slope)
        # the variance of a median of normal values is pi/2 that of their mean
        own = 0.5 * np.pi * np.add.reduceat(variance, pairs.starts[:-1]) / count**2
        trust = shared / (shared + own)
        left = (1.0 - trust) * shared
    beyond = (residual - (trust * middle)[pairs.shot]) ** 2
    return np.asarray(beyond > threshold**2 * (variance + left[pairs.shot]))


def _pose_variance(
    pairs: SightingPairs, noise: PoseNoise, arms: tuple[Array, Array, Array], slope: Array
) -> Array:
    """Variance (K,), px^2, of a shot's residuals by the errors of its poses, at its middle pair."""
    errors = _pose_errors(pairs, noise, position_turns(pairs, noise), arms)[:, :, 6]
    at = pairs.starts[:-1] + np.diff(pairs.starts) // 2
    m = np.concatenate([pairs.sightings.tangents[pairs.rows[:, at]], np.ones((2, len(at), 1))], axis=-1)
    shift = np.einsum("lkab,ka,kb->lk", errors.reshape(*errors.shape[:2], 3, 3), m[0], m[1])
    return np.asarray((shift**2).sum(axis=0) / slope[at])


def _check(pairs: SightingPairs) -> None:
    """Refuse what has no answer."""
    if len(pairs) < 6:
        raise InputError(
            f"six angles need six pairs or more, spread over the frames, got {len(pairs)}; match more points"
        )
    if not (np.abs(pairs.baselines) > 1e-9 * np.abs(pairs.sightings.position).max()).any():
        raise InputError(
            "both cameras stand in one place in every shot: there is no baseline to be coplanar with; "
            "check the positions of the second camera"
        )


def _shot_sums(pairs: SightingPairs, first: Array, second: Array) -> Array:
    """Sums (K, 9, 9) of (m1 x m2)(m1 x m2)^T from the products (6, N) of each image."""
    shots = zip(pairs.starts[:-1], pairs.starts[1:], strict=True)
    sums = np.stack([first[:, i:j] @ second[:, i:j].T for i, j in shots])
    return sums[:, _WHERE[:, None, :, None], _WHERE[None, :, None, :]].reshape(-1, 9, 9)


def _arms(pairs: SightingPairs, angles: Array) -> tuple[Array, Array, Array]:
    """Factors of the forms: left, middle, right with r1 . (r2 x b) = r1^T middle r2.

    Left and right (4, K, 3, 3) are world from tangents, as they are and turned about each body axis.
    """
    bodies = pairs.sightings.world_from_body[pairs.images] @ _exp(angles)[:, None]
    cameras = pairs.sightings.body_from_camera[pairs.sightings.camera[pairs.images[:, 0]]]
    ways = np.concatenate([np.eye(3)[None], _TURNS])
    left, right = (body @ (ways @ camera)[:, None] for body, camera in zip(bodies, cameras, strict=True))
    return left, -np.einsum("iab,ki->kab", _TURNS, pairs.baselines), right


def _exp(angles: Array) -> Array:
    """Rotation matrices (2, 3, 3) of rotation vectors (2, 3)."""
    return np.asarray(Rotation.from_rotvec(angles).as_matrix())


def _forms(left: Array, middle: Array, right: Array) -> Array:
    """Z (..., K, 7, 9): derivatives of S with the six angles, and S, on the products m1 x m2."""
    half = np.swapaxes(left, -1, -2) @ middle
    by_first, by_second = half @ right[0], half[0] @ right[1:]
    stack = np.concatenate([by_first[1:], by_second, by_first[:1]])
    return np.moveaxis(stack, 0, -3).reshape(*stack.shape[1:-2], 7, 9)


def _normal(forms: Array, moments: Array) -> Array:
    """Sum (7, 7) of z z^T over all pairs (and errors); its last row and column are those of S."""
    flat = forms.reshape(-1, *moments.shape[:1], 7, 9)
    left = np.moveaxis(flat @ moments, 2, 0).reshape(7, -1)
    return np.asarray(left @ np.moveaxis(flat, 2, 0).reshape(7, -1).T)


def _pose_errors(
    pairs: SightingPairs, noise: PoseNoise, turns: Array, arms: tuple[Array, Array, Array]
) -> Array:
    """Change of Z (L, K, 7, 9) with each independent error of a shot's poses, times its 1-sigma.

    An attitude that jitters moves the image: v becomes v - d x v before it is turned by the angles sought. An
    attitude rebuilt from wrong positions is wrong itself.
    """
    left, middle, right = (arm[..., None, :, :, :] for arm in arms)
    mounts = pairs.sightings.body_from_camera[pairs.sightings.camera[pairs.images[:, 0]]]
    changes = []
    if noise.attitude:
        back = [-mount.T @ _TURNS @ mount for mount in mounts]
        changes.append(noise.attitude * _forms(left @ back[0][:, None], middle, right))
        changes.append(noise.attitude * _forms(left, middle, right @ back[1][:, None]))
    if noise.position:
        ways = np.concatenate([np.eye(3)[None], _TURNS])
        for moved, sign in enumerate((1.0, -1.0)):
            change = np.broadcast_to(
                _forms(left, -sign * _TURNS[:, None], right), (3, *middle.shape[1:2], 7, 9)
            ).copy()
            if noise.aim_point is not None:
                turned = [
                    arm[0]
                    @ mount.T
                    @ np.einsum("kil,iab->lkab", turn[moved], _TURNS)
                    @ (ways @ mount)[:, None, None]
                    for arm, mount, turn in zip((left, right), mounts, turns, strict=True)
                ]
                change += _forms(turned[0], middle, right) + _forms(left, middle, turned[1])
            changes.append(noise.position * change)
    return np.concatenate(changes) if changes else np.zeros((0, len(pairs.starts) - 1, 7, 9))


def _volumes(pairs: SightingPairs, rays: tuple[_Rays, _Rays], form: Array) -> tuple[Array, Array]:
    """S of each pair (N,) by the form (K, 9) of its shot, and the square (2, N) of its slope per px."""
    e = np.repeat(np.ascontiguousarray(form.T), np.diff(pairs.starts), axis=1)
    one, two = rays
    by_x1, by_y1, rest = (e[3 * i] * two.x + e[3 * i + 1] * two.y + e[3 * i + 2] for i in range(3))
    by_x2, by_y2 = (one.x * e[i] + one.y * e[3 + i] + e[6 + i] for i in range(2))
    return one.x * by_x1 + one.y * by_y1 + rest, np.stack([one.slope(by_x1, by_y1), two.slope(by_x2, by_y2)])


def _pose_meat(forms: Array, errors: Array, moments: Array) -> Array:
    """Spread (6, 6) of the right side by the errors of poses, each shared by all pairs of its shot.

    To second order: where the derivative with an angle averages out over a frame, what the errors make of it
    times what they make of S counts as much as the derivative itself. `forms` in hand hold one draw of the
    errors: `first` has on the average one of the two parts of their products' variance already.
    """
    change = errors[:, :, 6]
    first = np.einsum("kia,kab,lkb->kil", forms[:, :6], moments, change, optimize=True)
    second = np.einsum("lkia,kab,mkb->klmi", errors[:, :, :6], moments, change, optimize=True)
    return np.einsum("kil,kjl->ij", first, first) + np.einsum("klmi,kmlj->ij", second, second)
