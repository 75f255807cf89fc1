"""The noise of a detector from plain images and frames without light, and of strips pooled."""

from __future__ import annotations

import csv
import json
import tomllib

import numpy as np
import pytest

from imaging.raw_strip import RawStripOptions, simulate_raw_strip
from sightline.applications.detector_noise import (
    DEAD,
    GAIN_UNKNOWN,
    OFFSET_UNKNOWN,
    OUTLYING,
    dark_noise,
    detector_noise,
    plain_image_noise,
    strip_image_noise,
)
from sightline.cli.main import run
from sightline.errors import EstimationError, InputError
from sightline.imaging.noise_estimation import column_pattern
from sightline.imaging.source import ArrayImage
from sightline.imaging.strip_noise import StripPixels
from sightline.io.results.noise import NOISE_FILES
from sightline.io.tdi.load import load_tdi

LINES, COLUMNS = 640, 256
SHOT, READ, LEVEL, PATTERN = 0.28, 3.0, 60.0, 2e-3
#: Column 40 is dead, column 90 twice as sensitive as its neighbours.
DEAD_COLUMN, HOT_COLUMN = 40, 90


def response() -> np.ndarray:
    columns = 1.0 + PATTERN * np.random.default_rng(100).standard_normal(COLUMNS)
    columns[HOT_COLUMN] = 1.2
    return columns


