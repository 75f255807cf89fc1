# %% [markdown]
# # A flight of a filter camera
#
# A camera whose lines see different wavelengths takes frame after frame. Every place is seen in every band at some time. We find
# the pose of every frame, and lay all bands on one map.
#
# ## A flight whose poses are known
#
# 48 small frames over relief, with rough positions and attitudes.

# %%
# !sightline simulate frames --case small --out flight --frames 48 --seed 3

# %% [markdown]
# ## Solve
#
# The command follows windows from frame to frame, adjusts all poses together, and makes the maps: here of eight bands.

# %%
# !printf '[cube]\nbands = 8\n' >> flight/sequence.toml
# !sightline georeference flight/sequence.toml --out located

# %%
import matplotlib.pyplot as plt
import numpy as np
import rasterio

import sightline

result = sightline.open_result("located")
result

# %% [markdown]
# ## Poses and their error bars
#
# Sigmas are of the absolute pose: they hold what is not known of the tables' constant errors.

# %%
poses = result.to_pandas()
poses[["x", "y", "z", "sigma_x", "sigma_roll", "source"]].head()

# %%
fig, ax = plt.subplots()
result.plot(ax)

# %% [markdown]
# ## The maps
#
# One GeoTIFF for each band, all on one grid. Three of them as a picture:

# %%
from pathlib import Path

files = sorted(Path("located/bands").glob("*.tif"))
print(len(files), "bands, from", files[0].name, "to", files[-1].name)
layers = []
for file in (files[-1], files[len(files) // 2], files[0]):
    with rasterio.open(file) as source:
        band = source.read(1)
    low, high = np.nanpercentile(band, [2, 98])
    layers.append(np.clip((band - low) / (high - low), 0, 1))
fig, ax = plt.subplots()
ax.imshow(np.stack(layers, axis=-1))
ax.set_title("near infrared, middle, blue as red, green, blue")
ax.grid(False)

# %% [markdown]
# ## How good is it?
#
# `score` compares with the truth. Rows "turned and moved" leave out what all frames share.

# %%
# !sightline score located flight/poses-truth.csv --table

# %% [markdown]
# ## Go on
#
# - [The guide](../flights.md): what may be given. [Every key of SEQUENCE.toml](../formats/sequence-toml.md). [The theory](../theory/s4.md).
# - Cubes for xarray: `[cube] formats = ["zarr"]` or `["netcdf"]`.
