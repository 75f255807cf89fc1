"""``sightline init``: templates that the loaders take, presets with the published numbers, and bad input."""

from __future__ import annotations

import math
import re
import shutil
import tomllib

import numpy as np
import pytest
import rasterio

from sightline import load_acquisition
from sightline.cli.main import run
from sightline.io.config import SCHEMAS, json_schema, schema_of, validate

#: Template, its file, kind of the file.
TEMPLATES = [
    ("strip", "acquisition.toml", "acquisition"),
    ("stereo", "stereo.toml", "stereo"),
    ("flight", "sequence.toml", "sequence"),
    ("tdi", "tdi.toml", "tdi"),
    ("layout", "instrument.toml", "instrument"),
]
#: s after B02: ESA, Sentinel-2 User Handbook (2015).
LAGS = {"B02": 0.0, "B03": 0.527, "B04": 1.005, "B08": 0.264}
MSI = ["--preset", "sentinel-2-msi"]


@pytest.fixture
def images(tmp_path):
    """One file for each band, named as products name them; all in one; one of fewer columns."""
    rng = np.random.default_rng(3)
    pixels = rng.integers(300, 900, (4, 60, 48)).astype(np.uint16)

    def write(name, bands):
        profile = {"driver": "GTiff", "count": len(bands), "height": 60, "width": bands.shape[2]}
        with rasterio.open(tmp_path / name, "w", dtype="uint16", **profile) as target:
            target.write(bands)

    for name, band in zip(LAGS, pixels, strict=True):
        write(f"scene_{name}_10m.tif", band[None])
    write("all.tif", pixels)
    write("narrow_B03.tif", pixels[:1, :, :40])
    return tmp_path


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
class TestTemplates:
    @pytest.mark.parametrize(("template", "file", "kind"), TEMPLATES)
    def test_a_template_is_a_file_that_its_loader_takes(self, template, file, kind, tmp_path, capsys):
        out = tmp_path / "deep" / "my files"
        assert run(["init", "--template", template, "--out", str(out)]) == 0
        assert names(out) == [file]
        assert capsys.readouterr().out.splitlines()[-1] == f"next: sightline check '{out / file}'"
        text = (out / file).read_text(encoding="utf-8")
        validate(SCHEMAS[kind], tomllib.loads(text), out / file)
        assert schema_of(out / file) == kind

    @pytest.mark.parametrize(("template", "file", "kind"), TEMPLATES)
    def test_a_key_of_a_template_has_words_beside_it_and_one_in_a_comment_is_a_key_too(
        self, template, file, kind, tmp_path
    ):
        run(["init", "--template", template, "--out", str(tmp_path)])
        lines = (tmp_path / file).read_text(encoding="utf-8").splitlines()
        keys = [
            line for line in lines if line and line[0] not in "#[" and not line.startswith(("name", "kind"))
        ]
        allowed = {"sigma_attitude", "from", "to", "count", "table", "acquisition"}
        bare = [line for line in keys if "#" not in line and line.split(" =")[0] not in allowed]
        assert not [line for line in bare if not line.startswith(("image", "stages", "look_ahead"))]
        schema = json_schema(kind)
        known = {key for part in (schema, *schema["$defs"].values()) for key in part.get("properties", {})}
        said = {line[2:].split(" =")[0] for line in lines if re.match(r"# \w+ = ", line)}
        assert said <= known

    @pytest.mark.parametrize(
        ("template", "status", "said"),
        [
            ("strip", 1, ["B1.tif: no such file"]),
            ("stereo", 2, ["cameras.csv: no such file"]),
            ("flight", 2, ["frames.csv: no such file"]),
            ("tdi", 0, []),
            ("layout", 0, []),
        ],
    )
    def test_check_names_what_a_template_lacks_and_nothing_else(
        self, template, status, said, tmp_path, capsys
    ):
        run(["init", "--template", template, "--out", str(tmp_path)])
        (file,) = tmp_path.iterdir()
        capsys.readouterr()
        assert run(["check", str(file)]) == status
        errors = [line for line in capsys.readouterr().err.splitlines() if ": error: " in line]
        assert len(errors) == len(said) and all(a in b for a, b in zip(said, errors, strict=True))


