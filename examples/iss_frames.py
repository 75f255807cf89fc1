"""Photographs taken at a window of the ISS, made ready for ``sightline recover``.

Run: python examples/iss_frames.py [OUT]
     sightline recover OUT/acquisition.toml --out result

Reads EXIF times and places, finds out how the camera was turned from the way the ground moves, and masks
clouds and snow by their brightness (clouds drift). Altitude and terrain height are general knowledge. Nothing
is copied.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from sightline.applications.frame_attitude import mount_by_motion
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.exif import write_photo_acquisition

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))
ALTITUDE, GROUND, GROUND_SIGMA = 420e3, 1000.0, 800.0
CLOUD = 165.0  # of 255


def write_cloud_mask(pixels: np.ndarray, path: Path) -> Path:
    """Everything within a few pixels of brightness above `CLOUD`, as a raster."""
    from scipy.ndimage import maximum_filter, uniform_filter

    np.save(path, maximum_filter(uniform_filter(pixels, 9) > CLOUD, size=9).astype(np.uint8))
    return path


def main() -> None:
    """Write acquisition.toml, positions.csv and the masks, and say how the camera was turned."""
    if {"-h", "--help"} & set(sys.argv):
        print(__doc__)
        sys.exit()
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="iss-frames-"))
    photos = sorted((DATA / "iss_astropi_a").glob("*.jpg"))
    if not photos:
        sys.exit(f"no photographs in {DATA / 'iss_astropi_a'}; set SIGHTLINE_DATA to the folder of real data")
    out.mkdir(parents=True, exist_ok=True)
    ground = (GROUND, GROUND_SIGMA)
    acquisition = load_acquisition(write_photo_acquisition(photos, out, height=ALTITUDE, ground=ground))
    mount = mount_by_motion(acquisition.frames, acquisition.surface).body_from_camera.as_quat()
    whole = [image.read((0, image.shape[0]), (0, image.shape[1])) for image in acquisition.images]
    masks = [write_cloud_mask(pixels, out / f"clouds_{k}.npy") for k, pixels in enumerate(whole)]
    toml = write_photo_acquisition(
        photos, out, height=ALTITUDE, body_from_camera=mount, ground=ground, masks=masks
    )
    print(f"{toml}: {len(photos)} frames, body_from_camera = {np.round(mount, 4).tolist()}")


if __name__ == "__main__":
    main()