def raw(
    seed: int,
    signal: float,
    *,
    lines: int = LINES,
    contrast: float = 0.0,
    gain: float = 0.0,
    step: float = 1.0,
) -> np.ndarray:
    """DN of an image of mean `signal`: evenly lit, or of a scene that is smooth over some pixels."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    scene = np.zeros((lines, COLUMNS))
    if contrast:
        rough = gaussian_filter(rng.standard_normal(scene.shape), 3.0)
        patchy = np.exp(100.0 * gaussian_filter(rng.standard_normal(scene.shape), 60.0))
        scene = contrast * rough / rough.std() * patchy
    light = np.maximum(signal * (1.0 + scene), 0.0) * response()
    variance = gain * light**2 + SHOT * light + READ**2
    values = LEVEL + light + np.sqrt(variance) * rng.standard_normal(light.shape)
    values[:, DEAD_COLUMN] = 7.0
    return step * np.round(values / step)


def image(*given, **more) -> ArrayImage:
    return ArrayImage(raw(*given, **more))


@pytest.fixture(scope="module")
def dark():
    return dark_noise([image(seed, 0.0) for seed in (1, 2)])


def test_frames_without_light_give_the_level_of_columns_and_the_read_noise(dark):
    found = dark.resting
    # the dead column makes no noise: a part of one in 256 of the squares
    assert abs(found.value - READ) < 4.0 * found.sigma + 0.01 * READ and found.sigma < 0.02 * READ
    # 1280 values a column: 3 / sqrt(1280) = 0.08
    alive = np.arange(COLUMNS) != DEAD_COLUMN
    assert np.abs(dark.level - LEVEL)[alive].max() < 5.0 * 0.084


def test_even_images_of_several_signals_part_shot_noise_from_gain_noise(dark):
    true = 2e-5
    images = [
        plain_image_noise(f"{signal}", image(10 + k, signal, gain=true), dark)
        for k, signal in enumerate((200.0, 1000.0, 2000.0, 4000.0))
    ]
    found = detector_noise(images, dark)
    by_name = {figure.name: figure for figure in found.figures}
    for name, value in (("B", SHOT), ("A of the sum", true), ("conversion gain 1 / B", 1.0 / SHOT)):
        figure = by_name[name]
        assert abs(figure.value - value) < 4.0 * figure.sigma < 0.4 * value, name
    assert found.unit == "DN" and found.law.shot == by_name["B"].value
    assert found.law.output == pytest.approx(READ, rel=0.02)
    assert found.warnings == ()


def test_a_scene_of_one_signal_gives_shot_noise_beside_the_read_noise(dark):
    found = detector_noise(
        [plain_image_noise("scene", image(20, 2000.0, lines=1600, contrast=0.05), dark)], dark
    )
    by_name = {figure.name: figure for figure in found.figures}
    assert abs(by_name["B"].value - SHOT) < 4.0 * by_name["B"].sigma
    # one signal does not separate A from B: all of it is in B, and A is bounded
    assert found.law.gain == 0.0 and by_name["A of the sum"].relation == "<="


def test_without_anything_at_rest_one_signal_bounds_the_shot_noise():
    scene = plain_image_noise("scene", image(20, 2000.0, lines=1600, contrast=0.05), dark_level=LEVEL)
    found = detector_noise([scene])
    by_name = {figure.name: figure for figure in found.figures}
    assert (by_name["B"].relation, by_name["conversion gain 1 / B"].relation) == ("<=", ">=")
    # B s + C^2 over s
    assert SHOT < by_name["B"].value < (SHOT + READ**2 / 2000.0) * 1.3
    assert "C^2 of the sum" not in by_name and "taken for shot noise" in found.warnings[-1]
    larger = detector_noise([scene], electrons_per_dn=10.0)
    assert not any("are given; the noise of the images asks" in said for said in larger.warnings)


def test_columns_come_back_and_bad_ones_are_flagged(dark):
    images = [plain_image_noise(str(k), image(30 + k, 4000.0), dark) for k in range(3)]
    found = detector_noise(images, dark)
    true = response()
    for bad in (DEAD_COLUMN, HOT_COLUMN):  # neither bends what its neighbours are compared with
        true[bad] = 0.5 * (true[bad - 1] + true[bad + 1])
    kept = column_pattern(np.tile(true, (100, 1))).pattern
    usual = np.setdiff1d(np.arange(16, COLUMNS - 16), [DEAD_COLUMN, HOT_COLUMN])
    # noise of a column's mean over 3 x 640 lines: sqrt(0.28 * 4000 + 9) / sqrt(1920) / 4000 = 1.9e-4
    error = (found.gain - 1.0 - kept)[usual]
    assert 1.5e-4 < np.std(error) < 2.4e-4 and abs(error.mean()) < 5e-5
    assert np.std(kept[usual]) > 1.5e-3
    assert found.flags[DEAD_COLUMN] & DEAD and found.flags[DEAD_COLUMN] & GAIN_UNKNOWN
    assert found.gain[DEAD_COLUMN] == 1.0
    assert found.flags[HOT_COLUMN] == OUTLYING
    assert found.gain[HOT_COLUMN] == pytest.approx(1.2, abs=3.0 * PATTERN)
    assert (found.flags[:16] == GAIN_UNKNOWN).all() and not found.flags[usual].any()
    assert found.offset[usual] == pytest.approx(LEVEL, abs=0.5)


def test_values_that_are_cut_off_and_steps_of_codes_are_allowed_for(dark):
    values = raw(40, 3000.0, lines=2400, contrast=0.05, step=16.0)
    whole = plain_image_noise("whole", ArrayImage(values), dark)
    values[:750, 128:] = values.max()  # a bright cloud
    cut = plain_image_noise("cut", ArrayImage(values), dark)
    assert whole.ceiling is None and whole.warnings == ()
    assert cut.ceiling == pytest.approx(values.max() - LEVEL, abs=1.0)
    assert "16 % of the pixels are cut off, at" in cut.warnings[0]
    # a step of 16 adds 16^2 / 12 = 21 DN^2, which is taken off
    for one in (whole, cut):
        true = SHOT * one.white.signal + READ**2
        assert abs(one.white.variance.value - true) < 4.0 * one.white.variance.sigma < 0.3 * true
        assert abs(one.white.signal - 3000.0) < 60.0


def test_noise_below_the_step_is_not_invented():
    # two levels, one step apart
    values = 64.0 + 16.0 * np.repeat([[0.0], [1.0]], (300, LINES - 300), axis=0) * np.ones(COLUMNS)
    found = dark_noise([ArrayImage(values)])
    assert found.resting is None and "below a fifth of the step of 16 DN" in found.warnings[0]


def test_strips_of_one_detector_are_pooled():
    strips = [simulate_raw_strip(seed, RawStripOptions(lines=2000)) for seed in (0, 1)]
    images = [
        strip_image_noise(
            f"strip {k}",
            StripPixels(
                s.table, s.image, s.buffer, s.dark, s.reverse, s.reverse_buffer, s.reverse_dark, s.ramp
            ),
            64,
        )
        for k, s in enumerate(strips)
    ]
    one, both = detector_noise(images[:1], stages=64), detector_noise(images, stages=64)

    def sigma(found):
        return {figure.name: figure.sigma for figure in found.figures}["C^2 of the sum"]

    # two alike: sigma by sqrt 2, as far as their own claims are alike
    assert 0.55 < sigma(both) / sigma(one) < 0.85
    assert both.law.output == pytest.approx(3.6, abs=0.3)
    assert both.law.shot == pytest.approx(0.05, abs=0.03)
    in_electrons = detector_noise(images, stages=64, electrons_per_dn=20.0)
    assert in_electrons.law.shot == 1.0 and in_electrons.unit == "e-"
    assert in_electrons.law.output == pytest.approx(20.0 * both.law.output)
    assert in_electrons.signals[1] == pytest.approx(20.0 * both.signals[1])
    assert in_electrons.warnings == ()
    wrong = detector_noise(images, stages=64, electrons_per_dn=2.0)
    assert "2 electrons per DN are given; the noise of the images asks for" in wrong.warnings[0]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.zeros((40, 300)), "40 lines x 300 columns are too few"),
        (np.full((LINES, COLUMNS), 5.0), "no column has values that change"),
        (
            np.minimum(raw(70, 3000.0), LEVEL + 2900.0),
            "% of its pixels are cut off, at 7 and 2960 DN, and show no noise",
        ),
        (np.add.outer(np.arange(1600.0), np.zeros(256)), "as rough everywhere"),
    ],
    ids=["small", "constant", "saturated", "no noise"],
)
def test_what_shows_no_noise_is_refused(values, says):
    with pytest.raises(EstimationError, match=says):
        detector_noise([plain_image_noise("x", ArrayImage(values), dark_level=0.0)])


def test_images_of_different_columns_are_not_of_one_detector(dark):
    narrow = ArrayImage(raw(50, 1000.0)[:, :200])
    with pytest.raises(InputError, match="frames without light have 256 columns, the image 200"):
        plain_image_noise("narrow", narrow, dark)
    both = [plain_image_noise("a", narrow, dark_level=60.0), plain_image_noise("b", image(51, 1000.0), dark)]
    with pytest.raises(InputError, match=r"images of \[200, 256\] columns are not of one detector"):
        detector_noise(both)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A frame without light and two evenly lit ones."""
    folder = tmp_path_factory.mktemp("raw")
    np.save(folder / "dark.npy", raw(1, 0.0).astype(np.uint16))
    for k, signal in enumerate((500.0, 3000.0)):
        np.save(folder / f"light-{k}.npy", raw(60 + k, signal).astype(np.uint16))
    return folder


