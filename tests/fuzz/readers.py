"""What is fuzzed: all functions of ``sightline.io`` that open files, ``check`` of every TOML file, ``score``,
and what the other commands read before they begin their work.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.sentinel2_files import DATASTRIP, GRANULE

EPOCH = "2026-01-01T00:00:00Z"


@dataclass(frozen=True)
class Reader:
    """One row of the table.

    Attributes
    ----------
    name : str
    seed : str
        Folder of ``seeds.py`` that it reads.
    targets : tuple of str
        Patterns of the files that are changed.
    call : callable
        Of the folder of a case; gives None, or the exit status of a command.
    covers : tuple of str
        Functions of ``sightline.io`` that it calls, as ``module.function``.
    words : tuple of str
        Of a command: the words after ``sightline``; those that begin with @ are of the folder.
    options : tuple of (str, int, bool)
        Of a command whose options are changed in place of files: their names, how many values each takes,
        whether it is a flag.
    check : str
        Of a command: the TOML file that `check` must refuse too where the command calls it wrong; or empty.
    patience : float
        s on the clock in which it may do nothing: it may wait for a pipe.
    """

    name: str
    seed: str
    targets: tuple[str, ...]
    call: Callable[[Path], int | None]
    covers: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    options: tuple[tuple[str, int, bool], ...] = ()
    check: str = ""
    patience: float = 20.0

    def targets_of(self, files: dict[str, bytes]) -> tuple[str, ...]:
        """The files that are changed."""
        if self.options:
            return ()
        found = [name for name in files if any(fnmatch.fnmatch(name, pattern) for pattern in self.targets)]
        assert found, f"{self.name}: no file of {self.seed} is like {self.targets}"
        return tuple(sorted(found))


READERS: dict[str, Reader] = {}


def function(place: str, seed: str, targets: str, *more: Any, **options: Any) -> None:
    """A row for `place`, "module.function" of ``sightline.io``, called with a target and `more`."""
    _row(
        place, seed, targets.split(), lambda folder, read: read(folder / targets.split()[0], *more, **options)
    )


def _row(place: str, seed: str, targets: list[str], call: Callable[[Path, Any], Any], name: str = "") -> None:
    module, _, called = place.rpartition(".")

    def of_folder(folder: Path) -> None:
        call(folder, getattr(import_module(f"sightline.io.{module}"), called))

    name = name or f"io.{place}" + (f" ({targets[0]})" if f"io.{place}" in READERS else "")
    assert name not in READERS, name
    READERS[name] = Reader(name, seed, tuple(targets), of_folder, (place,))


def spoken(words: Iterable[str], folder: Path) -> list[str]:
    """The words of a command about the case in `folder`."""
    return [re.sub("(^|=)@", rf"\g<1>{folder}/", word) for word in words]


def options_of(words: Sequence[str]) -> tuple[tuple[str, int, bool], ...]:
    """Options of a command but for those that say where to write or let it ask servers."""
    import typer.main

    from sightline.cli.main import app

    here = typer.main.get_command(app)
    for word in words:
        here = getattr(here, "commands", {}).get(word, here)
    never = {"--out", "--overwrite", "--resume", "--help", "--allow-network", "--workers"}
    given = [p for p in here.params if p.opts[0].startswith("--") and p.opts[0] not in never]
    return tuple((option.opts[0], option.nargs, bool(option.is_flag)) for option in given)


def command(name: str, seed: str, targets: str, words: str, check: str = "") -> None:
    """A row for a command line."""

    def of_folder(folder: Path, more: Sequence[str] = ()) -> int:
        from sightline.cli.main import run

        return run(spoken([*words.split(), *more], folder))

    assert name not in READERS, name
    said = tuple(words.split())
    options = () if targets else options_of(said)
    READERS[name] = Reader(name, seed, tuple(targets.split()), of_folder, (), said, options, check)


# Tables -----------------------------------------------------------------------------------------------------

function("formats.tables.read_columns", "level", "gyro.csv", ("t_start", "roll"), ("roll",), ("sigma",))
function(
    "formats.tables.read_long_columns",
    "pair",
    "matches.csv",
    ("shot", "point", "line_1"),
    ("sigma_px",),
    ("shot",),
)
function("formats.tables.header_of", "level", "stars.csv")
function("formats.tables.first_row", "level", "stars.csv")
_row("formats.tables.line_of_row", "level", ["stars.csv"], lambda folder, read: read(folder / "stars.csv", 0))
function("formats.tables.read_positions", "orbit-csv", "positions.csv")
function("formats.tables.read_attitudes", "orbit-csv", "attitudes.csv")
function("formats.tables.read_star_tracker", "level", "stars.csv")
function("formats.tables.read_gyro", "level", "gyro.csv")
function("formats.tables.read_control_points", "level", "control.csv")
function("formats.tables.read_features", "level", "features.csv")
function("formats.tables.read_psd", "level", "psd.csv")
function("formats.tables.read_directions", "level", "directions.csv")
function("formats.tables.read_line_times", "level", "times.csv")
function("formats.tables.read_mirror_angles", "mirror", "mirror.csv")
function("formats.tables.read_motion", "recovered", "result/motion.csv")
function("acquisition.quality.read_match_sigma", "level", "quality.csv", 40)
function("acquisition.stages.read_stages", "level", "stages.csv", 40)
function("acquisition.stages.read_tag_stages", "tdi", "tags.bin", (20, 31))
function("acquisition.ephemeris.read_orbit", "orbit-ccsds", "orbit.oem", EPOCH)
function("acquisition.ephemeris.read_attitude", "orbit-ccsds", "attitude.aem", EPOCH)
function("formats.ccsds.read_oem", "orbit-ccsds", "orbit.oem", EPOCH)
function("formats.ccsds_attitude.read_aem", "orbit-ccsds", "attitude.aem", EPOCH)
function("formats.ccsds.is_ccsds", "orbit-ccsds", "attitude.aem", "AEM")
function("formats.ccsds_attitude.read_apm", "orbit-stars", "attitude.apm", EPOCH)
function("formats.ccsds_message.message_kind", "orbit-stars", "orbit.xml")
function("formats.ccsds_message.read_message", "orbit-stars", "orbit.xml", "OEM")
function("formats.mean_elements.read_tle", "orbit-stars", "orbit.tle", EPOCH)
function("formats.sbet.read_sbet", "orbit-stars", "sbet.out", EPOCH)
function("formats.sbet.is_sbet", "orbit-stars", "sbet.out")
function("formats.mean_elements.is_tle", "orbit-stars", "orbit.tle")
function("formats.mean_elements.read_omm", "orbit-stars", "elements.omm", EPOCH)
function("formats.packed.read_packed_text", "orbit-stars", "orbit.oem", "text")
function("formats.earth_orientation.read_earth_orientation", "orbit-stars", "earth.c04")
function("sequence.times.first_instant", "flown-lonlat", "frames.csv")
function(
    "sequence.times.read_timed",
    "flown-lonlat",
    "frames.csv",
    ("frame", "t", "image"),
    EPOCH,
    ("frame", "image"),
)
function("formats.angle_tables.kind_of_angles", "modelled", "opk.csv")
function("formats.angle_tables.origin_of_angles", "modelled", "ypr.csv")
function("formats.angle_tables.read_angles", "modelled", "ypr.csv")
function("formats.odm.read_geo", "flown-lonlat", "geo.txt")
function("formats.odm.read_gcp_list", "flown-lonlat", "gcp_list.txt")
function("formats.envi.read_envi_wavelengths", "flown", "filter.hdr")
function(
    "results.raster_matches.read_raster_matches", "shifts", "matches.csv",
    {
        "grid": [6, 1], "first": [4.5, 49.5], "step": [10, 100], "window": [10, 100], "geometry": "pixels",
        "reduced": 1, "common_px": [0.0, 0.0], "common_strength": None, "images": ["a", "b"],
    },
)  # fmt: skip
function("results.poses.read_pose_table", "georeferenced", "result/poses.csv")
function("results.poses.read_pose_truth", "georeferenced", "poses-truth.csv")
function("results.poses.read_pose_covariance", "georeferenced", "result/covariance.npz")


def _with_poses(place: str, targets: str, *more: Any) -> None:
    def call(folder: Path, read: Any) -> None:
        from sightline.io.stereo.tables import read_poses

        read(folder / targets, read_poses(folder / "cameras.csv"), *more)

    _row(place, "pictures" if "image" in place else "pair", [targets], call)


function("stereo.tables.read_poses", "pair", "cameras.csv")
_with_poses("stereo.tables.read_stereo_matches", "matches.csv", 0.1)
_with_poses("stereo.tables.read_stereo_control", "control.csv", 0.1)
_with_poses("stereo.tables.read_image_list", "images.csv")
_with_poses("stereo.tables.read_observations", "observations.csv", 0.1)
function("results.stereo_score.read_orientation", "pair", "result/orientation.csv")
function("results.stereo_score.read_orientation_truth", "pair", "orientation-truth.csv", ("1", "2"))
function("results.stereo_score.read_covariance", "pair", "result/covariance.csv", 6)


# Images and what instruments deliver ------------------------------------------------------------------------


def _look(folder: Path, read: Any, name: str, **options: Any) -> None:
    from sightline.io.formats.images import check_content

    check_content(read(folder / name, **options))


_row("formats.images.open_image", "level", ["PAN.tif"], lambda folder, read: _look(folder, read, "PAN.tif"))
_row("formats.images.open_image", "level", ["XS.npy"], lambda folder, read: _look(folder, read, "XS.npy"))
_row(
    "formats.images.open_image", "level", ["mask.tif", "PAN.tif"],
    lambda folder, read: _look(folder, read, "PAN.tif", mask=folder / "mask.tif"),
)  # fmt: skip
_row(
    "sequence.frame_files.opened",
    "frames",
    ["f0.tif"],
    lambda folder, read: _look(folder, lambda path: read(path, "luminance"), "f0.tif"),
)
function("sequence.frame_files.probe", "flown", "f0.npy")
function("sequence.frame_files.probe", "photographs", "photos/p0.jpg")
function("formats.exif.read_tags", "photographs", "photos/p0.jpg")
function("formats.exif.read_exif", "photographs", "photos/p0.jpg")
function("sequence.frames.read_photograph_tags", "photographs", "photos/p0.jpg")
_row(
    "formats.exif.positions_from_exif", "photographs", ["photos/*.jpg"],
    lambda folder, read: read(sorted((folder / "photos").iterdir()), EPOCH, 0.0),
)  # fmt: skip
function("formats.xmp.read_xmp", "photographs", "photos/p1.jpg")
function("tied.load_tied", "orbit-csv", "acquisition.toml positions.csv attitudes.csv PAN.tif")


def _ground_of(folder: Path, read: Any) -> None:
    from sightline.io.tied import load_tied

    read(folder / "dem.tif", load_tied(folder / "acquisition.toml"), "0.0")


_row("tied.read_ground", "orbit-csv", ["dem.tif"], _ground_of)
_row(
    "formats.images.load_raster", "orbit-csv", ["dem.tif"],
    lambda folder, read: read(folder / "dem.tif").read((0, 1), (0, 1)),
)  # fmt: skip
function("formats.dem.read_dem", "orbit-csv", "dem.tif")
_row(
    "formats.dem.read_dem", "orbit-csv", ["geoid.tif", "dem.tif"],
    lambda folder, read: read(folder / "dem.tif", datum="geoid", geoid=folder / "geoid.tif"),
)  # fmt: skip
function("formats.csm_keys.read_keys", "sensor-model", "isd.json", "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL")
function("formats.isd.read_line_scan_model", "sensor-model", "isd.json")
function("formats.isd.read_line_scan_model", "sensor-model", "state.json")
_row(
    "formats.spice_files.spacecraft_clock", "sensor-model", ["clock.tsc"],
    lambda folder, read: read([folder / "clock.tsc"]),
)  # fmt: skip
function("formats.sensor_model.read_sensor_model", "products", "PAN.XML")
function("formats.products.recognise.read_product", "products", "PAN.XML")
_row(
    "formats.products.sentinel2.read_granule_times",
    "products",
    [GRANULE, DATASTRIP],
    lambda folder, read: read(folder / GRANULE, folder / DATASTRIP),
)
function("formats.products.tree.read_xml", "products", "PAN.XML", "metadata")
function("formats.products.worldview.read_worldview", "products", "PAN.XML")
_row(
    "formats.products.worldview.read_worldview", "products", ["XS.*"],
    lambda folder, read: read(folder / "XS.IMD"),
)  # fmt: skip
_row(
    "formats.products.worldview_text.read_text_set", "products", ["XS.*"],
    lambda folder, read: read(folder / "XS.IMD", "metadata"),
)  # fmt: skip
function("formats.products.dimap2.read_dimap2", "maker-products", "DIM_SPOT6.XML")
function("formats.products.dimap1.read_dimap1", "maker-products", "METADATA.DIM")
function("formats.products.pleiades.read_pleiades", "maker-products", "PHRDIMAP_P1.XML")
function("formats.products.pleiades_telemetry.read_pleiades_telemetry", "maker-products", "PHRDIMAP_P1.XML")
for _variant in ("DIM_PNEO3.XML", "TILES.XML"):
    function("formats.products.recognise.read_product", "product-variants", _variant)
    command(f"init {_variant}", "product-variants", _variant, f"init @{_variant} --out @out")
command(
    "init raw bands",
    "product-variants",
    "PHRDIMAP_P1.XML raw_B0.npy",
    "init @PHRDIMAP_P1.XML @raw_PA.npy @raw_B0.npy --out @out",
)
function("formats.isd_frame.read_frame_model", "sensor-model", "frame.json")
function("formats.hirise_edr.is_hirise", "hirise", "raw.IMG")
function("formats.hirise_edr.read_hirise_edr", "hirise", "raw.IMG")
function("formats.hirise_edr.read_hirise_setting", "hirise", "raw.IMG")
function("formats.junocam.is_metadata", "juno", "JNCE_30.json")
function("formats.junocam.read_metadata", "juno", "JNCE_30.json")
function("formats.junocam.read_framelets", "juno", "JNCE_30.png")
function("formats.sentinel1.is_sentinel1", "sentinel1", "attitude.csv")
function("formats.sentinel1.read_sentinel1_attitude", "sentinel1", "attitude.csv", EPOCH)
function("formats.sentinel1.read_sentinel1_orbit", "sentinel1", "orbit.csv", EPOCH)
_row("formats.colmap.read_colmap_model", "modelled", ["text/*"], lambda folder, read: read(folder / "text"))
_row(
    "formats.colmap.read_colmap_model", "modelled", ["binary/*"], lambda folder, read: read(folder / "binary")
)
function("formats.opensfm.read_opensfm", "modelled", "reconstruction.json")

# TDI tables -------------------------------------------------------------------------------------------------

function("results.tdi_table.read_c_source", "tdi", "result/table.c")
function("results.tdi_table.read_intel_hex", "tdi", "result/table.hex")
function("results.tdi_table.read_segments", "tdi", "result/table_segments.bin")
function("results.tdi_tags.read_tdi_tags", "tdi", "tags.bin")
function("results.tdi_settings.open_signals", "tdi", "signals.npy")


def _table(folder: Path) -> None:
    from sightline import TdiTable

    TdiTable.read(folder / "result")


READERS["TdiTable.read"] = Reader("TdiTable.read", "tdi", ("result/table.bin",), _table)

# TOML files and what they name ------------------------------------------------------------------------------

function("config.read_toml", "level", "acquisition.toml")
function("config.schema_of", "flown", "sequence.toml")
function("acquisition.load.read_acquisition", "level", "acquisition.toml")
function("acquisition.load.load_acquisition", "orbit-csv", "acquisition.toml *", look=False)
function("layout.load.load_instrument", "instrument", "instrument.toml")
function("sequence.load.load_sequence", "flown-lonlat", "sequence.toml *")
function("sequence.load.read_sequence", "modelled", "opensfm.toml reconstruction.json frames.csv")
function("stereo.load.read_stereo_file", "pair", "stereo.toml")
function("stereo.load.read_stereo", "pair", "stereo.toml *.csv", planned=True)
function("stereo.load.load_stereo", "simulated-pair", "stereo.toml *.csv dem.tif")
function("stereo.plan.has_plan", "plan", "stereo.toml")
function("stereo.plan.read_plan", "plan", "stereo.toml")
function("tdi.load.load_tdi", "tdi", "tdi.toml columns.csv noise.csv")
_row("tdi.load.tdi_inputs", "tdi", ["tdi.toml"], lambda folder, read: read(folder / "tdi.toml"))

# Results ----------------------------------------------------------------------------------------------------


def _noise_table(folder: Path, read: Any) -> None:
    import numpy

    from sightline.io.config import read_toml, validate
    from sightline.io.tdi.schema import TdiFile

    toml = folder / "tdi.toml"
    read(folder / "noise.csv", toml, validate(TdiFile, read_toml(toml), toml), numpy.array([0.0, 1.0, 7.0]))


_row("tdi.noise_table.read_noise_table", "tdi", ["noise.csv"], _noise_table)


def _of_acquisition(place: str, seed: str, targets: str, folder_name: str) -> None:
    def call(folder: Path, read: Any) -> None:
        from sightline.io.acquisition.load import load_acquisition

        read(folder / folder_name, load_acquisition(folder / "acquisition.toml"))

    _row(place, seed, targets.split(), call)


def _hidden(folder: Path, read: Any) -> None:
    from tests.fuzz.seeds import LINES

    from sightline.io.results.hidden import read_summary

    read(folder / "result", read_summary(folder / "result"), LINES)


_row(
    "results.hidden.read_summary",
    "recovered",
    ["result/summary.json"],
    lambda folder, read: read(folder / "result"),
)
_row(
    "results.relief.read_relief",
    "recovered",
    ["result/relief.csv"],
    lambda folder, read: read(folder / "result", {"relief": {"image": "PAN"}}, ("PAN",)),
)
_row("results.hidden.read_hidden", "recovered", ["result/hidden.csv", "result/summary.json"], _hidden)
_of_acquisition("results.recovered.read_recovered", "recovered", "result/*", "result")
_of_acquisition("tdi.motion.read_motion_knowledge", "recovered", "result/*", "result")
_of_acquisition(
    "results.registered_frames.read_recovered_spin", "turning-frames", "result/summary.json", "result"
)
_row(
    "results.pose_score.score_pose_folder", "georeferenced", ["result/*", "*.csv"],
    lambda folder, read: read(folder / "result", folder / "poses-truth.csv"),
)  # fmt: skip
_row(
    "results.stereo_score.score_orientation_folder", "pair",
    ["result/orientation.csv", "result/covariance.csv", "orientation-truth.csv"],
    lambda folder, read: read(folder / "result", folder / "orientation-truth.csv"),
)  # fmt: skip

_row(
    "scene.recipe.read_recipe", "scene-files", ["pass.toml"],
    lambda folder, read: read("stereo", folder / "pass.toml"),
)  # fmt: skip


def _opened(seed: str, place: str, targets: str) -> None:
    """A row for a result's folder, opened and shown."""

    def call(folder: Path) -> None:
        from sightline import open_result

        result = open_result(folder / place)
        for shown in (repr(result), result._repr_html_(), result.summary()):
            assert shown

    name = f"open_result ({seed}/{place})"
    READERS[name] = Reader(name, seed, tuple(f"{place}/{target}" for target in targets.split()), call)


