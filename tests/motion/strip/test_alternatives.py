"""One mistake in the description of a band is named: sign of the lag, order of lines or columns, scale."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sightline.applications.line_of_sight import recover_line_of_sight
from sightline.errors import EstimationError
from sightline.geometry.instrument import LineDetector
from sightline.geometry.surface import Plane
from sightline.imaging.source import ArrayImage
from sightline.motion.band import Band
from sightline.motion.strip import warnings
from sightline.motion.strip.alternatives import Cause, Reversed, alternative, exchanged_bands, mistake
from sightline.motion.strip.strip import RecoverOptions, prepared
from sightline.simulate.scenarios import line_of_sight_case


@pytest.fixture(scope="module")
def scene():
    return line_of_sight_case("nominal", 3, lines=500, columns=320)


def described(scene, k, sign=1.0, scale=1.0) -> Band:
    """A band whose look angle has another sign, or whose pixels are larger than they are."""
    camera, band, options = scene.nominal_cameras[k], scene.bands[k], scene.options
    turned = LineDetector.from_ifov(
        band.name,
        camera.columns,
        options.ifov * scale,
        options.line_period,
        look_ahead=sign * band.look_ahead,
    )
    return Band(band.name, ArrayImage(scene.image(k)), replace(camera, detector=turned))


def test_a_lag_of_the_wrong_sign_is_proved_by_the_matches(scene) -> None:
    bands = [described(scene, k, sign=-1.0) for k in (0, 1)]
    with pytest.raises(
        EstimationError, match=r"B1: it matches PAN as far on the other side: change the sign"
    ):
        recover_line_of_sight(bands, Plane(0.0))


@pytest.mark.parametrize("seed", [1, 2])
def test_all_lags_of_the_wrong_sign_are_named_where_chance_keeps_windows(seed) -> None:
    """The first search keeps some windows of other ground; the next matching none, or too few for a row."""
    given = line_of_sight_case("nominal", seed, lines=900, columns=160)
    bands = [described(given, k, sign=-1.0) for k in (0, 1, 3)]
    with pytest.raises(EstimationError, match=r"for one mistake they would: all bands .*change the sign"):
        recover_line_of_sight(bands, Plane(0.0))


def test_all_lags_of_the_wrong_sign_are_named_of_a_short_strip() -> None:
    """300 of 600 lines are on both images: nine windows below one another, too few to prove anything."""
    given = line_of_sight_case("nominal", 0, lines=600, columns=150)
    bands = [described(given, k, sign=-1.0) for k in (0, 1, 3)]
    words = mistake(bands, Plane(0.0), RecoverOptions().search_px)
    assert words.startswith("all bands match PAN as far on the other side")


@pytest.mark.parametrize(("seed", "lines", "more"), [(20, 420, {}), (11, 500, {"snr": 15.0})])
def test_no_mistake_is_named_of_a_short_strip_that_is_right(seed, lines, more) -> None:
    """Of 12 windows one more, of 16 three more, match half or one percent beside the magnification given."""
    given = line_of_sight_case("nominal", seed, lines=lines, columns=210, **more)
    assert mistake([described(given, k) for k in range(4)], Plane(0.0), RecoverOptions().search_px) == ""


def exchange(bands: list[Band], order: tuple[int, ...]) -> list[Band]:
    """The same bands with each other's images."""
    return [replace(band, image=bands[k].image) for band, k in zip(bands, order, strict=True)]


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ((1, 0, 2, 3), "the image of PAN matches as that of B1, and B1's as PAN's: exchange them"),
        ((0, 3, 2, 1), "the image of B1 matches as that of B2, and B2's as B1's: exchange them"),
        ((3, 2, 1, 0), "in the reverse order"),
    ],
)
def test_files_of_bands_that_changed_places_are_named(scene, order, said) -> None:
    bands = [described(scene, k) for k in range(4)]
    assert said in mistake(exchange(bands, order), Plane(0.0), (8, 8))
    assert exchanged_bands(bands, Plane(0.0), (8, 8)) == Cause()


