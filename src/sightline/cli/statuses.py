"""Exit statuses of the command line, and which of them an error is.

0 done; 1 the data cannot give the answer; 2 wrong input or usage; 70 a defect of Sightline; 130 interrupted,
143 and 129 ended by SIGTERM and SIGHUP, 141 as nobody reads the output any more (128 and the number of the
signal).
"""

from __future__ import annotations

from sightline.cli.terminal import complain
from sightline.errors import EstimationError, GeometryError, SightlineError

DATA_CANNOT_ANSWER = 1
WRONG_INPUT = 2
DEFECT = 70
INTERRUPTED = 130
#: 128 and the number of SIGTERM, of SIGHUP, of SIGPIPE.
TERMINATED, HUNG_UP, UNREAD = 143, 129, 141


def status_of(error: Exception) -> int:
    """Say what went wrong on stderr and give the exit status that belongs to it."""
    if isinstance(error, SightlineError):
        complain("error", str(error))
        cannot_answer = isinstance(error, EstimationError | GeometryError) or type(error) is SightlineError
        return DATA_CANNOT_ANSWER if cannot_answer else WRONG_INPUT
    if isinstance(error, OSError):
        place = f": {error.filename}" if error.filename else ""
        complain("error", f"the system refused a file: {error.strerror or error}{place}")
        return WRONG_INPUT
    if isinstance(error, MemoryError):
        complain(
            "error", "memory ran out; give less at once: a shorter strip, fewer frames, columns or signals"
        )
        return DATA_CANNOT_ANSWER
    complain(
        "defect",
        f"{type(error).__name__}: {error}; this is a fault of Sightline, not of your input; run the same "
        "command with --debug and report what it prints",
    )
    return DEFECT
