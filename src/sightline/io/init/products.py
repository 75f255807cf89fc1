"""An ACQUISITION.toml for products: it refers to their own metadata and images, and says what it rests on.

Not here: reading products (``io/formats/products/``), how well they agree with themselves (``agreement.py``).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from sightline.errors import InputError
from sightline.geometry.apparent import APPARENT
from sightline.io.formats.hirise_edr import is_hirise
from sightline.io.formats.instants import FIRST_YEAR, LAST_YEAR
from sightline.io.formats.junocam import is_metadata, junocam_frames
from sightline.io.formats.line_scan import shared_grid
from sightline.io.formats.products.product import Product, ProductBand
from sightline.io.formats.products.recognise import KNOWN, metadata_of, product_kind, read_product
from sightline.io.formats.products.sentinel2 import FINE, datastrip_of, read_granule_times
from sightline.io.init.agreement import agreement, contradiction
from sightline.io.init.bands import (
    FirstAcquisition,
    acquisition_of_bands,
    acquisition_text,
    band_images,
    judged_lags,
    path_from,
)
from sightline.io.init.hirise import acquisition_of_edrs
from sightline.io.init.mosaic import mosaic
from sightline.io.init.presets import PRESETS
from sightline.io.init.raw_bands import acquisition_of_raw_bands
from sightline.io.init.telemetry import FirstSensors, first_sensors
from sightline.io.names import toml_string
from sightline.writing import whole_text

#: Names of raw images of JunoCam.
_RAW = re.compile(r"JNC[ER]_\d{7}_.*\.(png|tiff?)$", re.IGNORECASE)
#: Endings of images that are looked for beside metadata that do not name them.
_IMAGES = (".tif", ".tiff", ".ntf", ".nitf", ".jp2", ".img", ".vrt", ".til")
#: s between the last line of a product and the first of another from which on they are two strips.
_APART = 60.0
#: m; what is not known of the height of the ground where a product says nothing; part of the scale of its
#: rational polynomials otherwise, which reach over all heights of the scene.
_HEIGHT_SIGMA, _OF_SCALE = 100.0, 1.0 / 3.0


def acquisition_of_products(
    paths: Sequence[Path], folder: Path, names: Sequence[str] = ()
) -> FirstAcquisition:
    """The acquisition of a product, or of several of one strip.

    Parameters
    ----------
    paths : sequence of Path
        Metadata of each product, or the folder that holds it. Images of raw bands beside the metadata of one
        product that tells their lags.
    folder : Path
        Where the file will lie: all paths are relative to it.
    names : sequence of str, optional
        Bands of images, as of `band_images`.

    Returns
    -------
    FirstAcquisition

    Raises
    ------
    FormatError
        Names the file, and what is missing or wrong.
    InputError
        If several products are no bands of one strip.
    """
    edrs = _edrs(paths)
    if edrs:
        if names:
            raise InputError("HiRISE EDRs take no --bands: each channel says of which CCD it is")
        return acquisition_of_edrs(edrs, folder)
    about = [path for path in paths if not path.is_dir() and is_metadata(path)]
    if about or all(_RAW.match(path.name) for path in paths):
        return _of_junocam([path for path in paths if path not in about], about, folder, names)
    files = [metadata_of(path) for path in paths]
    kinds = [product_kind(path) or "" for path in files]
    if any(kind.startswith("sentinel2") for kind in kinds):
        return _of_granule(files, kinds, folder, names)
    bare = [path for path in files if product_kind(path) is None]
    metadata = [path for path in files if path not in bare]
    if len(metadata) == 1 and bare:
        return acquisition_of_raw_bands(read_product(metadata[0]), bare, folder, names)
    if bare:
        raise InputError(
            f"{bare[0]}: is no metadata of a product; {KNOWN}; images without metadata are given with "
            f"--preset NAME ({', '.join(PRESETS)})"
        )
    if names:
        raise InputError("a product takes no --bands without images (give --preset NAME for bare images)")
    products: list[Product] = []
    for path in metadata:
        products.append(read_product(path, products[0].model.reference if products else None))
    _check(products)
    against = [words for words in map(contradiction, products) if words]
    images = [[_image(product, band, folder) for band in product.bands] for product in products]
    missing = [
        line for product, found in zip(products, images, strict=True) for line in _missing(product, found)
    ]
    sensors = first_sensors(products[0])
    told: list[Product | FirstSensors] = [*products, *([sensors] if sensors is not None else [])]
    assumed = tuple(dict.fromkeys(line for one in told for line in one.assumed))
    unknown = (*dict.fromkeys(line for one in told for line in one.unknown), *_unknown(products))
    parts = [_head(products), _platform(products, folder)]
    for product, found in zip(products, images, strict=True):
        for band, image in zip(product.bands, found, strict=True):
            parts.append(_band(product, band, image, folder, shared=len(products) == 1))
    outside = dict.fromkeys(
        path_from(path.parent, folder) for product in products for path in _tiles(product)
    )
    if outside:
        allowed = ", ".join(map(toml_string, outside))
        parts.append(f"[files]\nallow = [{allowed}]   # where the VRT beside this file has its pixels")
    parts += [_surface(products), *([sensors.text] if sensors is not None and sensors.text else [])]
    text = acquisition_text(assumed, (*unknown, *missing), parts, folder)
    found_out = tuple(
        words
        if len(products) == 1 or words.startswith(product.path.name)
        else f"{product.path.name}: {words}"
        for product in products
        for words in (f"{product.kind}, {_size(product)}", *agreement(product), *product.model.doubts)
    )
    still = _still(products)
    lacking = (*missing, *against, *([still] if still else []))
    return FirstAcquisition(text, assumed, unknown, found_out, lacking, _Beside(products, sensors, folder))


def _of_junocam(
    images: Sequence[Path], metadata: Sequence[Path], folder: Path, names: Sequence[str]
) -> FirstAcquisition:
    """Frames of a raw image of JunoCam: along the orbit by the metadata of two, or before an infinite sky."""
    if names:
        raise InputError("JunoCam takes no --bands: its framelets are blue, green and red in turn")
    if len(images) != 1:
        raise InputError(
            f"{(*images, *metadata)[0]}: {len(images)} raw images of JunoCam are given; give one image "
            "(JNCE_..._raw.png), its metadata, and those of another image of the same orbit"
        )
    alone = len(metadata) < 2
    begun = junocam_frames(images[0], metadata=metadata, infinity=alone)
    fit = begun.limb
    assumed = (
        "camera: focal length, pixels, distortion and lines of the strips of the published instrument kernel",
        "spin: 0.0778 rad between exposures, known to 2e-4",
        *(
            ()
            if fit is None
            else (
                "orbit: the arc of two bodies through the places of both metadata",
                f"attitude: by {fit.kept} points of the limb; its centre is known to {fit.sigma:.2g} rad, "
                f"the turn about the line to it to {fit.sigma_turn:.2g} rad",
            )
        ),
    )
    unknown = (
        *(
            (
                "where the camera was: give its metadata and those of another image of the same orbit too; "
                "until then the surface is infinitely far, and its parallax is part of every sigma",
            )
            if alone
            else ("heights of the clouds: one scale height of the atmosphere (25 km) for each colour",)
        ),
        "attitude of the day by other means: with kernels of SPICE (ck, fk, sclk of Juno) give [platform] "
        "attitude",
    )
    text = acquisition_text(assumed, unknown, [begun.text], folder)
    return FirstAcquisition(text, assumed, unknown, write=begun.write)


def _edrs(paths: Sequence[Path]) -> list[Path]:
    """Channels of HiRISE, of folders those that they hold; InputError where there are other files too."""
    files = [
        file for path in paths for file in (sorted(path.glob("*.[Ii][Mm][Gg]")) if path.is_dir() else [path])
    ]
    found = [file for file in files if is_hirise(file)]
    if found and len(found) < len(files):
        other = next(file for file in files if file not in found)
        raise InputError(
            f"{other}: is no HiRISE EDR, as {found[0].name} is; give products of one kind at a time"
        )
    return found


@dataclass(frozen=True)
class _Beside:
    """What is written beside ACQUISITION.toml, which will lie in `place`."""

    products: Sequence[Product]
    sensors: FirstSensors | None
    place: Path

    def __call__(self, folder: Path) -> None:
        if self.sensors is not None:
            self.sensors.write(folder)
        for product in self.products:
            # without its pixels a VRT is one error; a missing one leaves `check` to describe the geometry
            if product.pixels is not None and not _missing(product, []):
                files, shape = _tiles(product), product.model.camera.shape
                text = mosaic(product.pixels, files, shape, len(product.bands), self.place)
                whole_text(folder / f"{product.path.stem}.vrt", text)


def _tiles(product: Product) -> list[Path]:
    """The files of an image that is made of several, or of bare numbers; none of others."""
    return [] if product.pixels is None else [_beside(product, tile.image) for tile in product.pixels.tiles]


def _of_granule(
    files: Sequence[Path], kinds: Sequence[str], folder: Path, names: Sequence[str]
) -> FirstAcquisition:
    """Bands of 10 m of a Sentinel-2 L1B granule: times by its datastrip, look angles by what is published."""
    granules = [path for path, kind in zip(files, kinds, strict=True) if kind == "sentinel2-granule"]
    strips = [path for path, kind in zip(files, kinds, strict=True) if kind == "sentinel2-datastrip"]
    if len(granules) == 1 and not strips:
        strips = [path for path in [datastrip_of(granules[0])] if path is not None]
    if len(granules) != 1 or len(strips) != 1:
        raise InputError(
            f"{files[0]}: {len(granules)} granules and {len(strips)} datastrips of Sentinel-2 L1B are given; "
            "give the metadata of one granule (MTD_L1B_GR) and of its datastrip (MTD_L1B_DS)"
        )
    times = read_granule_times(granules[0], strips[0])
    images = [path for path in files if path not in (granules[0], strips[0])]
    for name in FINE if not images else ():
        found = sorted((granules[0].parent / "IMG_DATA").glob(f"*_{name}.*"))
        images += [path for path in found if path.suffix.lower() in _IMAGES][:1]
    if not images:
        raise InputError(
            f"{granules[0]}: no images of {', '.join(FINE)} lie in IMG_DATA beside it; put them there, or "
            "give them too"
        )
    known = PRESETS["sentinel-2-msi"]
    preset = replace(
        known,
        instrument=f"Sentinel-2 L1B, detector {times.detector}, bands of 10 m from line {times.position} on",
        lags=times.lags,
        lag_sigma=0.0,
        altitude=times.height,
        line_period=times.line_period,
        ground_speed=known.pixel / times.line_period,
        signed=True,
        epoch=times.epoch,
        sources=(
            f"lags and line period: {strips[0].name} (Time_Stamp); altitude: its Ephemeris",
            "pixel 10 m: ESA, Sentinel-2 User Handbook, 2015",
        ),
    )
    bands = band_images(preset, images, names)
    begun = acquisition_of_bands(preset, bands, folder)
    said = judged_lags(strips[0], preset, known, bands)
    unknown = (
        *begun.unknown,
        "where columns look: in calibration files (GIPP) that are no part of the product",
        "bands of 20 and 60 m: give those of 10 m",
    )
    return replace(begun, unknown=unknown, found=said)


def _size(product: Product) -> str:
    lines, columns = product.model.camera.shape
    return f"{lines} lines x {columns} columns, bands {', '.join(band.name for band in product.bands)}"


def _still(products: Sequence[Product]) -> str:
    """Why `recover` would refuse these; empty where it would not."""
    if sum(len(product.bands) for product in products) == 1:
        (band,) = products[0].bands
        return (
            f"one band ({band.name}): motion is seen between two or more bands of one strip; give the "
            "product of the other bands too"
        )
    grid = shared_grid([product.model.one_grid for product in products])
    return "" if grid is None else grid.reason


def _check(products: Sequence[Product]) -> None:
    """InputError unless these can be bands of one strip."""
    for a, b in combinations(products, 2):
        where = f"{a.path} and {b.path}"
        if a.path.resolve() == b.path.resolve():
            raise InputError(f"{where} are one product; give it once")
        ends = [product.model.camera.times([0.0, product.model.camera.lines - 1.0]) for product in (a, b)]
        gap = max(float(ends[1][0] - ends[0][1]), float(ends[0][0] - ends[1][1]))
        if gap > _APART:
            raise InputError(
                f"{where} were exposed {gap:.0f} s after one another: they are two strips; write an "
                "acquisition for each (a stereo pair goes to `orient`, [[strip]])"
            )
        alike = sorted({band.name for band in a.bands} & {band.name for band in b.bands})
        if alike:
            raise InputError(
                f"{where} both hold the band {alike[0]}: parts of one strip, or two looks; bands of one "
                "strip that show the same ground are expected: write an acquisition for each"
            )


def _missing(product: Product, images: Sequence[Path]) -> list[str]:
    """What is said of files that are not there: of the tiles of an image, or of the `images` of its bands."""
    tiles = [path for path in _tiles(product) if not path.is_file()]
    if tiles:
        more = f" (and {len(tiles) - 1} tiles more)" if len(tiles) > 1 else ""
        return [
            f"{tiles[0].name}{more}: no such file beside {product.path.name}; put it there, and run "
            "`sightline init` again"
        ]
    return [
        f"{path.name}: no such file beside {product.path.name}; put it there, or correct `image`"
        for path in dict.fromkeys(images)
        if product.pixels is None and not path.is_file()
    ]


def _image(product: Product, band: ProductBand, folder: Path) -> Path:
    """The image of a band beside the metadata; where it is not there, where it should be."""
    if product.pixels is not None:
        return folder / f"{product.path.stem}.vrt"
    if band.image:
        return _beside(product, band.image)
    stem = product.path.stem
    found = [_beside(product, f"{stem}{ending}") for ending in _IMAGES]
    return next((path for path in found if path.is_file()), product.path.parent / f"{stem}.TIF")


def _beside(product: Product, name: str) -> Path:
    """A file beside the metadata, in whatever case its name is written there."""
    folder = product.path.parent
    files = {file.name.lower(): file for file in sorted(folder.iterdir()) if file.is_file()}
    return files.get(name.lower(), folder / name)


def _unknown(products: Sequence[Product]) -> tuple[str, ...]:
    """What no product says."""
    return (
        "heights of the ground within the scene: one height, that of the product, with height_sigma; give "
        "[surface] dem for the real ones",
        *(
            f"{product.path.name}: how well its attitudes are known: attitude_sigma is the default"
            for product in products
            if product.attitude_sigma is None
        ),
    )


def _head(products: Sequence[Product]) -> str:
    first = products[0]
    lines = ["[acquisition]", f"name = {toml_string(' and '.join(p.name for p in products)[:200])}"]
    if FIRST_YEAR <= int(first.epoch[:4]) <= LAST_YEAR:
        lines.append(f"epoch = {toml_string(first.epoch)}   # t = 0: line 0 of {first.bands[0].name}")
    return "\n".join(lines)


def _platform(products: Sequence[Product], folder: Path) -> str:
    """The model, what is applied to it, and how well its attitudes are known."""
    lines = ["[platform]", 'kind = "camera-model"']
    if len(products) == 1:
        lines.append(f"model = {toml_string(path_from(products[0].path, folder))}")
    lacks = {product.model.lacks for product in products}
    if len(lacks) == 1:
        (held,) = lacks
        for key in APPARENT:
            why = "the maker's attitudes do not hold it" if key in held else "the maker's attitudes hold it"
            lines.append(f"{key} = {'true' if key in held else 'false':5}   # {why}")
    sigmas = [product.attitude_sigma for product in products if product.attitude_sigma is not None]
    if len(sigmas) == len(products):
        lines.append(
            f"attitude_sigma = {max(sigmas):.3g}   # rad: by the maker, one error for the whole strip"
        )
    return "\n".join(lines)


def _band(product: Product, band: ProductBand, image: Path, folder: Path, *, shared: bool) -> str:
    lines = ["[[band]]", f"name = {toml_string(band.name)}"]
    lines.append(f"image = {toml_string(path_from(image, folder))}")
    if band.image_band != 1:
        lines.append(f"image_band = {band.image_band}")
    if not shared:
        lines.append(f"model = {toml_string(path_from(product.path, folder))}")
    return "\n".join(lines)


def _surface(products: Sequence[Product]) -> str:
    heights = [product.height for product in products if product.height is not None]
    scales = [product.rpc.height[1] * _OF_SCALE for product in products if product.rpc is not None]
    height = heights[0] if heights else 0.0
    where = "m above the ellipsoid: by the product" if heights else "m above the ellipsoid: not known"
    return "\n".join(
        [
            "[surface]",
            f"height = {height:.1f}   # {where}",
            f"height_sigma = {max(scales, default=_HEIGHT_SIGMA):.0f}   # m: relief that is not known",
        ]
    )