def written(folder):
    return tomllib.loads((folder / "acquisition.toml").read_text(encoding="utf-8"))


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
class TestPresets:
    @pytest.mark.parametrize("sign", [None, "+", "-"])
    @pytest.mark.parametrize("several", [False, True])
    def test_bands_have_the_published_numbers(self, images, several, sign, capsys):
        out = images / "out"
        given = ["all.tif", "--bands", "B02,b03,B04, B08"]
        if not several:
            given = [f"scene_{name}_10m.tif" for name in LAGS]
        given = [str(images / word) if word.endswith("tif") else word for word in given]
        signed = [] if sign is None else ["--lag-sign", sign]
        assert run(["init", *given, *MSI, *signed, "--out", str(out)]) == 0
        said = capsys.readouterr().out
        assert said.splitlines()[-1] == f"next: sightline recover {out / 'acquisition.toml'} --out result"
        assert names(out) == ["acquisition.toml"]
        assert "Sentinel-2 User Handbook" in said and "Binet, Bergsma and Poulain" in said
        assert ("sign of the lags" in said) == (sign is None) and "epoch" in said and "attitude" in said
        config = written(out)
        assert config["platform"]["altitude"] == 786e3
        assert config["platform"]["ground_speed"] == pytest.approx(6666.67, abs=0.01)
        assert config["instrument"] == {
            "ifov": pytest.approx(1.27226e-5, rel=1e-5), "columns": 48, "line_period": 1.5e-3,
        }  # fmt: skip
        assert [band["name"] for band in config["band"]] == list(LAGS)
        factor = -1.0 if sign == "-" else 1.0
        for band in config["band"]:
            lag = factor * LAGS[band["name"]]
            assert band["first_line_time"] == lag
            # the band looks back to the ground that the platform has passed since
            assert 786e3 * math.tan(band["look_ahead"]) == pytest.approx(-lag * 6666.667, abs=1e-2)
            assert (band["offset_sigma_px"], band["rotation_sigma"]) == (3.0, 3e-3)
        acquired = load_acquisition(out / "acquisition.toml")
        assert [band.name for band in acquired.bands] == list(LAGS) and acquired.epoch is None
        for number, band in enumerate(acquired.bands):
            with rasterio.open(images / "all.tif") as source:
                expected = source.read(number + 1)
            assert np.array_equal(np.asarray(band.image.read((0, 60), (0, 48))), expected)

    @pytest.mark.parametrize(
        ("names", "far"), [(("B04", "B05"), 13), (("B05", "B09"), 7), (("B05", "B06"), None)]
    )
    def test_places_are_sought_in_pixels_of_the_finest_band(self, tmp_path, names, far):
        # 3 sigma of the difference of two places, 3 px of 10 m each: 127 m
        for name, wide in zip(names, {13: (1, 2), 7: (1, 3), None: (1, 1)}[far], strict=True):
            shape = (90 // wide, 60 // wide)
            np.save(tmp_path / f"{name}.npy", np.arange(np.prod(shape), dtype=np.uint16).reshape(shape))
        given = [str(tmp_path / f"{name}.npy") for name in names]
        assert run(["init", *given, *MSI, "--out", str(tmp_path / "out")]) == 0
        assert written(tmp_path / "out").get("matching") == (far and {"search_px": [far, far]})

    def test_a_band_is_left_out(self, images):
        out, words = images / "out", ["--bands", "B02,-,B04,-"]
        assert run(["init", str(images / "all.tif"), *MSI, *words, "--out", str(out)]) == 0
        assert [(one["name"], one["image_band"]) for one in written(out)["band"]] == [("B02", 1), ("B04", 3)]

    def test_images_are_found_from_a_folder_behind_a_link(self, images):
        (images / "far" / "away").mkdir(parents=True)
        (images / "near").symlink_to(images / "far" / "away", target_is_directory=True)
        out = images / "near" / "out"
        given = [str(images / f"scene_{name}_10m.tif") for name in ("B02", "B04")]
        assert run(["init", *given, *MSI, "--out", str(out)]) == 0
        assert written(out)["band"][0]["image"] == (images / "scene_B02_10m.tif").as_posix()
        assert len(load_acquisition(out / "acquisition.toml").bands) == 2


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], r"--template NAME \(strip, stereo, flight, tdi, layout\), or images with --preset NAME \(sent"),
        (MSI, "--template NAME"),
        (["all.tif"], r"--preset NAME \(sentinel-2-msi, zy-3-mux, pleiades\)"),
        (["--template", "spin"], "'spin' is not known; allowed: strip, stereo, flight, tdi, layout"),
        (["--template", "tdi", "all.tif"], "--template takes no images"),
        (["--template", "tdi", *MSI], "--template takes no --preset"),
        (["all.tif", "--preset", "sentinel-2"], "'sentinel-2' is not known; allowed: sentinel-2-msi"),
        (["all.tif", "--preset", "landsat-8-oli"], "no published source was found of when each band"),
        (["all.tif", "--preset", "ZY-3"], "'ZY-3' is not known; allowed: .*zy-3-mux"),
        (["all.tif", "--preset", "prism"], "no published source was found of which lines of PRISM"),
        (["all.tif", "--preset", "aster"], "no published source was found of lags of ASTER"),
        (["all.tif", "--preset", "hirise"], "HiRISE needs no preset: give its EDRs"),
        (["all.tif", *MSI, "--bands", "B02,B05,B11,B01"], "B10, B11, B12: of a focal plane of their own"),
        (["all.tif", *MSI], "holds 4 bands; say which they are.*allowed: B02, B08, B03, B04"),
        (["all.tif", *MSI, "--bands", "B02,B03,B04,B11"], "'B11' is no band.*allowed: B02, B08, B03, B04"),
        (["scene_B02_10m.tif"] * 2 + [*MSI, "--bands", "B02,B03"], "scene_B02_10m.tif is given twice"),
        (["all.tif", *MSI, "--bands", "B02,B03"], "names 2 bands, the images hold 4"),
        (["all.tif", *MSI, "--bands", "B02,B03,B04,B04"], "are both B04"),
        (["all.tif", *MSI, "--lag-sign", "minus"], r"'minus'; allowed: \+, -"),
        (["scene_B02_10m.tif", *MSI], r"too few bands \(B02\); motion is seen between two or more"),
        (["all.tif", *MSI, "--bands", "-,-,-,-"], r"too few bands \(none\)"),
        (["scene_B02_10m.tif", "plain.tif", *MSI], "plain.tif: no such file"),
        (["scene_B02_10m.tif", "narrow_B03.tif", *MSI], "has 40 columns, .* 48"),
        (["scene_B02_10m.tif", "B02_B03.tif", *MSI], "names B02 and B03"),
        (["scene_B02_10m.tif", "B11.tif", *MSI], "names no band of the preset; allowed: B02, B08"),
        (["scene_B02_10m.tif", "text_B03.tif", *MSI], "text_B03.tif"),
    ],
)
def test_what_cannot_be_is_one_error_and_leaves_nothing(images, words, said, capsys):
    for name in ("B02_B03.tif", "B11.tif"):
        shutil.copy(images / "scene_B03_10m.tif", images / name)
    (images / "text_B03.tif").write_text("no raster")
    words = [str(images / word) if word.endswith(".tif") else word for word in words]
    assert run(["init", *words, "--out", str(images / "out")]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and len(shown.err.splitlines()) == 1
    assert re.search(said, shown.err) and "Traceback" not in shown.err
    assert not (images / "out").exists()


def test_a_folder_that_holds_something_is_refused_and_kept(tmp_path, capsys):
    (tmp_path / "acquisition.toml").write_text("mine")
    (tmp_path / "notes.txt").write_text("keep")
    words = ["init", "--template", "strip", "--out", str(tmp_path)]
    assert run(words) == 2
    assert "add --overwrite" in capsys.readouterr().err
    assert (tmp_path / "acquisition.toml").read_text() == "mine"
    assert run([*words, "--overwrite"]) == 0
    assert names(tmp_path) == ["acquisition.toml", "notes.txt"]
    assert "[platform]" in (tmp_path / "acquisition.toml").read_text()
