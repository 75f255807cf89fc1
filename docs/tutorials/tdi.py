# %% [markdown]
# # A TDI detector
#
# More TDI stages collect more light, and blur what does not move in step with the clock. Which number is best depends on the
# column and on the signal. Here we choose it.
#
# ## The detector
#
# Noise, the stages that can be set, and how the scene moves over each column: `scan_velocity` in pixels per line (1 is in step),
# `slip` the angle between its motion and the column.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import sightline

columns = np.arange(40)
velocity = 1.0 + 1e-5 * (columns - 18.0) ** 2
slip = 1e-3 * (columns - 18.0)
rows = [f"{c},{v:.6f},{s:.6f}" for c, v, s in zip(columns, velocity, slip, strict=True)]
Path("columns.csv").write_text("column,scan_velocity,slip\n" + "\n".join(rows) + "\n")
Path("tdi.toml").write_text("""
[grid]
stages = { from = 3, to = 128 }
integration_ratio = { from = 0.1, to = 1.0, step = 0.1 }
[head]
stages = 2
integration_ratio = 0.25
[noise]
gain = 9e-6
read = 12.0
[columns]
table = "columns.csv"
[signals]
from = 1
to = 8000
count = 32
[mtf]
optics_mtf = 0.35
diffusion_sigma_px = 0.2
""")
# %% [markdown]
# ## Choose
#
# The choice maximises MTF times SNR, and states what the stored table loses against the best setting at most.

# %%
result = sightline.choose_tdi(sightline.load_tdi("tdi.toml"))
result

# %% [markdown]
# The number of stages by column and signal. Columns at the edges slip most, and get fewest.

# %%
choice = result.to_xarray()
fig, ax = plt.subplots()
choice["stages"].plot(x="column", y="signal", yscale="log", cmap="viridis", ax=ax)

# %% [markdown]
# What that gives for a dark scene: the MTF across columns, and the SNR.

# %%
table = result.to_pandas()
dark = table[np.isclose(table["signal"], table["signal"].unique()[12])]
fig, axes = plt.subplots(1, 2)
for ax, key in zip(axes, ("mtf_x", "snr"), strict=True):
    ax.plot(dark["column"], dark[key], ".-")
    ax.set_xlabel("column")
    ax.set_ylabel(key)

# %% [markdown]
# ## The table for the flight computer
#
# A lookup takes signals of the first stages and gives packed words, at line rate.

# %%
result.write("settings", pictures=False)
lookup = sightline.TdiTable.read("settings/table.bin")
signals = np.tile([[40], [900]], (1, len(columns)))
stages, ratio = lookup.unpack(lookup.lookup(signals))
print(stages)
print(f"loses at most {100 * result.certificate.loss:.2f} % of the merit")

# %% [markdown]
# ## Go on
#
# - [The guide](../tdi.md): columns from a camera, and the motion of the last strip (`--motion`).
# - [Every key of TDI.toml](../formats/tdi-toml.md), [the theory](../theory/s3.md).
