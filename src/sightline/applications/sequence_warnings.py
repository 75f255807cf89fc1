"""What a user should know of the poses of a sequence, in words.

Not here: what was noticed while reading (``io/sequence.py``).
"""

from __future__ import annotations

import numpy as np

from sightline.applications.frame_sequence import SequenceProblem
from sightline.photogrammetry.frame_poses import FramePoses, stretches

#: px, 1-sigma at the ends of a stretch, from which on it is worth saying that the stretch may be bent.
_BENT_PX = 1.0
_AXES = ("roll", "pitch", "yaw")


def bow_warnings(problem: SequenceProblem, poses: FramePoses) -> list[str]:
    """Stretches of which nothing tells well enough whether they are bent.

    Parameters
    ----------
    problem : SequenceProblem
    poses : FramePoses
        Of all its frames.

    Returns
    -------
    list of str
        One for each stretch that may be bent by a pixel and more (1-sigma) at its ends.
    """
    out = []
    detector = problem.detector
    # a turn moves the ground by the focal length times it, about the line of sight by the place in the frame
    lever = np.array([detector.focal_length_px] * 2 + [0.5 * float(np.hypot(*detector.shape))])
    stretch = stretches(problem.t)
    for number, sigma in enumerate(poses.bow):
        # an even trend of rms 1 ends at the root of 3
        ends = np.sqrt(3.0) * sigma * lever
        worst = int(np.argmax(ends))
        if ends[worst] < _BENT_PX:
            continue
        count = int((stretch == number).sum())
        out.append(
            f"stretch {number + 1} ({count} frames) may be bent: an even trend of {_AXES[worst]} from end to "
            f"end is known to {np.degrees(sigma[worst]):.2g} deg rms only (1-sigma), {ends[worst]:.1f} px at "
            "its ends; attitudes, better positions, known heights or crossing flight lines tell it"
        )
    return out
