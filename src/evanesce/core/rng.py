"""Independent random streams of one seed, each by name, so that the order of calls does not matter."""

from __future__ import annotations

import hashlib

import numpy as np


def seed_sequence(seed: int, *names: str | int) -> np.random.SeedSequence:
    """Return the seed sequence of a named stream.

    Parameters
    ----------
    seed : int
        The one seed of a run, 0 <= seed < 2**63.
    *names : str or int
        Path of the stream, for instance ``("sensor", frame_index)``.

    Returns
    -------
    numpy.random.SeedSequence
    """
    digest = hashlib.sha256("\x1f".join(f"{type(n).__name__}:{n}" for n in names).encode()).digest()
    return np.random.SeedSequence([seed, *np.frombuffer(digest, dtype=np.uint32).tolist()])


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """Return the numpy generator of a named stream (PCG64).

    Parameters
    ----------
    seed : int
        Of the run.
    *names : str or int
        Path of the stream, for instance ``("sensor", frame_index)``.

    Returns
    -------
    numpy.random.Generator
    """
    return np.random.Generator(np.random.PCG64(seed_sequence(seed, *names)))


def integer_seed(seed: int, *names: str | int) -> int:
    """Return a 32-bit seed of a named stream, for libraries that take an integer.

    Parameters
    ----------
    seed : int
        Of the run.
    *names : str or int
        Path of the stream, for instance ``("sensor", frame_index)``.

    Returns
    -------
    int
        0 to 2^32 - 1.
    """
    return int(seed_sequence(seed, *names).generate_state(1)[0])
