"""Shared fixtures. Real input lies beside the checkout in ../shared; tests that need it skip where it is absent."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import pytest

from evanesce.core.errors import InputError
from evanesce.render.variant import find

ROOT = Path(__file__).resolve().parent.parent
RIG_PHOTO = ROOT.parent / "shared" / "reference" / "rig_photo"
CONTACT_FRAME = RIG_PHOTO.parent / "real_contact_frame"


def pytest_configure(config: pytest.Config) -> None:
    """Choose the LLVM of all processes: Dr.Jit takes what it finds when any test first imports it, and keeps it."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        with contextlib.suppress(InputError):
            os.environ["DRJIT_LIBLLVM_PATH"] = find("llvm").llvm_path


@pytest.fixture(scope="session")
def rig_photo() -> Path:
    """Folder with the real photograph and its corner list."""
    if not (RIG_PHOTO / "checkerboard_1mm.png").is_file():
        pytest.skip(f"the real photograph is not here: {RIG_PHOTO} does not exist")
    return RIG_PHOTO


@pytest.fixture(scope="session")
def contact_frame() -> Path:
    """Folder with the thumbnail of the one public contact frame."""
    if not (CONTACT_FRAME / "frame_thumbnail.png").is_file():
        pytest.skip(f"the real contact frame is not here: {CONTACT_FRAME} does not exist")
    return CONTACT_FRAME