class TestCommand:
    def words(self, files, *more):
        lights = [str(files / f"light-{k}.npy") for k in (0, 1)]
        return ["noise", *lights, *more]

    def test_the_tables_are_those_that_tdi_reads(self, files, tmp_path, capsys):
        out = tmp_path / "out"
        words = self.words(files, "--dark", str(files / "dark.npy"), "--electrons-per-dn", "3.571")
        assert run([*words, "--stages", "4", "--out", str(out)]) == 0
        said = capsys.readouterr()
        assert "[noise] of a TDI line, signals in e-" in said.out and said.err.count("warning") == 0
        assert sorted(p.name for p in out.iterdir()) == sorted(NOISE_FILES)
        law = tomllib.loads((out / "noise.toml").read_text(encoding="utf-8"))
        assert list(law) == ["noise"]
        summary = json.loads((out / "summary.json").read_text())
        assert law["noise"] == pytest.approx(summary["noise"], rel=1e-3)
        problem = load_tdi(out / "tdi.toml")
        assert problem.detector.noise.output == pytest.approx(READ * 3.571, rel=0.05)
        assert len(problem.columns) == COLUMNS
        with (out / "columns.csv").open() as stream:
            rows = list(csv.DictReader(stream))
        assert list(rows[0]) == ["column", "gain", "offset", "flags"] and len(rows) == COLUMNS
        assert int(rows[HOT_COLUMN]["flags"]) == OUTLYING and float(rows[HOT_COLUMN]["gain"]) > 1.1
        assert summary["columns"]["flagged"]["dead"] == 1
        assert set(summary["inputs"]) == {"light-0.npy", "light-1.npy", "dark.npy"}

    def test_without_a_dark_level_that_is_said_and_flagged(self, files, tmp_path, capsys):
        out = tmp_path / "out"
        assert run([*self.words(files), "--out", str(out)]) == 0
        assert "the level without light is taken for 0 DN; give frames" in capsys.readouterr().err
        flags = np.loadtxt(out / "columns.csv", delimiter=",", skiprows=1)[:, 3].astype(int)
        assert (flags & OFFSET_UNKNOWN).all()

    @pytest.mark.parametrize(
        ("more", "says"),
        [
            (["missing.npy"], "missing.npy: no such file; give raw images"),
            (["--dark-level", "nan"], "--dark-level is nan; a number of DN from -1e9 to 1e9 is allowed"),
            (["--dark-level=-1e18"], "--dark-level is -1e+18; a number of DN"),
            (["--electrons-per-dn", "0"], "--electrons-per-dn is 0; a number above 0"),
            (["--stages", "0"], "--stages is 0; 1 or more"),
            (["light-0.npy"], "light-0.npy is given twice"),
            (["--dark", "dark.npy", "--dark-level", "60"], "--dark and --dark-level both say"),
        ],
    )
    def test_wrong_words_are_refused_and_nothing_is_written(self, files, tmp_path, capsys, more, says):
        more = [str(files / word) if word.endswith(".npy") else word for word in more]
        assert run([*self.words(files, *more), "--out", str(tmp_path / "out")]) == 2
        assert says in capsys.readouterr().err
        assert not (tmp_path / "out").exists()

    def test_what_the_data_cannot_give_is_status_1_and_names_the_file(self, tmp_path, capsys):
        np.save(tmp_path / "small.npy", np.zeros((20, 20)))
        assert run(["noise", str(tmp_path / "small.npy"), "--out", str(tmp_path / "out")]) == 1
        assert "small.npy: 20 lines x 20 columns are too few" in capsys.readouterr().err

    def test_a_hirise_channel_gives_the_figures_of_its_page(self, real_data, tmp_path, capsys):
        path = real_data("hirise_edr_bg12") / "PSP_001446_1790_BG12_0.IMG"
        out = tmp_path / "out"
        assert run(["noise", str(path), "--electrons-per-dn", "19.30", "--out", str(out)]) == 0
        law = tomllib.loads((out / "noise.toml").read_text(encoding="utf-8"))["noise"]
        # docs/theory/s3-noise.md
        assert law["output"] == pytest.approx(71.0, abs=1.0) and law["shot"] == 1.0
        assert law["gain"] == pytest.approx(2.3e-4, rel=0.02) and law["column_fixed"] == pytest.approx(
            1.2e-6, rel=0.01
        )
        table = np.loadtxt(out / "columns.csv", delimiter=",", skiprows=1)
        assert table.shape == (256, 4) and 850.0 < table[:, 2].min() < table[:, 2].max() < 1100.0
        assert run(["noise", str(path), "--dark-level", "5", "--out", str(tmp_path / "no")]) == 2
        assert "are for plain images; HiRISE EDRs say them" in capsys.readouterr().err
