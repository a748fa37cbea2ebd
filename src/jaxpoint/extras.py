"""What comes after the results: pages, pictures, sheets, what is printed, a voice. None of it may cost a result."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from jaxpoint.errors import JaxpointError

_LOG = logging.getLogger(__name__)


@contextmanager
def extra(name: str, missing: list[str]) -> Iterator[None]:
    """Make something that comes after the results; where it fails, a warning says what is missing and why.

    This is the one place where every error is caught, and rightly so: the results lie on disk already, what fails here
    only shows them, and an exit code other than 0 would tell a script that they are no good. So nothing that decides
    about results belongs inside. An interruption (Ctrl-C, SIGTERM) is no error and passes through.

    Args:
        name: what is made, as a user knows it: "report.html".
        missing: takes the sentence, for the command's outcome.
    """
    try:
        yield
    except Exception as error:
        sentence = f"Missing: {name} ({_plain(error)}); the results are complete."
        missing.append(sentence)
        _LOG.warning(sentence)
        _LOG.info("Where %s failed:", name, exc_info=error)  # at this level under -v only


def _plain(error: Exception) -> str:
    """The kind of an error in plain words, without a full stop."""
    if isinstance(error, JaxpointError):
        return str(error).removesuffix(".")
    if isinstance(error, MemoryError):
        return "there was not enough memory for it"
    if isinstance(error, ModuleNotFoundError):
        return f"the package '{error.name}' is not installed; see `jaxpoint doctor`"
    if isinstance(error, OSError):
        where = "" if error.filename is None else f" at '{error.filename}'"
        return f"it could not be written or read ({error.strerror or type(error).__name__}{where})"
    return f"a fault in jaxpoint, {type(error).__name__}: please report it with what -v shows"
