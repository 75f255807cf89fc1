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

import sightline
from sightline.applications.lag_sign import placed_by
from sightline.applications.registration import fit_every_pair
from sightline.io.init.bands import acquisition_of_bands, band_images
from sightline.io.init.presets import preset

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA")) / "s2_l1b_bands"
MSI, NAMES = preset("sentinel-2-msi"), ("B02", "B03", "B04", "B08")


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
        infrared = placed_by(found, acquired.bands, acquired.surface, 1, 3)
        off = (infrared.left_px, infrared.noise_px, infrared.stated_px) if infrared else 3 * (math.nan,)
        words = "{}: B02 to B04 {:.3f} / {:.3f} px, laid {:.3f} / {:.3f}; "
        words += "B08 {:.3f}, its noise {:.3f}, by the motion's sigma {:.3f}"
        print(words.format(image.stem, *before.rms_px, *after.rms_px, *off))
