# %% [markdown]
# # Strips in pictures
#
# The pictures of this page share one strip of 1,000 lines, rendered with a known motion, and one recovery.

# %%
import matplotlib.pyplot as plt
import numpy as np

import sightline

scene = sightline.line_of_sight_case("nominal", seed=4, lines=1000, columns=240)
images = [sightline.ArrayImage(scene.image(k)) for k in range(4)]
names = ("PAN", "B1", "B0", "B2")
bands = [sightline.Band(name, images[k], scene.nominal_cameras[k]) for k, name in enumerate(names)]
result = sightline.recover_line_of_sight(bands, sightline.Plane(0.0))
px = result.scale  # rad in one pixel, of roll, pitch, yaw
t = result.motion.t

# %% [markdown]
# ## Two bands as they were taken
#
# One band in red, another in cyan: grey where they fit, coloured rims where they do not.


# %%
def grey(band):
    low, high = np.nanpercentile(band, [1, 99])
    return np.clip((band - low) / (high - low), 0, 1)


def two_bands(first, second):
    return np.stack([grey(first), grey(second), grey(second)], axis=-1)


part = (slice(500, 620), slice(40, 200))
fig, ax = plt.subplots()
ax.imshow(two_bands(images[0].array[part], images[3].array[part]))
ax.grid(False)

# %% [markdown]
# ## The same bands, registered
#
# The second band is resampled once, along the motion that was found.

# %%
statics = {static.name: static.value for static in result.statics}
registered = sightline.register_bands(bands, sightline.Plane(0.0), result.motion, statics)
after = registered.after[3].read((500, 620), (40, 200))
fig, ax = plt.subplots()
ax.imshow(two_bands(images[0].array[part], after))
ax.grid(False)

# %% [markdown]
# ## The motion, with one sigma

# %%
fig, axes = plt.subplots(3, sharex=True, figsize=(7, 4.6))
result.plot(axes)

# %% [markdown]
# ## Error beside sigma
#
# Estimate less truth, once what images cannot show (here a constant and what free offsets imitate) is taken out of both. The band
# is 2 sigma.

# %%
result.write("result")
error = sightline.remove_hidden(result.motion, "result") - sightline.remove_hidden(scene.motion, "result")
fig, axes = plt.subplots(3, sharex=True, figsize=(7, 4.6))
for k, (ax, axis) in enumerate(zip(axes, ("roll", "pitch", "yaw"), strict=True)):
    sigma = 2 * result.sigma[:, k] / px[k]
    ax.fill_between(t, -sigma, sigma, alpha=0.3)
    ax.plot(t, error[:, k] / px[k], linewidth=0.8)
    ax.set_ylabel(f"{axis} (px)")
axes[-1].set_xlabel("t (s)")

# %% [markdown]
# ## The spectrum of the motion
#
# What the motion holds at each frequency, and the noise of the estimate: where the noise is above, nothing was seen.

# %%
spectrum = result.to_pandas("spectrum")
fig, ax = plt.subplots()
ax.loglog(spectrum["frequency"], spectrum["psd_pitch"], label="motion in pitch")
ax.loglog(spectrum["frequency"], spectrum["error_pitch"], label="error of the estimate")
ax.set_xlabel("frequency (Hz)")
ax.set_ylabel("rad² / Hz")
ax.legend()

# %% [markdown]
# ## What a pair of bands cannot see
#
# Two bands a lag apart see the difference of two moments. Motion that repeats within the lag shows nothing. Pairs with other lags
# fill these gaps.

# %%
frequency = np.linspace(0, 60, 600)
fig, ax = plt.subplots()
for lag in (0.0222, 0.150, 0.1722):
    ax.plot(frequency, 2 * np.abs(np.sin(np.pi * frequency * lag)), label=f"lag {1e3 * lag:.0f} ms")
ax.set_xlabel("frequency (Hz)")
ax.set_ylabel("seen (1: as it is)")
ax.legend()

# %% [markdown]
# ## Where to put the detectors
#
# All layouts of four detectors over 172 ms, ranked by what they see at the worst frequency between 40 and 150 Hz: the ten best.

# %%
from pathlib import Path

Path("instrument.toml").write_text("""
focal_length_px = 2e5
line_period = 5e-4
match_sigma_px = 0.03
detectors = 4
span_s = 0.1722
""")
choice = sightline.choose_layout(sightline.load_instrument("instrument.toml"), (40.0, 150.0))
fig, ax = plt.subplots()
choice.plot(ax)
