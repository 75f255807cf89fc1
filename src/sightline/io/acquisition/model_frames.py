"""``[[frame]]`` of ``[platform] kind = "camera-model"``: lens, time and pose of each from its own ISD.

Not here: reading the file (``io/formats/isd_frame.py``), line scanners (``model_bands.py``).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.geometry.trajectory import Trajectory
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.acquisition.schema import AcquisitionFile
from sightline.io.formats.images import Source
from sightline.io.formats.isd_frame import LENS_PX, IsdFrame, read_frame_model


def frame_models(config: AcquisitionFile, image: Source, files: InputFolder) -> list[IsdFrame]:
    """The models of all frames; refused where they are not of one camera, or not of this image.

    What the lenses leave open is noted among the doubts of `files`.
    """
    models = [read_frame_model(files(entry.model or "")) for entry in config.frame]
    files.reference_et = models[0].et
    lens = models[0].detector
    if lens.shape != image.shape:
        raise FormatError(
            f"{files.toml}: [[frame]] number 1: {image.path.name} has {image.shape[0]} lines x "
            f"{image.shape[1]} columns, {config.frame[0].model} {lens.shape[0]} x {lens.shape[1]}; they must "
            "agree"
        )
    corners = np.array([[0.0, 0.0], [0.0, lens.shape[1] - 1.0], [lens.shape[0] - 1.0, 0.0]])
    looks = lens.directions(corners)
    for number, (entry, model) in enumerate(zip(config.frame, models, strict=True), 1):
        other = model.detector.shape != lens.shape
        if other or not np.abs(model.detector.pixels(looks) - corners).max() <= 2.0 * LENS_PX:
            raise FormatError(
                f"{files.toml}: [[frame]] number {number}: {entry.model} is of another camera than "
                f"{config.frame[0].model}; frames of one file are of one camera"
            )
    worst = max(model.lens_px for model in models)
    if worst > 0.1 * LENS_PX:
        files.doubts.append(f"the lens of the models is met to {worst:.2g} px")
    return models


def modelled_trajectory(models: list[IsdFrame]) -> Trajectory:
    """Positions and attitudes of all exposures; t = 0 is the first."""
    t = np.array([model.et - models[0].et for model in models])
    attitudes = Rotation.concatenate([model.world_from_body for model in models])
    return Trajectory(t, np.array([model.position for model in models]), t, attitudes)
