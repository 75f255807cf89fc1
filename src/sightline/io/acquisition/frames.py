"""``[[frame]]`` and ``[camera]`` → images with their nominal frame cameras, and how well the lens is known.

Not here: line detectors (``bands.py``), the trajectory of the platform (``platform.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError, SpanError
from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.model_frames import frame_models, modelled_trajectory
from sightline.io.acquisition.platform import build_trajectory
from sightline.io.acquisition.schema import AcquisitionFile, CameraModelPlatform, FrameSection, SpinPlatform
from sightline.io.acquisition.spin import pointing_of
from sightline.io.acquisition.strips import cut_into_strips
from sightline.io.formats.exif import read_exif
from sightline.io.formats.images import MissingImage, Source, check_band, check_content, open_image
from sightline.io.formats.instants import seconds_from_epoch
from sightline.io.formats.isd_frame import read_frame_model
from sightline.motion.band import Frame, LensKnowledge

#: Start value of an unknown focal length and its sigma, in larger sides of the frame (1.0: 53 degrees).
FOCAL_START, FOCAL_SHARE = 1.0, 0.4
#: Sigma of an unknown principal point, in larger sides of the frame.
PRINCIPAL_SHARE = 0.05
#: Sigma of an unknown k1.
DISTORTION_SIGMA = 0.2


def build_frames(config: AcquisitionFile, files: InputFolder, *, look: bool = True) -> tuple[Frame, ...]:
    """Every ``[[frame]]`` with its image and nominal camera.

    Parameters
    ----------
    config, files, look
        As of `bands.build_bands`.

    Returns
    -------
    tuple of Frame
        Empty when the file has bands.
    """
    if not config.frame:
        return ()
    spins = isinstance(config.platform, SpinPlatform)
    shape = _shape_of_missing(config, files)
    images = [_open_frame_image(entry, files, shape, look=look, sky=spins) for entry in config.frame]
    if isinstance(config.platform, CameraModelPlatform):
        models = frame_models(config, images[0], files)
        detector, times = models[0].detector, [model.et - models[0].et for model in models]
    else:
        models, detector = [], area_detector(config, images[0], files)
        times = [frame_time(entry, config.acquisition.epoch, files) for entry in config.frame]
    _check_frames(config, images, times, files)
    shake = 5.0 * max(entry.time_sigma for entry in config.frame) + abs(config.camera.readout_time)
    span = min(times) - abs(config.camera.readout_time), max(times) + abs(config.camera.readout_time)
    known = modelled_trajectory(models) if models else build_trajectory(config, files, span)
    trajectory = extended(known, shake)
    pointing = pointing_of(config, files, span)
    names = [entry.name or Path(entry.image).stem for entry in config.frame]
    frames = tuple(
        Frame(
            name,
            image,
            FrameCamera(detector, trajectory, pointing, t, config.camera.readout_time),
            entry.time_sigma,
            exposure,
        )
        for exposure, (name, image, t, entry) in enumerate(
            zip(names, images, times, config.frame, strict=True)
        )
    )
    return cut_into_strips(config, frames, files) if config.camera.strip else frames


def _shape_of_missing(config: AcquisitionFile, files: InputFolder) -> tuple[int, int] | None:
    """Lines and columns of images that are not there, where these are only described and anything says it."""
    if not files.describing or config.camera.shape is not None:
        return config.camera.shape
    there = next((entry for entry in config.frame if not files.lacks_file(entry.image)), None)
    if there is not None:
        return open_image(files(there.image), there.image_band).shape
    model = config.frame[0].model
    return None if model is None else read_frame_model(files(model)).detector.shape


def _open_frame_image(
    entry: FrameSection, files: InputFolder, shape: tuple[int, int] | None, *, look: bool, sky: bool
) -> Source:
    """The image of a frame, opened and looked into; it may be masked as a whole where it may show the sky.

    Of that `shape` if it is not there and need not be.
    """
    if shape is not None and files.lacks(entry.image, shape):
        return MissingImage(files.path(entry.image), shape)
    mask = None if entry.mask is None else files(entry.mask)
    image = open_image(files(entry.image), entry.image_band, mask)
    check_band(image, entry.image_band, "image_band")
    if look:
        check_content(image, may_be_masked=sky)
    return image


def _check_frames(
    config: AcquisitionFile, images: list[Source], times: list[float], files: InputFolder
) -> None:
    """All frames of one shape, in the order of their times, with different names."""
    for image in images:
        if image.shape != images[0].shape:
            raise FormatError(
                f"{image.path}: {image.shape[0]} lines x {image.shape[1]} columns; {config.frame[0].image} "
                f"has {images[0].shape[0]} x {images[0].shape[1]}; frames of one camera have one shape"
            )
    for k in range(1, len(times)):
        if times[k] <= times[k - 1]:
            word = "the same time as" if times[k] == times[k - 1] else "a time before"
            raise FormatError(
                f"{files.toml}: [[frame]] number {k + 1} ({config.frame[k].image}) has {word} the one "
                f"before it ({times[k]:.6g} s, {times[k - 1]:.6g} s); times must increase; sort the frames "
                "or correct the time"
            )


def area_detector(config: AcquisitionFile, image: Source, files: InputFolder) -> AreaDetector:
    """The detector of ``[camera]``; what is to be estimated starts from a guess (see `lens_knowledge`)."""
    camera = config.camera
    shape = camera.shape or image.shape
    if shape != image.shape:
        raise FormatError(
            f"{files.toml}: [camera] shape = {list(shape)}, {image.path.name} has {list(image.shape)} "
            "(lines, columns); they must agree; are lines and columns swapped?"
        )
    focal = camera.focal_length_px
    if focal is None:
        raise FormatError(f'{files.toml}: [camera] focal_length_px is missing; give a number or "estimate"')
    middle = (shape[0] - 1) / 2.0, (shape[1] - 1) / 2.0
    principal = camera.principal_point_px
    return AreaDetector(
        "camera",
        shape,
        FOCAL_START * max(shape) if focal == "estimate" else float(focal),
        middle
        if principal is None or principal == "estimate"
        else (float(principal[0]), float(principal[1])),
        () if camera.distortion == "estimate" else tuple(float(value) for value in camera.distortion),
    )


def lens_knowledge(config: AcquisitionFile, shape: tuple[int, int] | None) -> LensKnowledge:
    """Sigmas of the lens: those of the file, or wide ones where it says "estimate".

    `shape` is that of the frames, None for line detectors.
    """
    camera = config.camera
    if shape is None:
        return LensKnowledge()
    larger = float(max(shape))
    estimate = "estimate"
    focal = camera.focal_length_sigma_px
    principal = camera.principal_point_sigma_px
    return LensKnowledge(
        FOCAL_SHARE * FOCAL_START * larger if camera.focal_length_px == estimate else focal,
        PRINCIPAL_SHARE * larger if camera.principal_point_px == estimate else principal,
        DISTORTION_SIGMA if camera.distortion == estimate else camera.distortion_sigma,
    )


def frame_time(entry: FrameSection, epoch: str | None, files: InputFolder) -> float:
    """Seconds from the epoch of a frame's ``time``: a number, a UTC instant, or "exif"."""
    assert entry.time is not None  # the schema asks for it
    if not isinstance(entry.time, str):
        return float(entry.time)
    if epoch is None:
        raise FormatError(
            f"{files.toml}: time = {entry.time!r} of {entry.image} is an instant and [acquisition] has no "
            'epoch; add epoch = "..." (UTC of t = 0)'
        )
    text = entry.time
    if text == "exif":
        text = read_exif(files(entry.image)).time
    return seconds_from_epoch(text, epoch, f"{files.toml}: time of {entry.image}")


