"""The errors that jaxpoint raises on purpose.

Each message is one sentence or two: what is wrong, the number, the remedy. Each class carries the exit code with
which the command line ends. Plain Python: importing this module imports nothing heavy.
"""


class JaxpointError(Exception):
    """Base of all errors that a user can act upon."""

    exit_code = 1


class UsageError(JaxpointError):
    """An option, a config key or an output folder is not usable as given."""

    exit_code = 2


class MissingDependencyError(JaxpointError):
    """Something that is not part of jaxpoint is missing: an extra, a program, a device."""

    exit_code = 3


class InsufficientDataError(JaxpointError):
    """The data cannot determine what is asked: too little, unconnected or degenerate."""

    exit_code = 4


class ContradictionError(InsufficientDataError):
    """One camera is of no use, or fits no other; the rest may do without it."""

    def __init__(self, message: str, camera: int, cause: str):
        super().__init__(message)
        self.camera = camera  # its place among the cameras
        self.causes = (cause,)  # words that stay the same from version to version


class QualityError(JaxpointError):
    """A result was reached and kept, but it fails a stated quality threshold."""

    exit_code = 5


class NotConvergedError(JaxpointError):
    """An iteration ended without reaching a minimum."""

    exit_code = 6


class FileFormatError(JaxpointError):
    """A file cannot be read as what it should be."""

    exit_code = 7
