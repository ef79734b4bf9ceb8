"""Write files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from evanesce.core.errors import WorkError


def write_text(path: Path, text: str) -> None:
    """Write a text file as UTF-8; as :func:`write_bytes`.

    Parameters
    ----------
    path : Path
    text : str

    Raises
    ------
    WorkError
    """
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file so that a reader, or a crash, sees the old content or the new one.

    Parameters
    ----------
    path : Path
        Its folder exists.
    content : bytes

    Raises
    ------
    WorkError
        If the file cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix="." + path.name)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror}") from None
