"""``[[band]]`` of ``[platform] kind = "camera-model"``: cameras from sensor-model files.

Not here: reading the file (``io/formats/sensor_model.py``), what bends light (``apparent.py``), bands with a
trajectory of their own (``bands.py``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sightline.errors import FormatError
from sightline.geometry.camera import PushbroomCamera
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.bands import match_sigma_of, open_band_image, pieces_of
from sightline.io.acquisition.schema import AcquisitionFile, BandSection
from sightline.io.acquisition.spin import mount_of
from sightline.io.acquisition.stages import stages_of
from sightline.io.formats.images import Source
from sightline.io.formats.line_scan import LineScanModel, of_size
from sightline.io.formats.sensor_model import read_sensor_model
from sightline.motion.band import Band


def build_model_bands(config: AcquisitionFile, files: InputFolder, *, look: bool = True) -> tuple[Band, ...]:
    """Every band with the camera of its model, or of the model that ``[platform]`` shares.

    Parameters
    ----------
    config, files, look
        As of `bands.build_bands`.

    Returns
    -------
    tuple of Band
        t = 0 is the first line of the first band's model.

    Notes
    -----
    ``look_ahead``, ``offset_px`` and ``rotation`` are applied on top of the model; ``first_line_time``
    replaces the model's. An image that is a part of the model's says by ``first_pixel`` where it begins.
    """
    shared = getattr(config.platform, "model", None)
    bands: list[Band] = []
    first: LineScanModel | None = None
    read: dict[tuple[str, int], LineScanModel] = {}
    for index, band in enumerate(config.band):
        where = f"{files.toml}: [[band]] number {index + 1} ({band.name})"
        name = band.model or shared
        if name is None:
            raise FormatError(f"{where}: model is missing; give it there or in [platform]")
        _refuse_own_geometry(config, band, where)
        key = name, band.image_band
        if key not in read:
            reference = None if first is None else first.reference
            read[key] = read_sensor_model(files(name), reference, band.image_band)
        model = read[key]
        first = first or model
        if model.scale != first.scale:
            raise FormatError(
                f"{where}: {name} counts time in {model.scale}, that of the first band in {first.scale}; "
                "give the bands of one strip models of one kind"
            )
        files.doubts += model.doubts
        files.bends.append(model.lacks)
        # bands that are said to look elsewhere, or at another time, are not those of the maker's one grid
        own = band.look_ahead != 0.0 or band.first_line_time is not None
        files.grids.append(None if own else model.one_grid)
        files.reference_et, files.body = model.reference_et, files.body or model.body
        files.radii = files.radii or model.radii
        begin = band.first_pixel or (0, 0)
        rest = (model.camera.shape[0] - begin[0], model.camera.shape[1] - begin[1])
        image = open_band_image(band, files, look=look, shape=files.sizes.get(band.name, rest))
        if band.first_pixel is not None:
            model = replace(model, camera=_part(model.camera, begin, image, f"{where}: {name}"))
        elif image.shape == model.padded:
            model = replace(model, camera=of_size(model.camera, image.shape))
        if image.shape != model.camera.shape:
            raise FormatError(
                f"{where}: {image.path.name} has {image.shape[0]} lines x {image.shape[1]} columns, {name} "
                f"{model.camera.shape[0]} x {model.camera.shape[1]}; they must agree"
            )
        bands.append(
            Band(
                band.name,
                image,
                replace(
                    _placed(model, band, config),
                    stages=stages_of(band, image.shape, where, files),
                    time_reference=band.time_reference or "centre",
                ),
                band.offset_sigma_px,
                band.rotation_sigma,
                band.scale_sigma,
                match_sigma_of(band, image, files),
                band.shape,
                band.shape_sigma_px,
                pieces_of(band, image, files),
            )
        )
    return tuple(bands)


def _refuse_own_geometry(config: AcquisitionFile, band: BandSection, where: str) -> None:
    """The model brings its own focal plane and times."""
    for key in ("ifov", "columns", "line_period", "directions", "line_times"):
        if getattr(band, key, None) is not None or getattr(config.instrument, key, None) is not None:
            raise FormatError(f"{where}: {key} is given, but the model file brings it; remove it")


def _part(camera: PushbroomCamera, begin: tuple[int, int], image: Source, where: str) -> PushbroomCamera:
    """The camera of an image that is a part of its own and begins at a pixel (line, column) of that."""
    end = begin[0] + image.shape[0], begin[1] + image.shape[1]
    if end[0] > camera.lines or end[1] > camera.columns:
        raise FormatError(
            f"{where} has {camera.lines} lines x {camera.columns} columns; {image.path.name} ("
            f"{image.shape[0]} x {image.shape[1]}) that begins at first_pixel {list(begin)} ends beyond them"
        )
    times = camera.line_times
    return replace(
        camera,
        detector=replace(camera.detector, directions=camera.detector.directions[begin[1] : end[1]]),
        first_line_time=float(camera.times([float(begin[0])])[0]),
        lines=image.shape[0],
        line_times=None if times is None else times[begin[0] : end[0]],
    )


def _placed(model: LineScanModel, band: BandSection, config: AcquisitionFile) -> PushbroomCamera:
    """The model's camera with the band's own name, offsets and time."""
    camera = model.camera
    detector = camera.detector
    ahead_px = float(np.tan(band.look_ahead)) / detector.pixel_step
    detector = detector.adjusted(ahead_px + band.offset_px[0], band.offset_px[1], band.rotation)
    first, times = camera.first_line_time, camera.line_times
    if band.first_line_time is not None:
        times = None if times is None else times + (band.first_line_time - first)
        first = band.first_line_time
    mount = mount_of(config.camera) if config.camera.body_from_camera is not None else camera.pointing
    return PushbroomCamera(detector, camera.trajectory, mount, first, camera.lines, line_times=times)
