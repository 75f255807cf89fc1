"""S2's two systems of equations written out as in its text, with each misprint kept or mended at choice.

In S2's own axes and letters; nothing of the package but the types of the scene. What comes out are S2's
angles.
"""

from __future__ import annotations

import numpy as np

from photogrammetry.stereo_scene import Shooting

ZENITH = np.array([0.0, 0.0, 1.0])


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """[v]x (..., 3, 3) of vectors (..., 3): S2's (6)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)


def epipolar(shooting: Shooting, *, second_axes_of_first: bool = False) -> np.ndarray:
    """(12) and (13): angles (2, 3), rad.

    second_axes_of_first: R_2k as printed, with n_1k in its first and third row.
    """
    m, r = _homogeneous(shooting), shooting.r
    if second_axes_of_first:
        r = np.stack([r[0], r[0]])
    b = np.einsum("kab,kb->ka", r[1], shooting.d[0] - shooting.d[1])[:, None]
    r21 = r[1] @ np.swapaxes(r[0], 1, 2)
    m1 = np.einsum("kab,knb->kna", r21, m[0])
    mb = np.cross(m[1], b)
    # the brace of (12), word for word
    brace = cross_matrix(m[1]) @ cross_matrix(b) - cross_matrix(mb)
    first = np.cross(m[0], np.einsum("kba,knb->kna", r21, mb))
    second = np.einsum("kna,knab->knb", m1, brace)
    rows = np.concatenate([first, second], axis=-1).reshape(-1, 6)
    return np.linalg.lstsq(rows, (m1 * mb).sum(axis=-1).ravel(), rcond=None)[0].reshape(2, 3)


def plane(
    shooting: Shooting,
    *,
    signs: bool = True,
    right: bool = True,
    depth: bool = True,
    moving: bool = True,
    own: bool = True,
) -> np.ndarray:
    """(7) and (8): angles (2, 3), rad. Each keyword true mends one misprint.

    signs: of the blocks of the angles. right: |d_2| m_2 on the right. depth: along the ray to the level
    plane, not |d|. moving: dZ/dw. own: each camera's own image coordinates with its slopes.
    """
    m, r, d = _homogeneous(shooting), shooting.r, shooting.d
    k, n = m.shape[1:3]
    r21 = r[1] @ np.swapaxes(r[0], 1, 2)
    m1 = np.einsum("kab,knb->kna", r21, m[0])
    b = np.broadcast_to(np.einsum("kab,kb->ka", r[1], d[0] - d[1])[:, None], m1.shape)
    normal = np.einsum("jkab,b->jka", r, ZENITH)[:, :, None]
    q = (normal * m).sum(axis=-1)
    z = -d[:, :, None, 2] / q if depth else np.broadcast_to(np.linalg.norm(d, axis=-1)[..., None], q.shape)
    change = -(z / q)[..., None] * np.cross(normal, m) if moving else np.zeros_like(m)
    by_first = -z[0][..., None, None] * (r21[:, None] @ cross_matrix(m[0]))
    by_second = z[0][..., None, None] * cross_matrix(m1) + cross_matrix(b)
    if not signs:
        by_first, by_second = -by_first, -by_second
    by_first = by_first - m1[..., :, None] * change[0][..., None, :]
    by_second = by_second + m[1][..., :, None] * change[1][..., None, :]
    t = (np.arange(k) - (k - 1) / 2.0) / k
    slopes = []
    for which, vector in ((1, m[1]), (0, -m1)):
        for axis in range(2):
            u = m[which if own else 0][..., axis]
            slopes += [u[..., None] * vector, (t[:, None] * u)[..., None] * vector]
    rows = np.concatenate([by_first, by_second, np.stack(slopes, axis=-1)], axis=-1).reshape(3 * k * n, 14)
    goal = z[0][..., None] * m1 + b - z[1][..., None] * (m[1] if right else m[0])
    scale = np.linalg.norm(rows, axis=0)
    return (np.linalg.lstsq(rows / scale, goal.ravel(), rcond=None)[0] / scale)[:6].reshape(2, 3)


def _homogeneous(shooting: Shooting) -> np.ndarray:
    """m (2, K, N, 3)."""
    return np.concatenate([shooting.m, np.ones((*shooting.m.shape[:3], 1))], axis=-1)