def extended(trajectory: Trajectory, margin: float) -> Trajectory:
    """A trajectory carried on straight by `margin` seconds at both ends.

    Frames whose time stamps are uncertain may have been exposed a little before the first or after the
    last position of the table; nothing else may extrapolate.
    """
    first, last = trajectory.span
    if margin <= 0.0 or len(trajectory.t_position) < 2:
        return trajectory
    t, p, v = trajectory.t_position, trajectory.position, trajectory.velocity
    before = p[0] + (p[1] - p[0]) / (t[1] - t[0]) * -margin
    after = p[-1] + (p[-1] - p[-2]) / (t[-1] - t[-2]) * margin
    a, turns = trajectory.t_attitude, trajectory.world_from_body
    if len(a) < 2:
        raise SpanError(
            f"one attitude at t = {first:.6g} s, the frames reach to {last:.6g} s; give two or more"
        )
    rate_first = (turns[0].inv() * turns[1]).as_rotvec() / (a[1] - a[0])
    rate_last = (turns[-2].inv() * turns[-1]).as_rotvec() / (a[-1] - a[-2])
    ends = [
        turns[0] * Rotation.from_rotvec(-margin * rate_first),
        turns[-1] * Rotation.from_rotvec(margin * rate_last),
    ]
    return Trajectory(
        np.concatenate([[t[0] - margin], t, [t[-1] + margin]]),
        np.vstack([before, p, after]),
        np.concatenate([[a[0] - margin], a, [a[-1] + margin]]),
        Rotation.concatenate([ends[0], turns, ends[1]]),
        epoch=trajectory.epoch,
        velocity=None if v is None else np.vstack([v[:1], v, v[-1:]]),
    )
