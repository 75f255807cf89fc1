# %% [markdown]
# # Stereo in pictures
#
# One pass of two spacecraft over one scene: 24 shots, 120 points, errors of 36 arc seconds about every axis.

# %%
# !sightline simulate stereo --out pass --shots 24 --points 120 --seed 4

# %%
import matplotlib.pyplot as plt
import numpy as np

import sightline

result = sightline.orient(sightline.load_stereo("pass/stereo.toml"))
truth = np.genfromtxt("pass/orientation-truth.csv", delimiter=",", names=True)
arcsec = np.pi / 648000.0
labels = [f"{axis} {camera}" for camera in result.cameras for axis in ("roll", "pitch", "yaw")]

# %% [markdown]
# ## Angles found, with one sigma, beside the truth

# %%
known = np.stack([truth[axis] for axis in ("roll", "pitch", "yaw")], axis=1).ravel() / arcsec
fig, ax = plt.subplots()
ax.errorbar(
    labels, result.angles.ravel() / arcsec, result.sigma.ravel() / arcsec, fmt="o", capsize=4, label="found"
)
ax.plot(labels, known, "k_", markersize=18, label="truth")
ax.set_ylabel("arcsec")
ax.legend()

# %% [markdown]
# ## How the six angles depend on each other

# %%
sigma = result.sigma.ravel()
fig, ax = plt.subplots(figsize=(5, 4))
picture = ax.imshow(result.covariance / np.outer(sigma, sigma), vmin=-1, vmax=1, cmap="RdBu")
ax.set_xticks(range(6), labels, rotation=45)
ax.set_yticks(range(6), labels)
ax.grid(False)
fig.colorbar(picture, label="correlation")

# %% [markdown]
# ## The directions in which the cameras are known, and the one known least

# %%
values, directions = np.linalg.eigh(result.covariance)
fig, axes = plt.subplots(1, 2)
axes[0].bar(range(1, 7), np.sqrt(values) / arcsec)
axes[0].set_xlabel("direction")
axes[0].set_ylabel("sigma (arcsec)")
axes[1].barh(labels, directions[:, -1])
axes[1].set_xlabel("part in the direction known least")

# %% [markdown]
# ## Residuals of the points
#
# What is left in the images, in pixels, against the noise of 0.1 px that was put in.

# %%
result.write("oriented")
used = sightline.open_result("oriented").to_pandas("matches_used")
fig, ax = plt.subplots()
ax.hist(used["residual_px"], bins=60)
ax.set_xlabel("residual of a sighting (px)")
ax.set_ylabel("sightings")
