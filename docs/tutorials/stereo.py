# %% [markdown]
# # A pass of two spacecraft
#
# Two spacecraft image one scene at the same instants, many times in a pass. Where they are is known to metres. Where they look is
# known up to a constant error of each camera. Points that both see reveal these errors.
#
# ## A pass whose errors are known
#
# 32 shots, 150 points, 0.1 px of noise. The command writes what an operator would have, and the truth beside it.

# %%
# !sightline simulate stereo --out pass --shots 32 --points 150 --seed 1

# %% [markdown]
# ## Look before you run

# %%
# !sightline check pass/stereo.toml

# %% [markdown]
# ## Solve
#
# One call gives three angles for each camera, with their covariance.

# %%
import numpy as np

import sightline

result = sightline.orient(sightline.load_stereo("pass/stereo.toml"))
result

# %% [markdown]
# Angles and sigma in arc seconds, beside the truth:

# %%
arcsec = np.pi / 648000.0
truth = np.genfromtxt("pass/orientation-truth.csv", delimiter=",", names=True)
true = np.stack([truth[axis] for axis in ("roll", "pitch", "yaw")], axis=-1)
for name, angles, sigma, known in zip(result.cameras, result.angles, result.sigma, true, strict=True):
    for axis, a, s, k in zip(
        ("roll", "pitch", "yaw"), angles / arcsec, sigma / arcsec, known / arcsec, strict=True
    ):
        print(
            f"camera {name} {axis:5} {a:+7.2f} ± {s:4.2f}   truth {k:+7.2f}   {abs(a - k) / s:.1f} sigma off"
        )

# %% [markdown]
# ## What is known least
#
# The six angles are not known alike. The directions of the covariance say which turn of both cameras together is seen worst: one
# about the line between the spacecraft.

# %%
import matplotlib.pyplot as plt

values, directions = np.linalg.eigh(result.covariance)
fig, axes = plt.subplots(1, 2, figsize=(7, 3))
axes[0].bar(range(6), np.sqrt(values) / arcsec)
axes[0].set_xlabel("direction")
axes[0].set_ylabel("sigma (arcsec)")
names = [f"{axis} {camera}" for camera in result.cameras for axis in ("roll", "pitch", "yaw")]
axes[1].barh(names, directions[:, -1])
axes[1].set_title("the direction known least")

# %% [markdown]
# ## Before a pass is flown
#
# `--predict` gives the bound without any image: what this geometry can give at best.

# %%
# !sightline orient pass/stereo.toml --predict --out planned

# %% [markdown]
# ## Go on
#
# - [The guide](../stereo.md), [every key of STEREO.toml](../formats/stereo-toml.md), [the theory](../theory/s2.md).
