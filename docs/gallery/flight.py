# %% [markdown]
# # Flights in pictures
#
# 40 frames of a camera whose lines see different wavelengths, over relief. Poses and maps are found from the frames and rough tables.

# %%
# !sightline simulate frames --case small --out flight --frames 40 --seed 4
# !printf '[cube]\nbands = 8\nformats = ["tif", "netcdf"]\n' >> flight/sequence.toml
# !sightline georeference flight/sequence.toml --out located

# %%
import matplotlib.pyplot as plt
import numpy as np
import xarray

import sightline

result = sightline.open_result("located")
poses = result.to_pandas()
cube = xarray.open_dataset("located/cube.nc")["cube"].swap_dims(band="wavelength")

# %% [markdown]
# ## The path, and where each pose comes from

# %%
fig, ax = plt.subplots()
result.plot(ax)

# %% [markdown]
# ## How well each frame is known
#
# Sigmas of the absolute pose. Frames share what is not known of the tables' constant errors, so the curves are nearly level.

# %%
fig, axes = plt.subplots(1, 2)
for axis in "xyz":
    axes[0].plot(poses[f"sigma_{axis}"], label=axis)
for axis in ("roll", "pitch", "yaw"):
    axes[1].plot(np.degrees(poses[f"sigma_{axis}"]), label=axis)
axes[0].set_ylabel("sigma (m)")
axes[1].set_ylabel("sigma (degrees)")
for ax in axes:
    ax.set_xlabel("frame")
    ax.legend()

# %% [markdown]
# ## What was found, beside the rough table

# %%
rough = np.genfromtxt("flight/positions.csv", delimiter=",", names=True)
truth = np.genfromtxt("flight/poses-truth.csv", delimiter=",", names=True)
fig, ax = plt.subplots()
ax.plot(rough["x"] - truth["x"], ".-", label="table less truth")
ax.plot(poses["x"].to_numpy() - truth["x"], ".-", label="found less truth")
ax.set_xlabel("frame")
ax.set_ylabel("x (m)")
ax.legend()

# %% [markdown]
# ## Three bands of the cube
#
# Infrared, red and green as red, green and blue. At both ends of the flight only some bands have passed over the ground.

# %%
layers = [cube.sel(wavelength=nm, method="nearest") for nm in (850, 650, 550)]
rgb = np.stack(
    [(layer - layer.quantile(0.02)) / (layer.quantile(0.98) - layer.quantile(0.02)) for layer in layers],
    axis=-1,
)
fig, ax = plt.subplots()
ax.imshow(np.clip(np.nan_to_num(rgb), 0, 1))
ax.grid(False)

# %% [markdown]
# ## The spectrum of three places

# %%
seen = np.argwhere(np.isfinite(cube.values).all(axis=0))
fig, ax = plt.subplots()
for row, column in seen[np.linspace(0, len(seen) - 1, 5).astype(int)[1:4]]:
    ax.plot(cube.wavelength, cube[:, row, column], "o-", label=f"row {row}, column {column}")
ax.set_xlabel("wavelength (nm)")
ax.set_ylabel("pixel value")
ax.legend()
