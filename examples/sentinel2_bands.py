"""Real Sentinel-2 bands in sensor geometry: blue, green and red give the motion; B08 is placed by it.

Run: python examples/sentinel2_bands.py [OUT]. The crops have no metadata: height, speed, pixel and lags are
those of `sightline init --preset sentinel-2-msi`; the staggered detectors of scenes 03 to 07 look in the
other order. Without truth, what counts is how well bands fit that are laid on one another (along / across
px). And B08, of which only offset, turn and scale are fitted (px across, means over 44 lines), beside what
its matches' noise and the covariance of the motion let expect.
"""

import math
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import sightline
from sightline.applications.registration import fit_every_pair
from sightline.geometry.conjugate import predict_match
from sightline.io.init.bands import acquisition_of_bands, band_images
from sightline.io.init.presets import preset
from sightline.motion.measure.windows import window_grid
from sightline.motion.statics import recovered_cameras

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA")) / "s2_l1b_bands"
MSI, NAMES = preset("sentinel-2-msi"), ("B02", "B03", "B04", "B08")


def infrared(acquired, motion, statics) -> tuple[float, float]:
    """How far B08 lies from B03, and the noise of that."""
    cameras = recovered_cameras(acquired.bands, motion, statics)
    points = window_grid((352, 352), (12, 64), 12).centres
    there = predict_match(cameras[1], cameras[3], acquired.surface, points)
    points, there = (p[np.isfinite(there[:, 0])] for p in (points, there))
    match = sightline.match_images(*acquired.images[1:4:2], points, there, window=(12, 64), search_px=(6, 6))
    left, (line, column) = (match.b - there)[match.kept, 1], points[match.kept].T
    shape, good = np.column_stack([np.ones_like(line), line, column]), np.ones(len(left), dtype=bool)
    for _ in range(5):  # windows that show something else than ground are left out
        left = left - shape @ np.linalg.lstsq(shape[good], left[good], rcond=None)[0]
        good = np.abs(left) < 3.0 * 1.4826 * np.median(np.abs(left[good]))
    rows = [left[good & (line // 44 == k)] for k in range(8)]
    means = np.array([(r.mean(), r.std() / math.sqrt(len(r))) for r in rows if len(r) > 4])
    return tuple(np.sqrt((means**2).mean(axis=0)))


def expected(bands, found) -> float:
    """What the covariance of roll leaves of these means, offset and drift of B08 fitted, px."""
    t, weights = found.motion.t, np.zeros((len(found.motion.t), 3, 8))
    for band, sign in ((bands[3], 1.0), (bands[1], -1.0)):
        for k, times in enumerate(band.camera.times(np.arange(352.0)).reshape(8, 44)):
            share = [np.interp(times, t, unit).mean() for unit in np.eye(len(t))]
            weights[:, 0, k] += sign * np.array(share)
    left = np.eye(8) - (line := np.vander(np.arange(8.0), 2)) @ np.linalg.pinv(line)
    covariance = left @ found.functional_covariance(weights) @ left
    return float(np.sqrt(np.trace(covariance) / 8) / found.ifov)


if __name__ == "__main__":
    if {"-h", "--help"} & set(sys.argv):
        print(__doc__)
        sys.exit()
    out = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="sentinel2-"))
    if not (crops := sorted(DATA.glob("*.tif"))) or out.resolve() == DATA.resolve():
        sys.exit(f"no crops in {DATA}, or OUT is that folder; set SIGHTLINE_DATA to the folder of real data")
    out.mkdir(parents=True, exist_ok=True)
    for image in crops:
        sign = -1 if image.stem in ("03", "04", "05", "06", "07") else 1
        begun = acquisition_of_bands(MSI, band_images(MSI, [image], NAMES), out, sign)
        (out / f"{image.stem}.toml").write_text(begun.text, encoding="utf-8")
        acquired = sightline.load_acquisition(out / f"{image.stem}.toml")
        found = sightline.recover_line_of_sight(acquired.bands[:3], acquired.surface)
        statics = {estimate.name: estimate.value for estimate in found.statics}
        laid = sightline.register_bands(acquired.bands[:3], acquired.surface, found.motion, statics)
        before, after = (fit_every_pair(images)[1] for images in (laid.before, laid.after))
        off = (*infrared(acquired, found.motion, statics), expected(acquired.bands, found))
        words = "{}: B02 to B04 {:.3f} / {:.3f} px, laid {:.3f} / {:.3f}; "
        words += "B08 {:.3f}, its noise {:.3f}, by the motion's sigma {:.3f}"
        print(words.format(image.stem, *before.rms_px, *after.rms_px, *off))
