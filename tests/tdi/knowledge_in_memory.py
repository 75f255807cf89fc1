"""A recovery as TDI takes it: its motion, the density of its error, its hidden directions.

Not here: reading the same from a folder (``io/tdi/motion.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.evaluation.error_spectrum import error_psd
from sightline.motion.results import LineOfSight
from sightline.motion.tones import spectrum
from sightline.tdi.motion_knowledge import MotionKnowledge, error_and_jitter

Array = NDArray[np.float64]


def motion_knowledge(result: LineOfSight) -> MotionKnowledge:
    """What a recovery tells of the motion, for the choice of TDI stages.

    Parameters
    ----------
    result : LineOfSight
        Of a strip.
    """
    found = spectrum(result.motion)
    error, jitter = error_and_jitter(found.frequency, error_psd(result, found.frequency), found.psd)
    covariance = result.hidden_covariance
    hidden = None if covariance is None else result.hidden
    return MotionKnowledge(result.motion, found.frequency, error, hidden, covariance, jitter)
