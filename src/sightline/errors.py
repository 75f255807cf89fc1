"""The exceptions and the warning that Sightline raises on purpose.

::

    SightlineError
    ├── InputError (also ValueError)   what you gave is wrong: shape, type, value, unknown key
    ├── SpanError                      a time or a line lies outside what is known there
    ├── GeometryError                  the rays, surfaces and images do not meet
    ├── EstimationError                the data cannot give the answer asked for
    └── FormatError                    a file is missing, unreadable or not what its name says

    UnobservableBandWarning (a UserWarning)   the answer exists, but is blind at some frequencies

Every message has the same form: what happened: what was given; what is allowed; what to do.
A failure of one point is a NaN row in the result; an exception means that the whole call failed.

This file holds no checks: those of array arguments are in ``geometry/checks.py``.
"""


class SightlineError(Exception):
    """Base of every exception that Sightline raises on purpose."""


class InputError(SightlineError, ValueError):
    """What the caller gave is wrong: a shape, a type, a value, a name."""


class SpanError(SightlineError):
    """A time or an image line lies outside the span that a trajectory, motion or table covers."""


class GeometryError(SightlineError):
    """The geometry has no answer: no ray meets the surface, two images do not overlap."""


class EstimationError(SightlineError):
    """The data are well formed but cannot determine what was asked for."""


class FormatError(SightlineError):
    """A file is missing, unreadable, truncated or not of the form expected; names the file and the place."""


class UnobservableBandWarning(UserWarning):
    """The estimate is blind near some frequencies; the message names them."""