def noise_like(image: np.ndarray) -> ArrayImage:
    return ArrayImage(np.random.default_rng(0).standard_normal(image.shape) + 100.0)


def test_files_that_changed_places_are_named_beside_a_band_that_matches_nothing(scene) -> None:
    """By two bands alone, the sign of their lag would be as likely."""
    bands = exchange([described(scene, k) for k in range(4)], (1, 0, 2, 3))
    bands[3] = replace(bands[3], image=noise_like(scene.image(3)))
    said = "the image of PAN matches as that of B1, and B1's as PAN's: exchange them"
    assert mistake(bands, Plane(0.0), (8, 8)) == said


def test_five_bands_in_reverse_order_are_not_two_that_changed_places() -> None:
    """The middle one has its own image, so that the first and the last alone would set it right as well."""
    lags = {"lags": (0.0, 0.03, 0.05, 0.09, 0.14), "gains": (1.0,) * 5, "gammas": (1.0,) * 5}
    given = line_of_sight_case("nominal", 2, lines=700, columns=160, names=tuple("PQRST"), **lags)
    bands = exchange([described(given, k) for k in range(5)], (4, 3, 2, 1, 0))
    assert mistake(bands, Plane(0.0), (8, 8)).startswith("the images match in the reverse order")


def test_lags_alike_on_both_sides_leave_two_causes() -> None:
    lags = {"lags": (0.0, 0.06, -0.06), "names": ("P", "Q", "R"), "gains": (1.0,) * 3, "gammas": (1.0,) * 3}
    given = line_of_sight_case("nominal", 2, lines=500, columns=320, **lags)
    words = mistake([described(given, k, sign=-1.0) for k in range(3)], Plane(0.0), (8, 8))
    assert words.startswith(
        "all bands match P as far on the other side: change the sign of every `look_ahead`"
    )
    assert words.endswith("; or the image of Q matches as that of R, and R's as Q's: exchange them")


def test_all_lags_are_named_though_one_is_shorter_than_the_search() -> None:
    """12 lines: either sign may be searched at once."""
    lags = {"lags": (0.0, 0.006, 0.06), "names": ("P", "Q", "R"), "gains": (1.0,) * 3, "gammas": (1.0,) * 3}
    given = line_of_sight_case("nominal", 2, lines=500, columns=320, **lags)
    words = mistake([described(given, k, sign=-1.0) for k in range(3)], Plane(0.0), (8, 8))
    assert words.startswith("all bands match P as far on the other side")


def test_bands_of_coarser_pixels_are_looked_through_from_one_of_them() -> None:
    """Windows of the fine first band hold too few of their pixels."""
    given = line_of_sight_case(
        "nominal", 2, lines=900, columns=400, lags=(0.0, 0.04, 0.06, 0.1), pixel_ratios=(1.0, 2.0, 2.0, 2.0)
    )
    bands = [
        Band(band.name, ArrayImage(given.image(k)), given.nominal_cameras[k])
        for k, band in enumerate(given.bands)
    ]
    assert mistake(bands, Plane(0.0), (8, 8)) == ""
    said = "the image of B1 matches as that of B2, and B2's as B1's: exchange them"
    assert mistake(exchange(bands, (0, 3, 2, 1)), Plane(0.0), (8, 8)) == said


@pytest.mark.parametrize(
    ("band", "axis", "said"),
    [
        (0, 1, "when the columns of one of the two are taken the other way round: mirror that image"),
        (1, 1, "when the columns of one of the two are taken the other way round: mirror that image"),
        (0, 0, "when the lines of PAN are taken the other way round: give the image of PAN"),
        (1, 0, "when its lines are taken the other way round: give that image"),
    ],
)
def test_of_two_bands_either_may_be_the_other_way_round(band, axis, said) -> None:
    given = line_of_sight_case("nominal", 3, lines=900, columns=200)
    bands = [described(given, 0), described(given, 1)]
    turned = ArrayImage(np.ascontiguousarray(np.flip(given.image(band), axis)))
    bands[band] = replace(bands[band], image=turned)
    assert f"B1: it matches PAN {said}" in mistake(bands, Plane(0.0), (8, 8))