_opened("recovered", "result", "summary.json motion.csv hidden.csv covariance.npz")
_opened("georeferenced", "result", "summary.json poses.csv frames_used.csv covariance.npz")
for _place, _targets in (
    ("choice", "summary.json choice.csv table.bin"), ("angles", "summary.json *.csv"),
    ("detector", "summary.json columns.csv"), ("places", "summary.json layouts.csv"), ("score", "*"),
    ("bands", "*"), ("sky", "*"), ("cube", "*"),
):  # fmt: skip
    _opened("results", _place, _targets)

# Commands ---------------------------------------------------------------------------------------------------

for _seed, _toml in (
    ("level", "acquisition"), ("orbit-csv", "acquisition"), ("orbit-ccsds", "acquisition"),
    ("orbit-stars", "acquisition"), ("sensor-model",
    "acquisition"), ("products", "acquisition"),
    ("mirror", "acquisition"), ("spin", "acquisition"), ("turning-frames", "acquisition"), ("frames",
    "acquisition"),
    ("photographs", "acquisition"), ("photographs", "sequence"), ("flown", "sequence"), ("flown-lonlat",
    "sequence"), ("rig", "sequence"),
    ("modelled", "text"), ("modelled", "binary"), ("modelled", "opensfm"), ("modelled", "opk"), ("pair",
    "stereo"),
    ("pair", "observations"), ("pictures", "stereo"), ("simulated-pair", "stereo"), ("strips", "stereo"),
    ("plan", "stereo"),
    ("tdi", "tdi"), ("recovered", "tdi"), ("instrument", "instrument"),
):  # fmt: skip
    _file = f"{_toml}.toml"
    # the TOML file itself as often as all it names
    command(f"check {_seed}/{_file}", _seed, _file, f"check @{_file}")
    if _seed not in ("plan", "instrument"):
        _more = {
            "modelled": f"frames.csv {_toml}* {'reconstruction.json' if _toml == 'opensfm' else ''}"
        }.get(_seed, "[!r]* fore/*")
        command(f"check {_seed}/{_file}, what it names", _seed, _more, f"check @{_file}")

