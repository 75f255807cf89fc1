"""Photon transfer of frames whose gain, noise and pattern are known, and of a camera with published ones."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from sightline.applications.photon_transfer import even_exposures, photon_transfer
from sightline.cli.main import run
from sightline.errors import EstimationError, InputError
from sightline.imaging.noise_estimation import Estimate
from sightline.imaging.photon_transfer import compare_columns, fit_transfer
from sightline.imaging.source import ArrayImage

LINES, COLUMNS = 160, 192
#: Electrons of the exposures, with pairs of frames; of one there are more.
EXPOSURES, STACK, DEEP = (300.0, 1200.0, 2500.0, 4000.0, 5500.0), 3, 8


@dataclass(frozen=True)
class Camera:
    """DN per electron, of each column; electrons of the dark noise and of its part common to a row; level."""

    gain: float = 0.3
    uneven: float = 0.0
    read: float = 8.0
    rows: float = 2.0
    level: float = 40.0
    dsnu: float = 1.5
    prnu: float = 5e-3
    top: float = 4095.0
    drift: float = 1e-3

    def response(self) -> np.ndarray:
        rng = np.random.default_rng(5)
        shading = 0.02 * np.linspace(-1.0, 1.0, COLUMNS) ** 2
        return 1.0 + shading + self.prnu * rng.standard_normal((LINES, COLUMNS))

    def offsets(self) -> np.ndarray:
        return self.dsnu * np.random.default_rng(6).standard_normal((LINES, COLUMNS))

    def frame(self, rng: np.random.Generator, electrons: float) -> np.ndarray:
        light = electrons * self.response() * (1.0 + self.drift * rng.standard_normal() * (electrons > 0.0))
        charge = rng.poisson(light) + self.offsets()
        charge = charge + self.read * rng.standard_normal(charge.shape)
        charge += self.rows * rng.standard_normal((LINES, 1))
        gain = self.gain * (1.0 + self.uneven * (np.arange(COLUMNS) % 2 * 2 - 1))
        return np.clip(np.round(self.level + gain * charge), 0.0, self.top)

    def frames(self, seed: int, exposures=EXPOSURES) -> tuple[list[ArrayImage], list[ArrayImage]]:
        rng = np.random.default_rng(seed)
        bright = [
            ArrayImage(self.frame(rng, one))
            for k, one in enumerate(exposures)
            for _ in range(DEEP if k == STACK else 2)
        ]
        return bright, [ArrayImage(self.frame(rng, 0.0)) for _ in bright]


def transferred(bright, dark, dark_level=None, **more):
    names = [f"frame {k}" for k in range(len(bright))]
    groups = even_exposures(names, bright, dark, dark_level)
    assert groups is not None
    return photon_transfer(names, bright, groups, dark, dark_level, lambda *_: None, **more)


def by_name(found):
    return {figure.name.strip(): figure for figure in found.figures}


def test_every_figure_is_as_far_from_the_truth_as_its_sigma_says():
    camera, seeds = Camera(), 20
    response = camera.response()
    signal = EXPOSURES[STACK]
    truth = {
        "K": camera.gain,
        "dark noise": np.hypot(camera.read, camera.rows),
        "PRNU": 100.0 * response.std() / response.mean(),
        "of pixels": 100.0 * camera.prnu,
        "DSNU": camera.offsets().std(),
        "rows that jump together": camera.rows,
    }
    errors = {name: [] for name in truth}
    for seed in range(seeds):
        found = transferred(*camera.frames(seed))
        assert found.unit == "e-" and found.law.shot == 1.0 and found.warnings == ()
        for name, figure in by_name(found).items():
            if name in truth:
                errors[name].append((figure.value - truth[name]) / figure.sigma)
        assert found.law.output == pytest.approx(truth["dark noise"], rel=0.03)
        assert found.transfer.exposures[STACK].signal == pytest.approx(
            signal * camera.gain * response.mean(), rel=3e-3
        )
    for name, scaled in errors.items():
        # 20 seeds: a chi-square of 7.4 to 40 in 99 %
        assert 7.4 / seeds < np.mean(np.square(scaled)) < 40.0 / seeds, name


def test_columns_that_are_alike_are_said_to_be_and_others_found():
    null = [transferred(*Camera().frames(100 + k)).transfer for k in range(4)]
    assert all(one.alike["conversion"].alike for one in null)
    # 4 x 192 columns: a chi-square within 5 sigma of its mean
    assert abs(sum(one.alike["conversion"].chi_square for one in null) - 4 * 191) < 5.0 * (8 * 191) ** 0.5
    # two outputs, every other column, 6 % apart on either side
    found = transferred(*Camera(uneven=0.06).frames(104)).transfer
    conversion = found.alike["conversion"]
    assert not conversion.alike
    assert conversion.scatter == pytest.approx(0.06 * 0.3, rel=0.3) and conversion.upper > conversion.scatter
    even, odd = (found.electrons_per_dn[k::2] for k in (0, 1))
    error = float(np.median(found.sigma_electrons_per_dn)) / np.sqrt(COLUMNS / 2)
    assert even.mean() == pytest.approx(1.0 / (0.3 * 0.94), abs=5.0 * error)
    assert odd.mean() == pytest.approx(1.0 / (0.3 * 1.06), abs=5.0 * error)


def test_gain_and_offset_of_columns_are_as_far_off_as_their_sigma_says():
    camera = Camera(prnu=2e-2, dsnu=4.0)
    found = transferred(*camera.frames(110))
    truth = Camera.offsets(camera).mean(axis=0) * camera.gain + camera.level
    # sigma allows for pixels of another pattern, of which these are one draw
    noise = np.hypot(camera.read, camera.rows) * camera.gain / np.sqrt(LINES * len(camera.frames(0)[0]))
    error = found.offset - truth - np.mean(found.offset - truth)
    assert 0.7 * noise < error.std() < 1.3 * noise < found.transfer.sigma_offset[0]
    assert found.transfer.alike["offset"].alike and found.transfer.alike["gain"].alike
    usual = found.gain[20:-20] - 1.0
    assert usual.std() == pytest.approx(float(found.transfer.sigma_gain[0]), rel=0.25)


def test_what_clips_is_cut_and_exposures_above_70_percent_of_the_saturation_too():
    camera = Camera(top=1500.0)
    bright, dark = camera.frames(120, (300.0, 1200.0, 2500.0, 3000.0, 4500.0, 6000.0, 9000.0))
    found = transferred(bright, dark)
    used = [one.used for one in found.transfer.exposures]
    # 4500 electrons are the brightest that have codes, 3000 are two thirds of them
    assert used == [True, True, True, True, False, False]
    assert "of 20 frames, 4 cut off and 2 above 70 % of the saturation are left out" in found.warnings[0]
    K = by_name(found)["K"]
    assert abs(K.value - camera.gain) < 4.0 * K.sigma < 0.06 * camera.gain
    assert [one.variance is None for one in found.transfer.exposures][-2:] == [False, True]
    assert by_name(found)["saturation"].value == pytest.approx(4500.0, rel=0.05)


def test_a_dark_level_that_grows_with_the_exposure_is_taken_from_the_frames_of_its_own():
    camera = Camera()
    rng = np.random.default_rng(130)
    bright, dark = [], []
    for electrons in EXPOSURES:
        current = replace(camera, level=camera.level + 0.02 * electrons)
        for _ in range(2):
            bright.append(ArrayImage(current.frame(rng, electrons)))
            dark.append(ArrayImage(current.frame(rng, 0.0)))
    found = transferred(bright, dark)
    signals = [one.signal for one in found.transfer.exposures]
    expected = camera.gain * np.array(EXPOSURES) * camera.response().mean()
    assert signals == pytest.approx(expected.tolist(), rel=5e-3)
    K = by_name(found)["K"]
    assert abs(K.value - camera.gain) < 4.0 * K.sigma < 0.06 * camera.gain


def test_dark_current_that_differs_from_pixel_to_pixel_is_no_noise():
    rng = np.random.default_rng(131)
    camera, current = Camera(), 0.02 * rng.exponential(size=(LINES, COLUMNS))
    exposures = [one for one in EXPOSURES for _ in range(2)]
    bright, dark = (
        [
            ArrayImage(np.round(camera.frame(rng, one * lit) + camera.gain * rng.poisson(current * one)))
            for one in exposures
        ]
        for lit in (1.0, 0.0)
    )
    found = by_name(transferred(bright, dark))
    # read noise and the shot noise of the mean current, DN^2
    expected = camera.gain**2 * (camera.read**2 + camera.rows**2 + 0.02 * np.mean(EXPOSURES))
    assert (found["dark noise"].value * found["K"].value) ** 2 == pytest.approx(expected, rel=0.02)


def test_what_piles_up_at_the_bottom_is_no_saturation():
    bright, _ = Camera(level=-45.0).frames(132, (150.0, 1200.0, 2500.0, 4000.0, 5500.0))
    found = transferred(bright, [], -45.0)
    assert [one.variance is None for one in found.transfer.exposures] == [True] + 4 * [False]
    assert [one.used for one in found.transfer.exposures] == [False] + 4 * [True]
    assert "saturation" not in by_name(found) and "2 cut off are left out" in found.warnings[0]
    K = by_name(found)["K"]
    assert abs(K.value - 0.3) < 4.0 * K.sigma


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_series_may_begin_without_light(sign):
    bright, dark = Camera().frames(133, (0.0, *EXPOSURES))
    for k in range(2):
        bright[k] = ArrayImage(dark[k].array[::-1] + sign * 0.05)
    found = transferred(bright, dark)
    assert len(found.transfer.exposures) == len(EXPOSURES) + (sign > 0.0)
    assert ["no brighter than frames without light" in one for one in found.warnings] == [True] * (sign < 0.0)
    K = by_name(found)["K"]
    assert abs(K.value - 0.3) < 4.0 * K.sigma < 0.02
    assert found.transfer.alike["conversion"].alike


@pytest.mark.parametrize("values", ["constant", "two"])
def test_a_frame_of_one_or_two_values_cuts_no_other_off(values):
    bright, dark = Camera().frames(134)
    usual = by_name(transferred(bright, dark))["K"]
    rng = np.random.default_rng(134)
    frames = [
        ArrayImage(
            np.full((LINES, COLUMNS), 45.0)
            if values == "constant"
            else 45.0 + (rng.random((LINES, COLUMNS)) < 0.05)
        )
        for _ in range(2)
    ]
    found = transferred(frames + bright, dark[:2] + dark)
    assert found.transfer.exposures[0].variance is None
    K = by_name(found)["K"]
    assert K.value == pytest.approx(usual.value, abs=0.5 * usual.sigma)
    assert "saturation" not in by_name(found)


def test_scatter_beyond_the_noise_enters_the_sigma_of_the_gain():
    signals = np.linspace(200.0, 3000.0, 12)
    errors = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        sigma = 0.0025 * (9.0 + 0.3 * signals)
        true = 9.0 + (0.3 + 0.005 * rng.standard_normal(12)) * signals
        noise = [Estimate(v + s * rng.standard_normal(), s) for v, s in zip(true, sigma, strict=True)]
        found = fit_transfer(signals, noise, Estimate(9.0, 0.02)).fit.estimate(0)
        errors.append((found.value - 0.3) / found.sigma)
    # 200 draws; sigma itself is known from 12 exposures only
    assert 0.75 < np.mean(np.square(errors)) < 1.5


def test_a_given_gain_is_used_and_contradicted():
    bright, dark = Camera().frames(140)
    assert transferred(bright, dark, electrons_per_dn=3.33).warnings == ()
    found = transferred(bright, dark, electrons_per_dn=5.0)
    assert found.electrons_per_dn == 5.0 and len(found.warnings) == 1
    assert "5 electrons per DN are given; the noise of the images asks for 3.3" in found.warnings[0]


def test_images_of_unlike_scenes_are_no_exposures():
    rng = np.random.default_rng(150)
    scenes = [
        ArrayImage(500.0 + 100.0 * np.kron(rng.standard_normal((20, 24)), np.ones((8, 8)))) for _ in range(2)
    ]
    equal = [ArrayImage(one.array - one.array.mean() + 500.0) for one in scenes]
    assert even_exposures(["a", "b"], equal, [], 0.0) is None
    unlike = [ArrayImage(Camera().frame(rng, electrons)) for electrons in (500.0, 900.0)]
    assert even_exposures(["a", "b"], unlike, [], 0.0) is None


class TestWhatIsRefused:
    def test_frames_of_another_size(self):
        bright, dark = Camera().frames(160, (1000.0, 3000.0))
        with pytest.raises(
            InputError, match="--dark number 2 has 100 lines x 192 columns, frames with light"
        ):
            transferred(bright, [dark[0], ArrayImage(dark[1].array[:100])])
        bright[3] = ArrayImage(bright[3].array[:, :150])
        with pytest.raises(InputError, match="frame 3 has 160 lines x 150 columns, frames of one exposure"):
            transferred(bright, dark)

    def test_a_single_frame_of_an_exposure_is_left_out_and_said(self):
        bright, dark = Camera().frames(161)
        found = transferred(bright[:-1], dark[:-1])
        assert len(found.transfer.exposures) == len(EXPOSURES) - 1 and len(found.warnings) == 1
        assert f"frame {len(bright) - 2}: no other frame shows its exposure" in found.warnings[0]

    def test_frames_that_are_all_cut_off(self):
        bright, dark = Camera(top=300.0).frames(162, (3000.0, 5000.0))
        with pytest.raises(EstimationError, match="all frames are cut off, at 300 DN; give exposures"):
            transferred(bright, dark)

    def test_dark_frames_that_are_brighter(self):
        bright, dark = Camera().frames(163, (1000.0, 3000.0))
        with pytest.raises(InputError, match=r"below its frames without light; .*exchange them and --dark"):
            transferred(dark[:2], bright[:2])

    def test_noise_that_does_not_grow(self):
        rng = np.random.default_rng(164)
        frames = [
            ArrayImage(np.round(100.0 * (2 + k // 2) + 3.0 * rng.standard_normal((160, 192))))
            for k in range(6)
        ]
        with pytest.raises(EstimationError, match="the noise does not grow with the signal"):
            transferred(frames, [], 100.0)


def test_columns_are_compared_by_their_own_sigma():
    rng = np.random.default_rng(170)
    sigma = rng.uniform(0.5, 2.0, 1000)
    null = compare_columns(7.0 + sigma * rng.standard_normal(1000), sigma)
    assert null.alike and null.freedom == 999 and abs(null.chi_square - 999) < 5.0 * (2 * 999) ** 0.5
    assert null.scatter < null.upper < 0.5
    assert not compare_columns(sigma * rng.standard_normal(1000) * 1.3, sigma).alike


def test_a_real_camera_comes_out_as_published(real_data, tmp_path, capsys):
    folder = real_data("emva_ccd12") / "images"
    bright = [str(path) for path in sorted(folder.glob("b_*.png"))]
    out = tmp_path / "out"
    assert run(["noise", *bright, "--dark", str(folder / "d_*.png"), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "columns alike in conversion: chi-square" in said.out
    assert said.err.count("warning") == 1 and "8 cut off and 8 above 70 % of the saturation" in said.err
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    figures = {figure["name"]: figure for figure in summary["figures"]}
    # EMVA 1288's own evaluation of the whole set, three times as many exposures
    published = {"K": 0.28077, "dark noise": 10.898, "PRNU": 0.432704, "DSNU": 0.551788}
    largest = {"K": 0.01, "dark noise": 0.01, "PRNU": 0.005, "DSNU": 0.03}
    for name, value in published.items():
        figure = figures[name]
        assert abs(figure["value"] - value) < 2.0 * figure["sigma"] < 2.0 * largest[name] * value, name
    columns = summary["photon_transfer"]["columns"]["conversion"]
    assert columns["alike"] and columns["upper"] < 0.02 * published["K"]
    with (out / "columns.csv").open() as stream:
        assert stream.readline().startswith(
            "column,gain,offset,flags,sigma_gain,sigma_offset,electrons_per_dn,"
        )
