"""The two errors with which a command ends, each a single line a user can act on."""

from __future__ import annotations

from pathlib import Path


class EvanesceError(Exception):
    """Base of the errors that the command line prints without a traceback."""

    exit_code = 1


class InputError(EvanesceError, ValueError):
    """Unusable input (exit code 2).

    Parameters
    ----------
    what : str
        What is wrong, with the offending value.
    file, key : optional
        Where it stands.
    allowed : str, optional
        What would be accepted instead.
    """

    exit_code = 2

    def __init__(
        self, what: str, *, file: str | Path | None = None, key: str | None = None, allowed: str | None = None
    ) -> None:
        self.what, self.file, self.key, self.allowed = what, file, key, allowed
        where = ": ".join(str(part) for part in (file, key) if part is not None)
        line = f"{where}: {what}" if where else what
        if allowed:
            line += f" (allowed: {allowed})"
        super().__init__(" ".join(line.split()))


class WorkError(EvanesceError, RuntimeError):
    """Failure with valid input (exit code 1): disk full, a solver out of range, a corrupt video."""

    exit_code = 1
