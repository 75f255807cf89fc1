"""Noise of a real TDI detector, from one raw image: law, column pattern, and a TDI.toml that uses them.

Run: python examples/tdi_noise.py [OUT] [ELECTRONS_PER_DN]

Reads a HiRISE channel (BG12, 64 stages, binning 4). The conversion gain is not in the image; 19.30 e-/DN is
what hiproc (github.com/rbeyer/hiproc, EDR_Stats_gains_config.pvl, BG12_0, Bin4) quotes from planning files.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from sightline.applications.strip_noise import estimate_strip_noise, figures, noise_law
from sightline.io.hirise_edr import read_hirise_edr
from sightline.io.noise_toml import write_noise_toml

DATA = Path(os.path.expandvars("$SIGHTLINE_DATA"))
IMAGE = "hirise_edr_bg12/PSP_001446_1790_BG12_0.IMG"


def main() -> None:
    """Estimate, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "out", metavar="OUT", type=Path, nargs="?", help="folder of tdi.toml; else a temporary one"
    )
    parser.add_argument(
        "conversion", metavar="ELECTRONS_PER_DN", type=float, nargs="?", default=19.30, help="above 0; 19.30"
    )
    given = parser.parse_args()
    out, conversion = given.out or Path(tempfile.mkdtemp(prefix="tdi-noise-")), given.conversion
    if not 0.0 < conversion < float("inf"):
        parser.error(f"ELECTRONS_PER_DN is {conversion:g}; a number above 0 is allowed")
    if not (DATA / IMAGE).is_file():
        sys.exit(f"no image {IMAGE} in {DATA}; set SIGHTLINE_DATA to the folder of real data")
    edr = read_hirise_edr(DATA / IMAGE)
    noise = estimate_strip_noise(edr.pixels())
    print(f"{edr.product}: {edr.stages} stages, binning {edr.binning}, {edr.image.image.shape} pixels")
    table = [str(figure) for figure in figures(noise, edr.stages, conversion)]
    print("\n".join(table))
    out.mkdir(parents=True, exist_ok=True)
    per_stage = conversion / edr.stages
    write_noise_toml(
        out / "tdi.toml",
        noise_law(noise, edr.stages, conversion),
        columns=edr.image.image.shape[1],
        signals=(0.1 * noise.percentiles[1] * per_stage, noise.ceiling * per_stage),
        full_well_sum=noise.ceiling * conversion,
        notes=[f"Noise of {edr.product}, sigma or bound (2 sigma) of each figure:", *table],
    )
    print(f"written: {out / 'tdi.toml'}")


if __name__ == "__main__":
    main()
