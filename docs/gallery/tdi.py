# %% [markdown]
# # TDI in pictures
#
# One detector of 40 columns. The scene drifts across the columns, and most at the edges of the field.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import sightline

columns = np.arange(40)
rows = [f"{c},{1 + 1e-5 * (c - 18.0) ** 2:.6f},{1e-3 * (c - 18.0):.6f}" for c in columns]
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
[choice]
full_well_line = 20000.0
""")
result = sightline.choose_tdi(sightline.load_tdi("tdi.toml"))
choice = result.to_xarray()

# %% [markdown]
# ## The number of stages for each column and signal

# %%
fig, ax = plt.subplots()
choice["stages"].plot(x="column", y="signal", yscale="log", cmap="viridis", ax=ax)

# %% [markdown]
# ## The exposure of a stage
#
# Bright scenes would fill the wells: there the exposure is shortened.

# %%
fig, ax = plt.subplots()
choice["integration_ratio"].plot(x="column", y="signal", yscale="log", cmap="magma", ax=ax)

# %% [markdown]
# ## Sharpness across the field
#
# MTF at half a cycle per pixel across the columns, and along them.

# %%
fig, ax = plt.subplots()
middle = choice.isel(signal=16)
ax.plot(columns, middle["mtf_x"], label="across")
ax.plot(columns, middle["mtf_y"], label="along")
ax.set_xlabel("column")
ax.set_ylabel("MTF")
ax.legend()

# %% [markdown]
# ## Signal over noise
#
# In the middle of the field, and at its edge, where fewer stages are summed.

# %%
fig, ax = plt.subplots()
for column in (18, 39):
    ax.loglog(choice["signal"], choice["snr"].sel(column=column), label=f"column {column}")
ax.set_xlabel("signal (electrons of one head line)")
ax.set_ylabel("SNR")
ax.legend()