for _name, _seed, _targets, _words, _check in (
    ("score recovered", "recovered", "truth.csv result/*", "score @result @truth.csv", ""),
    ("score georeferenced", "georeferenced", "* result/*", "score @result @poses-truth.csv --table", ""),
    ("score oriented", "pair", "orientation-truth.csv result/*", "score @result @orientation-truth.csv", ""),
    ("orient", "pair", "stereo.toml *.csv", "orient @stereo.toml --out @out", "stereo.toml"),
    ("orient with a DEM", "simulated-pair", "*.csv dem.tif", "orient @stereo.toml --out @out", "stereo.toml"),
    ("orient --predict", "plan", "stereo.toml", "orient @stereo.toml --predict --out @out", "stereo.toml"),
    ("tdi", "tdi", "tdi.toml *s.csv noise.csv", "tdi @tdi.toml --out @out", "tdi.toml"),
    # pictures of a target, seconds each, are made of the row above
    (
        "tdi --signals", "tdi", "t*.toml s*",
        "tdi @tdi.toml --signals @signals.npy --no-pictures --out @out", "",
    ),
    ("tdi --motion", "recovered", "tdi.toml result/*", "tdi @tdi.toml --motion @result --out @out", ""),
    ("layout", "instrument", "*", "layout @instrument.toml --passband 40 150 --out @out", ""),
    ("recover", "level", "*", "recover @acquisition.toml --out @out", "acquisition.toml"),
    ("register", "recovered", "a* result/*", "register @acquisition.toml --motion @result --out @out", ""),
    ("export", "recovered", "a* result/*",
     "export @result --to shifts --acquisition @acquisition.toml --out @out", ""),
    ("export quaternions", "recovered", "result/*", "export @result --to quaternions --out @out", ""),
    ("register frames", "turning-frames", "*", "register @acquisition.toml --motion @result --out @out", ""),
    ("georeference", "flown", "*", "georeference @sequence.toml --out @out", "sequence.toml"),
):  # fmt: skip
    command(_name, _seed, _targets, _words, _check)

