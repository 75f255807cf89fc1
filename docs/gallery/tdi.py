# %% [markdown]
# # TDI in pictures
#
# One detector of 40 columns. The scene drifts across the columns, and most at the edges of the field.

# %%
# !sightline init --template tdi --out detector

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import sightline

columns = np.arange(40)
rows = [f"{c},{1 + 1e-5 * (c - 18.0) ** 2:.6f},{1e-3 * (c - 18.0):.6f}" for c in columns]
Path("detector/columns.csv").write_text("column,scan_velocity,slip\n" + "\n".join(rows) + "\n")
toml = Path("detector/tdi.toml")
toml.write_text(toml.read_text().replace("count = 240 ", 'table = "columns.csv" '))
result = sightline.choose_tdi(sightline.load_tdi(toml))
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
