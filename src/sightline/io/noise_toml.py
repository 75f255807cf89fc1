"""A noise law and column pattern as the TDI.toml that a choice of TDI settings reads.

Not here: where the figures come from (``applications/strip_noise.py``).
"""

from __future__ import annotations

from pathlib import Path

from sightline.errors import FormatError
from sightline.imaging.tdi_noise import NoiseLaw
from sightline.writing import whole


def write_noise_toml(
    path: Path,
    law: NoiseLaw,
    *,
    columns: int,
    signals: tuple[float, float],
    full_well_sum: float,
    notes: list[str],
) -> None:
    """A TDI.toml of a measured law; all else in it is a placeholder and says so.

    Parameters
    ----------
    path : Path
    law : NoiseLaw
    columns : int
    signals : (float, float)
        Electrons of one line between which the choice is tabulated.
    full_well_sum : float
        Electrons that the sum can hold or its coding can tell.
    notes : list of str
        How well each figure is known; comments at the head of the file.

    Raises
    ------
    FormatError
        If the file cannot be written.
    """
    text = "".join(f"# {note}\n" for note in notes)
    text += f"""
[grid]                              # a placeholder: settings among which to choose
stages = [8, 16, 32, 64, 128]
integration_ratio = [0.25, 0.5, 0.75, 1.0]

[head]
stages = 0                          # the signal is measured elsewhere

[noise]
gain = {law.gain:.3g}                     # A, an upper bound
shot = {law.shot:g}                            # B, by the meaning of the conversion gain
read = {law.read:g}                            # C: charge is summed and read once
dark = {law.dark:.3g}                        # D, e- per stage, an upper bound
output = {law.output:.4g}                       # C_out, e- rms
column_fixed = {law.column_fixed:.3g}             # A_col

[columns]
count = {columns}                         # in step with the clock: the motion is not estimated here

[signals]
from = {signals[0]:.4g}
to = {signals[1]:.4g}
count = 32
integration_ratio = 1.0

[mtf]                               # placeholders: not estimated here
aperture_x = 1.0
aperture_y = 1.0
diffusion_sigma_px = 0.0
optics_mtf = 1.0

[choice]
model = "exact"
merit = "product"
full_well_sum = {full_well_sum:.4g}             # the top of the look-up table
"""
    try:
        with whole(path) as draft:
            draft.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror})") from None
