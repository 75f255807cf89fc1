"""Windows followed through frames whose motion is known: textures shifted in the Fourier domain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from sightline.errors import EstimationError, InputError
from sightline.imaging.source import ArrayImage
from sightline.matching import follow
from sightline.matching.follow import Followed, FollowPlan, fit_motion, follow_windows, move

SHAPE = (160, 170)
PLAN = FollowPlan(points=60)


def texture(seed: int) -> np.ndarray:
    """The spectrum (256, 288) of a periodic scene as a sensor sees it: 1/f, MTF 0.16 at Nyquist."""
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(256)[:, None], np.fft.fftfreq(288)[None, :]
    f = np.hypot(fy, fx)
    f[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.standard_normal((256, 288))) / f * np.exp(-(f**2) / (2.0 * 0.26**2))
    spectrum[0, 0] = 0.0
    return spectrum


def frame(spectrum: np.ndarray, shift: np.ndarray, seed: int, blur: float = 0.0) -> ArrayImage:
    """What a camera sees of a scene that moved by `shift` (line, column) px: contrast 20 %, SNR 100."""
    scene = np.fft.ifft2(ndimage.fourier_shift(spectrum, shift)).real
    scene = 100.0 + 20.0 * scene / scene.std()
    if blur:
        scene = ndimage.gaussian_filter(scene, blur)
    noise = np.random.default_rng(seed).standard_normal(SHAPE)
    return ArrayImage(scene[: SHAPE[0], : SHAPE[1]] + noise)


def shifts(count: int) -> np.ndarray:
    rng = np.random.default_rng(7)
    return np.cumsum(np.array([-3.3, 0.4]) + rng.normal(0.0, 0.7, (count, 2)), axis=0)


@pytest.fixture(scope="module")
def followed() -> tuple[np.ndarray, Followed]:
    moved, scene = shifts(12), texture(0)
    return moved, follow_windows([frame(scene, s, k) for k, s in enumerate(moved)], PLAN)


def test_motion_of_each_frame_is_that_of_the_scene(followed):
    moved, found = followed
    assert found.before.tolist() == [-1, *range(11)] and set(found.reason) == {""}
    # coarse-to-fine windows to a pixel's tenth, mean of dozens of them
    np.testing.assert_allclose(found.motion[1:, :2], np.diff(moved, axis=0), atol=0.1)
    assert np.abs(found.motion[1:, 2:]).max() < 2e-3


def test_windows_keep_to_their_ground_and_say_how_well(followed):
    moved, found = followed
    first = np.searchsorted(found.point, found.point)  # the hub: of each point the first
    error = found.pixels - found.pixels[first] - moved[found.image] + moved[found.image[first]]
    others = np.flatnonzero(first != np.arange(len(first)))
    pair = np.hypot(found.sigma_px[others], found.sigma_px[first[others]])
    # a window of 21 px, 20 % contrast and SNR 100 tells a shift to some hundredths of a pixel
    assert np.sqrt((error[others] ** 2).mean()) < 0.05
    ratio = np.sqrt(((error[others] / pair[:, None]) ** 2).mean())
    assert 0.5 < ratio < 2.0
    assert (np.bincount(found.image, minlength=12) == found.windows).all()
    assert found.windows.min() >= 40


def test_frames_missing_or_unlike_are_stepped_over_and_named():
    moved, scene = shifts(9), texture(1)
    frames: list[ArrayImage | None] = [frame(scene, s, k) for k, s in enumerate(moved)]
    frames[3] = None
    frames[6] = frame(texture(99), moved[6], 6)
    found = follow_windows(frames, PLAN)
    assert found.before.tolist() == [-1, 0, 1, -1, 2, 4, -1, 5, 7]
    assert found.reason[3] == "the image cannot be read"
    assert found.reason[6] == "looks like none of the frames before it"
    assert found.windows[[3, 6]].tolist() == [0, 0]
    np.testing.assert_allclose(found.motion[4, :2], moved[4] - moved[2], atol=0.1)


def test_a_blurred_frame_is_less_sharp_than_its_neighbours():
    moved, scene = shifts(7), texture(2)
    found = follow_windows([frame(scene, s, k, 2.0 if k == 3 else 0.0) for k, s in enumerate(moved)], PLAN)
    sharp = np.delete(found.sharpness, 3)
    assert found.sharpness[3] < 0.8 * sharp.min()
    assert sharp.max() < 1.2 * sharp.min()  # what is seen changes by two per cent of the frame


def test_a_new_stretch_begins_where_the_scene_is_another():
    moved = shifts(10)
    scenes = [texture(3)] * 5 + [texture(4)] * 5
    found = follow_windows([frame(t, s, k) for k, (t, s) in enumerate(zip(scenes, moved, strict=True))], PLAN)
    assert found.before.tolist() == [-1, 0, 1, 2, 3, -1, 5, 6, 7, 8]
    assert found.windows.min() > 20 and set(found.reason) == {""}
    of_first = np.unique(found.point[found.image < 5])
    assert not np.isin(found.point[found.image >= 5], of_first).any()


def test_turn_and_growth_are_found_though_a_third_of_the_windows_disagree():
    rng = np.random.default_rng(0)
    places, middle = rng.uniform(0.0, 400.0, (90, 2)), np.array([200.0, 200.0])
    truth = np.array([4.0, -7.0, 0.01, 0.005])
    moved = move(places, truth, middle)
    moved[:30] += rng.uniform(5.0, 40.0, (30, 2))
    motion, agree = fit_motion(places, moved, middle)
    np.testing.assert_allclose(motion, truth, atol=1e-9)
    assert agree.sum() == 60 and not agree[:30].any()


def test_a_turn_goes_from_line_towards_column():
    # by closed form: a place down the lines moves to higher columns
    moved = move(np.array([[110.0, 100.0]]), np.array([0.0, 0.0, 0.01, 0.0]), np.array([100.0, 100.0]))
    np.testing.assert_allclose(moved, [[110.0, 100.1]], atol=1e-12)


def test_what_cannot_be_followed_is_refused():
    scene = texture(5)
    good = frame(scene, np.zeros(2), 0)
    with pytest.raises(InputError, match="one size"):
        follow_windows([good, ArrayImage(np.ones((150, 170)))], PLAN)
    with pytest.raises(InputError, match="too small"):
        follow_windows([ArrayImage(np.ones((60, 170)))] * 2, PLAN)
    with pytest.raises(EstimationError, match="look alike"):
        follow_windows([good, None], PLAN)
    for wrong in ({"window": 20}, {"points": 5}, {"reduction": 0}, {"life": 1.5}, {"min_score": 0.0}):
        with pytest.raises(InputError):
            FollowPlan(**wrong)


def test_frames_are_followed_the_same_from_any_state_that_was_kept(monkeypatch):
    monkeypatch.setattr(follow, "_KEPT", 4)
    moved, scene = shifts(11), texture(5)
    frames: list[ArrayImage | None] = [frame(scene, s, k) for k, s in enumerate(moved)]
    frames[7] = frame(texture(98), moved[7], 7)  # waits for a frame that is like it
    states: list[follow.FollowState] = []
    whole = follow_windows(frames, PLAN, keep=states.append)
    assert [state.number for state in states] == [4, 8]
    assert states[1].waiting == 7
    for count in (1, 2):
        again = follow_windows(frames, PLAN, states=states[:count])
        for name in ("image", "point", "pixels", "sigma_px", "before", "motion", "windows", "sharpness"):
            np.testing.assert_array_equal(getattr(again, name), getattr(whole, name), err_msg=name)
        assert again.reason == whole.reason
