"""The errors that a caller reacts to; everything else is a bug and ends its worker.

::

    SunarcError
    ├── InputError             the caller's input is wrong: say which field, and the remedy (exit 2, HTTP 4xx)
    │   ├── NotFoundError      what was asked for is not there (HTTP 404)
    │   └── ConflictError      it is there, and its state does not allow it (HTTP 409)
    ├── ConfigurationError     settings or installation are wrong: refuse to start (exit 2)
    │   └── SchemaError        the database is of another revision: run the command that it names
    ├── OutsideError           something outside failed: disk, port, peer (exit 3)
    │   └── StoreFullError     the disk of the database is full: what waits is stored when there is room
    └── CameraError            one exposure failed: try again within the cycle
        ├── CameraTimeoutError no frame came in time
        │   └── CameraSilentError not a packet of it came
        └── CameraLostError    the connection is gone: close, wait, open anew
            └── ExposureMismatchError the frame's brightness contradicts its exposure
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class SunarcError(Exception):
    """Base of the errors that are reported in one line."""


class InputError(SunarcError):
    """Error of input that cannot be used.

    Parameters
    ----------
    field : where the fault is, as the caller names it (a column, a query parameter, a file and line).
    problem : what is wrong with it, one sentence without a full stop.
    remedy : what to do about it.
    """

    def __init__(self, *, field: str, problem: str, remedy: str) -> None:
        problem = " ".join(problem.split()) if "\n" in problem else problem  # a library's own words may have lines
        super().__init__(f"{field}: {problem}; {remedy}")
        self.field = field
        self.problem = problem
        self.remedy = remedy


class NotFoundError(InputError):
    """Error of a request for something that does not exist."""


class ConflictError(InputError):
    """Error of a request to something that is not in the state for it."""


class ConfigurationError(SunarcError):
    """Error of settings with which the service cannot run."""


class SchemaError(ConfigurationError):
    """Error of a database at another revision than this version needs."""


class OutsideError(SunarcError):
    """Error of a disk, a network peer or a port."""


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Raise `OutsideError` where the disk refuses a write to a file or into a folder."""
    try:
        yield
    except OSError as error:
        raise OutsideError(f"cannot write {error.filename or path}: {error.strerror or error}") from error


class StoreFullError(OutsideError):
    """Error of a full disk: the database's, or that of its temporary files."""


class CameraError(SunarcError):
    """Error of a failed exposure."""


class CameraTimeoutError(CameraError):
    """Error of a frame that did not come in time."""


class CameraSilentError(CameraTimeoutError):
    """Error of a frame of which not a single packet came."""


class CameraLostError(CameraError):
    """Error of a camera whose connection is gone."""


class ExposureMismatchError(CameraLostError):
    """Error of frames that repeatedly contradict their exposure times; the connection is made again."""
