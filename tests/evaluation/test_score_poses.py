import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.errors import InputError
from sightline.evaluation.score_poses import PARAMETERS, align, pose_errors, score_poses

#: Rough size of what is stated per parameter: m, rad.
SIGMA = np.array([0.5, 0.3, 0.8, 1e-3, 2e-3, 5e-4])


def flight(count=400, seed=0, lines=1):
    """True poses on one or two lines of a flight, jittering."""
    rng = np.random.default_rng(seed)
    along = np.arange(count) % (count // lines)
    position = np.column_stack(
        [0.4 * along, 30.0 * (np.arange(count) // (count // lines)), np.full(count, 80.0)]
    )
    attitude = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0])) * Rotation.from_rotvec(
        rng.normal(0.0, 0.02, (count, 3))
    )
    return position + rng.normal(0.0, 0.2, (count, 3)), attitude


def estimate(position, attitude, covariance, seed):
    """Poses whose errors are drawn from a covariance."""
    errors = np.random.default_rng(seed).multivariate_normal(np.zeros(6), covariance, len(position))
    return position + errors[:, :3], attitude * Rotation.from_rotvec(errors[:, 3:])


def test_errors_are_estimate_less_truth():
    position, attitude = flight(5)
    turned = attitude * Rotation.from_rotvec([1e-3, -2e-3, 3e-3])
    errors = pose_errors(position + np.array([1.0, 2.0, 3.0]), turned, position, attitude)
    np.testing.assert_allclose(errors, [[1.0, 2.0, 3.0, 1e-3, -2e-3, 3e-3]] * 5, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_honest_covariances_score_one(seed):
    rng = np.random.default_rng(100 + seed)
    shape = np.eye(6) + 0.4 * rng.normal(size=(6, 6))
    covariance = shape @ shape.T
    covariance *= np.outer(SIGMA, SIGMA) / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    position, attitude = flight(2000)
    found, turned = estimate(position, attitude, covariance, seed)
    sigma = np.tile(SIGMA, (2000, 1))
    score = score_poses(
        found, turned, position, attitude, sigma=sigma, covariance=np.tile(covariance, (2000, 1, 1))
    )
    for name, stated in zip(PARAMETERS, SIGMA, strict=True):
        entry = score["absolute"][name]
        # mean of 2000 squares: sqrt(2 / 2000) = 3.2 %, coverage sqrt(.95 .05 / 2000) = .5 %; four of each
        assert entry["nees"] == pytest.approx(1.0, abs=0.13)
        assert entry["coverage_95"] == pytest.approx(0.95, abs=0.02)
        assert entry["rms"] == pytest.approx(stated, rel=0.07) and entry["sigma"] == pytest.approx(stated)
    # of six parameters together: sqrt(2 6 / 2000) = .077
    assert score["absolute"]["nees"] == pytest.approx(6.0, abs=0.31)


def test_errors_twice_the_stated_ones_score_four():
    position, attitude = flight(2000)
    found, turned = estimate(position, attitude, np.diag(4 * SIGMA**2), 1)
    score = score_poses(found, turned, position, attitude, sigma=np.tile(SIGMA, (2000, 1)))
    for name in PARAMETERS:
        assert score["absolute"][name]["nees"] == pytest.approx(4.0, rel=0.13)
        assert score["absolute"][name]["coverage_95"] == pytest.approx(0.673, abs=0.045)  # |z| < 0.98
    assert "nees" not in score["absolute"]


@pytest.mark.parametrize("lines", [1, 2])
@pytest.mark.parametrize("scale", [1.0, 1.02])
def test_alignment_takes_off_what_is_common_to_all_frames(lines, scale):
    position, attitude = flight(lines=lines)
    turn = Rotation.from_rotvec([0.02, -0.01, 0.3])
    found, turned = turn.inv().apply(position - [10.0, -5.0, 3.0]) / scale, turn.inv() * attitude
    score = score_poses(found, turned, position, attitude)
    assert score["absolute"]["x"]["rms"] > 5.0 and score["absolute"]["yaw"]["rms"] > 0.2
    aligned = score["similarity"]
    assert max(aligned[name]["max"] for name in PARAMETERS) < 1e-6
    assert aligned["alignment"]["scale"] == pytest.approx(scale)
    np.testing.assert_allclose(aligned["alignment"]["rotation_rad"], turn.as_rotvec(), atol=1e-6)
    rigid = score["rigid"]
    assert rigid["alignment"]["scale"] == 1.0
    # a strip of 160 m (80 m: two lines) that is too short by 2 % is off by 1.6 m (.8 m) at its ends, to the
    # jitter of .2 m that may stand there
    end = 80.0 / lines * (1.0 - 1.0 / scale)
    assert rigid["x"]["max"] == pytest.approx(end, abs=0.02 if end else 1e-6)


def test_one_straight_line_is_aligned_about_itself_by_attitudes():
    count = 50
    position = np.column_stack([np.arange(count, dtype=float), np.zeros(count), np.full(count, 80.0)])
    attitude = Rotation.from_quat(np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)))
    turn = Rotation.from_rotvec([0.4, 0.1, -0.2])
    fit = align(turn.inv().apply(position), turn.inv() * attitude, position, attitude, scaled=False)
    assert (fit.rotation.inv() * turn).magnitude() < 1e-9


def test_kinds_of_poses_are_scored_apart():
    position, attitude = flight(6)
    found = position.copy()
    found[3:] += 2.0
    source = ("solved",) * 3 + ("interpolated",) * 3
    score = score_poses(found, attitude, position, attitude, source=source)
    assert score["by_source"]["solved"]["x"]["rms"] == 0.0
    assert score["by_source"]["interpolated"] == score["by_source"]["interpolated"] | {"frames": 3}
    assert score["by_source"]["interpolated"]["x"]["rms"] == pytest.approx(2.0)


def test_infinite_sigmas_are_left_out_and_nothing_in_common_is_refused():
    position, attitude = flight(6)
    sigma = np.full((6, 6), np.inf)
    sigma[:3] = 1.0
    score = score_poses(position, attitude, position, attitude, sigma=sigma)
    assert score["absolute"]["x"]["nees"] == 0.0
    with pytest.raises(InputError, match="no frame"):
        score_poses(position[:0], attitude[:0], position[:0], attitude[:0])
