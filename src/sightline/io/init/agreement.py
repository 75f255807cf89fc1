"""How a product's rigorous model agrees with what the product itself says: its rational polynomials, corners.

Not here: reading products (``io/formats/products/``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.apparent import bent_camera
from sightline.geometry.earth import from_geodetic, local_axes, to_geodetic
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.products.product import GroundMark, Product

Array = NDArray[np.float64]

#: Pixels each way and heights of the lattice on which rational polynomials are compared.
_LATTICE, _HEIGHTS = 9, 5
#: m; step of the slope of a line of sight against height.
_STEP = 100.0


def agreement(product: Product) -> tuple[str, ...]:
    """In words, one sentence for each thing that the product says; none where it says nothing."""
    said = []
    if product.rpc is not None:
        apart = rpc_residuals(product)
        line, column = np.sqrt((apart**2).mean(axis=0))
        said.append(
            f"model against the maker's RPC: {np.hypot(line, column):.2g} px rms (lines {line:.2g}, columns "
            f"{column:.2g})"
        )
    if product.marks:
        off = mark_residuals(product)
        said.append(
            f"model against the {len(off)} corners that the product gives: {off.max():.3g} m at most, "
            f"{np.sqrt((off**2).mean()):.3g} m rms"
        )
    return tuple(said)


def rpc_residuals(product: Product) -> Array:
    """(N, 2) px: where the maker's RPC sees ground points, less the pixels whose model sees them.

    On a lattice of pixels and heights, air and aberration taken for each height.
    """
    rpc, camera = product.rpc, product.model.camera
    assert rpc is not None
    lines, columns = camera.shape
    grid = np.meshgrid(np.linspace(0.0, lines - 1.0, _LATTICE), np.linspace(0.0, columns - 1.0, _LATTICE))
    pixels = np.stack(grid, axis=-1).reshape(-1, 2)
    apart = []
    for height in rpc.height[0] + rpc.height[1] * np.linspace(-1.0, 1.0, _HEIGHTS):
        straight = bent_camera(camera, float(height), product.model.lacks)
        places = to_geodetic(straight.locate(pixels, Ellipsoid(height=float(height))))
        places[:, :2] = np.degrees(places[:, :2])
        apart.append(rpc.project(places) - pixels)
    return np.concatenate(apart)


def mark_residuals(product: Product) -> Array:
    """(N,) m: from each mark of the product to where the model sees it; its height fitted where not given."""
    return np.array([_off(product, mark) for mark in product.marks])


def _off(product: Product, mark: GroundMark) -> float:
    height = product.height or 0.0 if mark.height is None else mark.height
    camera = bent_camera(product.model.camera, height, product.model.lacks)
    pixel, place = np.array([[mark.line, mark.column]]), np.radians([mark.longitude, mark.latitude])
    level = local_axes(*place).inv()

    def missed(h: float) -> Array:
        """East and north (m) from the mark to what the model sees at a height."""
        seen = camera.locate(pixel, Ellipsoid(height=h))[0]
        return level.apply(seen - from_geodetic(np.array([[*place, h]]))[0])[:2]

    east_north = missed(height)
    if mark.height is None:
        slope = (missed(height + _STEP) - east_north) / _STEP
        east_north = missed(height - float(slope @ east_north) / float(slope @ slope))
    return float(np.linalg.norm(east_north))
