"""A real spinning camera: JunoCam at Jupiter, from raw framelets to a registered colour picture.

Run: python examples/junocam_spin_scan.py [OUT] [44C00030 | 44C00032 | 36C00061] [infinity]

Writes OUT/acquisition.toml with its frames and masks; OUT/recovered and OUT/picture are what `recover`
and `register` make of it.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

from sightline import write_junocam_acquisition
from sightline.cli.main import run

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))


def main() -> None:
    """Prepare, recover, register; say what was found."""
    if {"-h", "--help"} & set(sys.argv):
        print(__doc__)
        sys.exit()
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="junocam-"))
    name = sys.argv[2] if len(sys.argv) > 2 else "44C00030"
    folder = DATA / "junocam_spin_scan"
    images = sorted(folder.glob(f"*{name}*-raw.png"))
    if not images:
        sys.exit(f"no image {name} in {folder}; set SIGHTLINE_DATA to the folder of real data")
    # of the third image no metadata are known: its surface can only be taken for infinitely far
    metadata = sorted(folder.glob("*-Metadata.json")) if name.startswith("44C") else []
    toml = write_junocam_acquisition(images[0], out, metadata=metadata, infinity="infinity" in sys.argv)
    recovered, picture = out / "recovered", out / "picture"
    if run(["recover", str(toml), "--out", str(recovered), "--overwrite"]):
        return
    spin = json.loads((recovered / "summary.json").read_text(encoding="utf-8"))["spin"]
    sigma = {key: value * spin["interval"] for key, value in spin["rate_sigma"].items()}
    print(
        f"spin {spin['rate_per_exposure']:.7f} rad per exposure, +- {sigma['images']:.1g} from the images, "
        f"+- {sigma['camera']:.1g} from the camera, +- {sigma['parallax']:.1g} from the parallax"
    )
    print(f"rank {spin['rank']} of {spin['unknown_constants']}; weakest: {spin['weakest_direction']}")
    run(["register", str(toml), "--motion", str(recovered), "--out", str(picture), "--overwrite"])


if __name__ == "__main__":
    main()