def test_of_two_bands_the_images_may_have_changed_places(scene) -> None:
    bands = exchange([described(scene, 0), described(scene, 1)], (1, 0))
    assert mistake(bands, Plane(0.0), (8, 8)).endswith(", or exchange the two images")


def test_a_lag_where_none_is_given_has_no_ratio(scene) -> None:
    """Every camera looks at nadir: the second band's lag is all wrong, and no multiple of what is said."""
    bands = [described(scene, 0), described(scene, 1, sign=1e-9)]
    words = mistake(bands, Plane(0.0), (8, 8))
    assert "lines along its image, not 0 as the cameras say: check" in words


def test_two_lost_bands_with_each_others_images_are_named_together(scene) -> None:
    """The others hold, so it is no error: a warning says it once for both."""
    bands = exchange([described(scene, k) for k in range(4)], (0, 3, 2, 1))
    found = recover_line_of_sight(bands, Plane(0.0), options=RecoverOptions(passes=1))
    [said] = [words for words in found.warnings if "match nothing" in words]
    assert said == (
        "B1 and B2 match nothing: the image of B1 matches as that of B2, and B2's as B1's: exchange them"
    )


def test_a_lost_band_whose_image_another_was_found_with_is_named_with_it(scene, monkeypatch) -> None:
    """A wide search finds B2's image in the place of B1's, far off; B1's image is lost."""
    bands = exchange([described(scene, k) for k in range(4)], (0, 3, 2, 1))
    strip = prepared(bands, Plane(0.0), RecoverOptions())
    kept = np.full((4, 4), 100) * (1 - np.eye(4, dtype=int))
    tried, kept[3], kept[:, 3] = kept.copy(), 0, 0
    monkeypatch.setattr(warnings, "pairs_compared", lambda *_: (tried, kept))
    for px, said in (
        (16.0, "B1 and B2 match nothing, or far from their places: the image of B1"),
        (1.0, "B2 matches nothing"),
    ):
        statics = [px if p.name == "B1 offset along" else 0.0 for p in strip.parameters]
        state: Any = SimpleNamespace(records=(), estimate=SimpleNamespace(statics=np.array(statics)))
        (words,) = warnings._unmatched_bands(strip, state, RecoverOptions())
        assert words.startswith(said)


def test_a_third_lost_band_keeps_its_own_words() -> None:
    """Its image is noise: it changed places with none."""
    lags = (0.0, 0.005, 0.06, 0.1, 0.13)
    extra = {"names": tuple("PQRST"), "gains": (1.0,) * 5, "gammas": (1.0,) * 5}
    given = line_of_sight_case("nominal", 2, lines=700, columns=160, lags=lags, **extra)
    bands = exchange([described(given, k) for k in range(5)], (0, 1, 3, 2, 4))
    bands[4] = replace(bands[4], image=noise_like(given.image(4)))
    found = recover_line_of_sight(bands, Plane(0.0), options=RecoverOptions(passes=1))
    words = [w for w in found.warnings if "match nothing" in w or "matches nothing" in w]
    assert (
        words[0]
        == "R and S match nothing: the image of R matches as that of S, and S's as R's: exchange them"
    )
    assert len(words) == 2 and words[1].startswith("T matches nothing: ")


