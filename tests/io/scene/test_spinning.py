"""Raw images of a spinning camera, simulated through SCENE keys and read by `init`."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.cli.main import run

#: A disc of 360 px radius in seven exposures.
SMALL = ["--set", "exposures=7", "--set", "altitude=3e8"]


def begun(folder, case, *settings, seed=0):
    """Status of `init` of a simulated image, and its [platform]."""
    words = ["simulate", "line-of-sight", "--case", case, "--seed", str(seed), *SMALL, *settings]
    assert run([*words, "--out", str(folder / "scene")]) == 0
    given = [str(folder / "scene" / name) for name in ("00001-Metadata.json", "00002-Metadata.json")]
    (image,) = (folder / "scene").glob("JNCE_*-raw.png")
    status = run(["init", str(image), *given, "--out", str(folder / "acq")])
    if status:
        return status, None
    return status, tomllib.loads((folder / "acq" / "acquisition.toml").read_text())["platform"]


def errors(folder, platform):
    """rad; of the attitude at t = 0 across the line to the planet, and about it."""
    truth = np.loadtxt(folder / "scene" / "truth-attitudes.csv", delimiter=",", skiprows=1)
    place = np.loadtxt(folder / "acq" / "positions.csv", delimiter=",", skiprows=1)
    here = place[np.abs(place[:, 0]).argmin(), 1:4]
    down = -here / np.linalg.norm(here)
    off = (Rotation.from_quat(platform["attitude"]) * Rotation.from_quat(truth[0, 1:]).inv()).as_rotvec()
    return np.linalg.norm(off - (off @ down) * down), abs(off @ down)


@pytest.mark.parametrize(
    ("case", "settings", "least", "most"),
    [
        # the disc's terminator is as steep as its limb, the camera is turned by 30 degrees beside the hint
        ("junocam", ["--set", "from_noon=0.9", "--set", "turn=0.5"], 0.0, 0.2),
        # 1.8 degrees from the pole: an outline as flat as a hundredth of a pixel; the camera is turned by 23
        # degrees beside the hint, which is all that is known of it
        ("junocam-pole", ["--set", "turn=0.4"], 0.5, 1.6),
    ],
)
def test_the_attitude_lies_within_its_sigmas(tmp_path, case, settings, least, most):
    status, platform = begun(tmp_path, case, *settings)
    assert status == 0
    across, about = errors(tmp_path, platform)
    # two angles: 3.7 sigma are one in a thousand
    assert across < 3.7 * platform["attitude_sigma"] and about < 3.3 * platform["attitude_turn_sigma"]
    assert platform["attitude_sigma"] < 2e-3 and least <= platform["attitude_turn_sigma"] <= most


def test_an_overexposed_strip_is_refused_for_its_terminator(tmp_path, capsys):
    status, _ = begun(tmp_path, "junocam-overexposed")
    said = capsys.readouterr().err
    assert status == 1 and "they lie on the terminator, as in an overexposed image" in said
    assert not (tmp_path / "acq").exists()


def test_blooming_is_masked_and_moves_no_limb(tmp_path):
    """The limb under the Sun is overexposed and spills over the sky: its ends tell the attitude."""
    status, platform = begun(tmp_path, "junocam", "--set", "from_noon=1.2", "--set", "brightness=1.5")
    assert status == 0
    across, about = errors(tmp_path, platform)
    assert across < 3.7 * platform["attitude_sigma"] and about < 3.3 * platform["attitude_turn_sigma"]