for _name, _kind in (
    ("pass", "stereo"), ("flight", "frames"), ("strip", "line-of-sight"), ("orbit", "line-of-sight"),
    ("frames", "line-of-sight"),
):  # fmt: skip
    # the size of a flight stands here too: a spoilt file could lose it, and the whole case takes minutes.
    # Sizes that are spoilt themselves are among the options below
    _size = " --frames 4 --lines 122 --columns 136" if _name == "flight" else ""
    _file = f"{_name}.toml"
    command(f"scene: {_name}", "scene-files", _file, f"simulate {_kind} --scene @{_file}{_size} --out @out")

# Options of commands ----------------------------------------------------------------------------------------

for _seed, _words in (
    ("plan", "simulate line-of-sight --lines 360 --columns 200 --out @out"),
    ("plan", "simulate line-of-sight --case mirror-leo --lines 128 --columns 224 --out @out"),
    ("plan", "simulate line-of-sight --case frames --frames 2 --out @out"),
    ("plan", "simulate stereo --shots 2 --points 10 --out @out"),
    ("plan", "simulate frames --frames 3 --lines 122 --columns 122 --out @out"),
    ("level", "recover @acquisition.toml --out @out"),
    ("recovered", "register @acquisition.toml --motion @result --out @out"),
    ("pair", "orient @stereo.toml --out @out"),
    ("flown", "georeference @sequence.toml --out @out"),
    ("tdi", "tdi @tdi.toml --no-pictures --out @out"),
    ("instrument", "layout @instrument.toml --passband 40 150"),
    ("recovered", "export @result --to quaternions --out @out"),
    ("recovered", "score @result @truth.csv"),
    ("level", "check @acquisition.toml"),
    ("level", "noise @flat.npy --out @out"),
):
    command(f"options of {_words.split(' @')[0]}", _seed, "", _words)
