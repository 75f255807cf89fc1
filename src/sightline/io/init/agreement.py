"""How a product's rigorous model agrees with what the product itself says: its rational polynomials, corners.

Not here: reading products (``io/formats/products/``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.errors import FormatError
from sightline.geometry.apparent import bent_camera
from sightline.geometry.earth import from_geodetic, local_axes, to_geodetic
from sightline.geometry.surface import Ellipsoid
from sightline.io.formats.products.product import GroundMark, Product

Array = NDArray[np.float64]

#: Pixels each way and heights of the lattice on which rational polynomials are compared.
_LATTICE, _HEIGHTS = 9, 5
#: px by which a model may lie off what its product says of itself unsaid: those at hand are .3 px off at
#: most, 20 m (aberration applied where attitudes hold it) are 10 px and more.
_MOST_PX = 10.0
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


def contradiction(product: Product) -> str:
    """In words, where the model and what the product says of itself contradict each other; else empty.

    FormatError where the model does not see the Earth.
    """
    size = _pixel_size(product)
    off = [("corners", float(mark_residuals(product).max()) / size)] if product.marks else []
    if product.rpc is not None:
        off.append(("RPC", float(np.sqrt((rpc_residuals(product) ** 2).sum(axis=1).mean()))))
    worst = max(off, key=lambda one: one[1], default=("", 0.0))
    if worst[1] <= _MOST_PX:
        return ""
    return (
        f"{product.path.name}: its model is {worst[1]:.3g} px ({worst[1] * size:.3g} m) off its own "
        f"{worst[0]}: units, a sign or the size of its image is not as told; fetch the file again, or ask "
        "its maker"
    )


def _pixel_size(product: Product) -> float:
    """m on the ground from the middle pixel of a line to the next."""
    lines, columns = product.model.camera.shape
    pixels = np.array([[lines // 2, columns // 2 - 1], [lines // 2, columns // 2]], dtype=np.float64)
    a, b = product.model.camera.locate(pixels, Ellipsoid(height=product.height or 0.0))
    if not np.isfinite([a, b]).all():
        raise FormatError(
            f"{product.path}: the middle of its image does not look at the Earth by its attitudes and looks; "
            "the order of their quaternions, an axis or a unit is not as told: fetch the file again"
        )
    return float(np.linalg.norm(b - a))


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
