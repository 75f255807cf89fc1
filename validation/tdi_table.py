"""Bytes of the TDI table against the loss it is certified for, on the reference example.

    python validation/tdi_table.py

240 columns, slip 0.1 + 1.2 x degrees and velocity 0.999 + 0.004 x^2 over x from -1 to 1, 160 signals from 1
to 8000 electrons, 126 numbers of stages x 20 integration ratios. All bytes of the memory image are counted:
head, ratios, limits of the cells, words. Beside it the uniform cells of a prototype, whose limits it
does not count. The target is 2.4 kB at 0.6 %.
"""

from __future__ import annotations

import time

import gates
import numpy as np

from sightline.imaging.tdi_noise import NoiseLaw
from sightline.imaging.tdi_transfer import Exposure
from sightline.tdi.choose import TdiChoice, choose_settings
from sightline.tdi.merit import DriftMtf
from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
from sightline.tdi.table_build import build_table

#: Bytes of words and loss of the prototype's uniform cells.
UNIFORM = {
    "product": {4800: 0.0016, 2400: 0.0054, 600: 0.020, 128: 0.049, 32: 0.139},
    "geomean": {4800: 0.0008, 2400: 0.0034, 600: 0.013, 128: 0.041, 32: 0.091},
    "min": {4800: 0.018, 2400: 0.036, 600: 0.078, 128: 0.14, 32: 0.23},
}
LOSSES = (0.001, 0.002, 0.006, 0.02, 0.05, 0.15)


def example(merit: str, columns: int = 240, signals: int = 160) -> tuple[DriftMtf, TdiChoice]:
    """Model and choice of the reference example."""
    x, f = np.linspace(-1.0, 1.0, columns), 0.5
    static = np.sinc(0.9 * f) * np.exp(-2.0 * (np.pi * 0.2 * f) ** 2) * 0.35
    scan = ScanColumns(
        np.arange(columns, dtype=float),
        0.999 + 0.004 * x**2,
        np.radians(0.1 + 1.2 * x),
        np.full((columns, 2), static),
    )
    grid = TdiGrid(np.arange(3, 129), 0.05 * np.arange(1, 21))
    detector = TdiDetector(Exposure(2, 0.25), NoiseLaw(9e-6, 1.0, 12.0))
    model = DriftMtf(scan, grid, detector.exposure, ChoiceRules(merit=merit))
    return model, choose_settings(model, np.geomspace(1.0, 8000.0, signals), grid, detector, model.rules)


def main() -> None:
    """Print the table."""
    print(
        "| merit | asked | certified | mean loss | bytes | groups | cells | seconds "
        "| uniform cells (prototype) |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for merit, uniform in UNIFORM.items():
        model, choice = example(merit)
        build_table(model, choice, 0.2)  # compile before anything is timed
        for asked in LOSSES:
            begin = time.process_time()
            table, certificate = build_table(model, choice, asked)
            seconds = time.process_time() - begin
            gates.check(
                f"{merit}, {100 * asked:g} %: certified over asked", certificate.loss / asked, 0.0, 1.0
            )
            if asked == 0.006:
                gates.check(f"{merit}, 0.6 %: bytes", certificate.bytes, 0, 2400)
            size = min((b for b, loss in uniform.items() if loss <= asked), default=None)
            other = "none" if size is None else f"{size} B at {100 * uniform[size]:.2g} %"
            print(
                f"| {merit} | {100 * asked:.1f} % | {100 * certificate.loss:.3f} % | "
                f"{100 * certificate.mean_loss:.3f} % | {certificate.bytes} | {len(table.edges) - 1} | "
                f"{len(table.words)} | {seconds:.2f} | {other} |",
                flush=True,
            )


if __name__ == "__main__":
    gates.run(main, __file__)
