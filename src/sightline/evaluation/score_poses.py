"""Poses of frames against their truth: errors, NEES, coverage; as they are and after alignment.

Alignment takes one rotation, one move and, for a similarity, one scale off all frames: what is left is what
frames differ by among themselves. The stated covariances own the datum's uncertainty; after alignment they
are too large by it, so that NEES and coverage of aligned errors are those of cautious sigmas.

Not here: reading the files (``io/results/pose_score.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.evaluation.consistency import consistency, squares_over_covariance

Array = NDArray[np.float64]

PARAMETERS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class Alignment:
    """truth = scale rotation estimate + move, as well as positions and attitudes can be made to agree.

    Attributes
    ----------
    scale : float
    rotation : Rotation
    move : (3,)
        m.
    """

    scale: float
    rotation: Rotation
    move: Array

    def apply(self, position: Array, attitude: Rotation) -> tuple[Array, Rotation]:
        """Aligned positions (M, 3) and attitudes."""
        return self.scale * self.rotation.apply(np.array(position)) + self.move, self.rotation * attitude


def align(
    position: Array, attitude: Rotation, truth: Array, true_attitude: Rotation, *, scaled: bool
) -> Alignment:
    """Least-squares alignment of positions (S. Umeyama, 1991).

    Parameters
    ----------
    position, truth : (M, 3)
        m.
    attitude, true_attitude : Rotation
        M each; they decide where positions lie on one line and leave the turn about it open.
    scaled : bool
        A similarity; otherwise rigid.
    """
    a, b = position - position.mean(axis=0), truth - truth.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    if s[1] > _LINE * s[0]:
        sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        rotation = Rotation.from_matrix(u @ sign @ vt)
    else:
        rotation = _about_line(a, b, attitude, true_attitude)
    turned = rotation.apply(a)
    square = float((a**2).sum())
    scale = float((turned * b).sum() / square) if scaled and square > 0.0 else 1.0
    move = truth.mean(axis=0) - scale * rotation.apply(position.mean(axis=0))
    return Alignment(scale, rotation, move)


#: Second singular value over the first of the products of positions below which they lie on one line: a strip
#: whose width is less than a thirtieth of its length.
_LINE = 1e-3


def _about_line(a: Array, b: Array, attitude: Rotation, truth: Rotation) -> Rotation:
    """The turn of a single strip: its direction by positions, the turn about it by attitudes."""
    mean = (truth * attitude.inv()).mean()
    along_a, along_b = _direction(a), _direction(b)
    turned = mean.apply(along_a)
    if turned @ along_b < 0.0:
        along_b = -along_b
    axis = np.cross(turned, along_b)
    size = float(np.linalg.norm(axis))
    if size == 0.0:
        return mean
    angle = float(np.arctan2(size, turned @ along_b))
    return Rotation.from_rotvec(axis / size * angle) * mean


def _direction(points: Array) -> Array:
    return np.asarray(np.linalg.svd(points, full_matrices=False)[2][0])


def pose_errors(position: Array, attitude: Rotation, truth: Array, true_attitude: Rotation) -> Array:
    """Errors (M, 6): of positions along world axes (m), of angles about body axes (rad).

    Of angles: estimate = truth * from_rotvec(error).
    """
    turn = (true_attitude.inv() * attitude).as_rotvec()
    return np.concatenate([position - truth, turn], axis=1)


def score_poses(
    position: Array,
    attitude: Rotation,
    truth: Array,
    true_attitude: Rotation,
    *,
    sigma: Array | None = None,
    covariance: Array | None = None,
    source: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Errors of the poses of frames.

    Parameters
    ----------
    position, truth : (M, 3)
        m.
    attitude, true_attitude : Rotation
        M each, world_from_body.
    sigma : (M, 6), optional
        m, rad.
    covariance : (M, 6, 6), optional
        In the same order; without it NEES takes parameters as independent.
    source : tuple of str, optional
        Kind of each pose: errors are given for each kind too.

    Returns
    -------
    dict
        ``frames``; ``absolute``, ``rigid`` and ``similarity``, each with an entry per parameter: ``rms``,
        ``max``, ``sigma`` (rms of the stated), ``nees`` (mean of (error / sigma)^2), ``coverage_95``;
        ``nees`` of all six together (6 is expected); ``alignment`` that was applied; ``by_source`` for the
        absolute errors.
    """
    if len(position) == 0:
        raise InputError("no frame of the result is in the truth, so there is no error to be scored")
    out: dict[str, Any] = {"frames": len(position)}
    out["absolute"] = _entries(pose_errors(position, attitude, truth, true_attitude), sigma, covariance)
    if len(position) >= 3:
        for name, scaled in (("rigid", False), ("similarity", True)):
            fit = align(position, attitude, truth, true_attitude, scaled=scaled)
            errors = pose_errors(*fit.apply(position, attitude), truth, true_attitude)
            out[name] = _entries(errors, sigma, covariance) | {
                "alignment": {
                    "scale": fit.scale,
                    "rotation_rad": fit.rotation.as_rotvec().tolist(),
                    "move_m": fit.move.tolist(),
                }
            }
    kinds = sorted(set(source))
    out["by_source"] = {
        kind: _part(position, attitude, truth, true_attitude, sigma, covariance, _rows(source, kind))
        for kind in kinds
    }
    return out


def _rows(source: tuple[str, ...], kind: str) -> NDArray[np.intp]:
    return np.flatnonzero([word == kind for word in source])


def _part(
    position: Array,
    attitude: Rotation,
    truth: Array,
    true_attitude: Rotation,
    sigma: Array | None,
    covariance: Array | None,
    rows: NDArray[np.intp],
) -> dict[str, Any]:
    """Absolute errors of some frames."""
    errors = pose_errors(position[rows], attitude[rows], truth[rows], true_attitude[rows])
    entries = _entries(
        errors, None if sigma is None else sigma[rows], None if covariance is None else covariance[rows]
    )
    return {"frames": len(rows)} | entries


def _entries(errors: Array, sigma: Array | None, covariance: Array | None) -> dict[str, Any]:
    """rms, max and, where sigmas are stated, how true they are; per parameter and together."""
    out: dict[str, Any] = {}
    for k, name in enumerate(PARAMETERS):
        entry: dict[str, Any] = {
            "unit": "m" if k < 3 else "rad",
            "rms": float(np.sqrt((errors[:, k] ** 2).mean())),
            "max": float(np.abs(errors[:, k]).max()),
        }
        known = None if sigma is None else np.isfinite(sigma[:, k]) & (sigma[:, k] > 0.0)
        if sigma is not None and known is not None and known.any():
            stated = consistency(errors[known, k] / sigma[known, k])
            entry |= {
                "sigma": float(np.sqrt((sigma[known, k] ** 2).mean())),
                "nees": stated.nees,
                "coverage_95": stated.coverage_95,
            }
        out[name] = entry
    if covariance is not None:
        good = np.isfinite(covariance).all(axis=(1, 2))
        out["nees"] = _nees(errors[good], covariance[good]) if good.any() else None
    return out


def _nees(errors: Array, covariance: Array) -> float | None:
    """Mean squared error in units of the covariance."""
    try:
        return float(squares_over_covariance(errors, covariance).mean())
    except np.linalg.LinAlgError:
        return None