@pytest.mark.parametrize("kept_first", [True, False])
def test_a_sound_band_compared_with_a_wrong_one_alone_is_said_to_be_sound(kept_first, monkeypatch) -> None:
    """The first band is said to begin .03 s (60 lines) early; the last is compared with the first alone.

    Unless the first comes last: then the last matches the others.
    """
    if kept_first:
        monkeypatch.setattr("sightline.applications.line_of_sight.spoilt_hub", lambda *_: None)
    lags = {"lags": (0.0, 0.005, 0.09, 0.13, -0.06), "gains": (1.0,) * 5, "gammas": (1.0,) * 5}
    given = line_of_sight_case("nominal", 2, lines=800, columns=200, names=tuple("PQRST"), **lags)
    bands = [described(given, k) for k in range(5)]
    early = replace(bands[0].camera, first_line_time=-0.03)
    bands[0] = replace(bands[0], camera=early)
    found = recover_line_of_sight(bands, Plane(0.0), options=RecoverOptions(passes=1))
    said = [words for words in found.warnings if words.startswith("T matches nothing")]
    assert len(said) == kept_first
    assert all(re.search("it matches [QRS] where the cameras say", words) for words in said)
    assert any(words.startswith("P matches nothing") for words in found.warnings)


def test_a_lag_of_another_length_is_named_with_its_length(scene) -> None:
    """Look angles in other units, or of another altitude: the true one is .62 of what is said."""
    bands = [described(scene, k, sign=1.0 / 0.62) for k in (0, 1, 3)]
    words = mistake(bands, Plane(0.0), (8, 8))
    # .15 s at 2 lines a millisecond
    true, given = (abs(scene.bands[1].look_ahead) * 680e3 / 6800.0 / 0.0005 * k for k in (1.0, 1.0 / 0.62))
    lag, instead, times = (float(x) for x in re.findall(r"-?\d+\.?\d*", words.partition("PAN")[2]))
    assert words.startswith("B1: it matches PAN ")
    # jitter moves bands by some pixels, offsets by up to three sigma of one
    assert abs(abs(lag) - true) < 8.0 and abs(abs(instead) - given) < 8.0 and lag * instead > 0.0
    assert times == pytest.approx(lag / instead, abs=0.01)


@pytest.mark.parametrize(("axis", "said"), [(0, "its lines are taken the other way"), (1, "its columns are")])
def test_an_image_the_other_way_round_is_named(scene, axis, said) -> None:
    hub, partner = described(scene, 0), described(scene, 1)
    image = ArrayImage(np.ascontiguousarray(np.flip(scene.image(1), axis)))
    assert said in alternative(hub, replace(partner, image=image), Plane(0.0), (8, 8))


@pytest.mark.parametrize("scale", [1.02, 0.975])
def test_a_focal_length_some_per_cent_off_is_named_with_its_size(scene, scale) -> None:
    # pixels said to be larger: the image shows ground further from its middle than where it is sought
    words = alternative(described(scene, 0), described(scene, 1, scale=scale), Plane(0.0), (2, 2))
    size = f"{100 * abs(scale - 1.0):.1f} % {'larger' if scale > 1.0 else 'smaller'}"
    assert f"it matches PAN where a magnification {size} would have it" in words


def test_a_band_that_shows_other_ground_has_no_explanation(scene) -> None:
    partner = described(scene, 1)
    partner = replace(partner, image=noise_like(scene.image(1)))
    assert alternative(described(scene, 0), partner, Plane(0.0), (8, 8)) == ""


def test_a_band_that_matches_as_it_is_has_no_mistake(scene) -> None:
    """It is the last band that sees other ground: nothing is to be changed about the one before."""
    bands = [described(scene, 0), described(scene, 1), described(scene, 3, sign=60.0)]
    assert mistake(bands, Plane(0.0), (8, 8)) == ""


def test_a_reversed_image_reads_any_window_and_its_mask() -> None:
    pixels = np.arange(20.0).reshape(4, 5)
    unusable = pixels == 7.0
    for axis in (0, 1):
        image, turned = Reversed(ArrayImage(pixels, unusable), axis), np.flip(pixels, axis)
        np.testing.assert_array_equal(image.read((1, 4), (0, 3)), turned[1:4, 0:3])
        np.testing.assert_array_equal(image.mask((0, 4), (0, 5)), np.flip(unusable, axis))
