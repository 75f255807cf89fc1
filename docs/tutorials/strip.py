# %% [markdown]
# # A strip
#
# A push-broom camera takes its bands a moment apart. If it turns in between, the bands do not fit. Here we render such a strip,
# recover how the camera turned, and compare with the truth.
#
# ## A strip whose motion is known
#
# Four bands, 1,200 lines of 256 columns. `scene.nominal_cameras` is what an operator would believe: where each band looks, and
# that the platform flies smoothly. `scene.motion` is what really happened.

# %%
import matplotlib.pyplot as plt
import numpy as np

import sightline

scene = sightline.line_of_sight_case("nominal", seed=1, lines=1200, columns=256)
images = [sightline.ArrayImage(scene.image(k)) for k in range(4)]
bands = [sightline.Band(f"band {k}", images[k], scene.nominal_cameras[k]) for k in range(4)]

# %% [markdown]
# Two bands over each other: where they do not fit, edges have coloured rims.


# %%
def grey(band):
    low, high = np.nanpercentile(band, [1, 99])
    return np.clip((band - low) / (high - low), 0, 1)


def overlay(ax, first, second, title):
    ax.imshow(np.stack([grey(first), grey(second), grey(second)], axis=-1), interpolation="nearest")
    ax.set_title(title)
    ax.grid(False)


part = (slice(400, 560), slice(40, 220))
fig, ax = plt.subplots()
overlay(ax, images[0].array[part], images[3].array[part], "bands 0 and 3 as they were taken")

# %% [markdown]
# ## Recover the line of sight
#
# One call. It finds thousands of windows of one band in the others, and turns their misfit into roll, pitch and yaw of every line.

# %%
result = sightline.recover_line_of_sight(bands, sightline.Plane(0.0))
result

# %% [markdown]
# The motion with one sigma, in pixels: a pixel of roll moves the image by one column.

# %%
fig, axes = plt.subplots(3, sharex=True, figsize=(7, 5))
result.plot(axes)

# %% [markdown]
# ## How good is it?
#
# The truth is known here. Images never show a constant turn, nor a drift that free band offsets imitate: `score_motion` takes these
# *hidden* parts out of both. NEES near 1 says that sigma is true.

# %%
score = sightline.score_motion(
    result.motion.t,
    result.motion.angles,
    result.sigma,
    scene.motion.t,
    scene.motion.angles,
    hidden=result.hidden,
    hidden_names=result.hidden_names,
    ifov=result.ifov,
    half_field_px=result.half_field,
)
score.to_pandas()

# %% [markdown]
# ## Bands that fit
#
# `register_bands` lays every band onto the first, by the motion found.

# %%
statics = {static.name: static.value for static in result.statics}
registered = sightline.register_bands(bands, sightline.Plane(0.0), result.motion, statics)
fig, axes = plt.subplots(1, 2, figsize=(7, 3.4))
overlay(axes[0], images[0].array[part], images[3].array[part], "before")
after = registered.after[3].read((400, 560), (40, 220))
overlay(axes[1], images[0].array[part], after, "after")

# %% [markdown]
# ## Take it with you
#
# `result.write("folder")` writes what `sightline recover` writes: tables, summary, report page. The names of the columns and keys
# are in the [files](../formats/recover.md).

# %%
table = result.to_pandas()
table[["t", "roll", "sigma_roll", "observed"]].head()

# %% [markdown]
# ## Go on
#
# - With your own images: [start in five minutes](../start.md), then [the guide](../strips.md).
# - What a result can do: [Python](../python.md#results). How the method works: [theory](../theory/s1.md).
