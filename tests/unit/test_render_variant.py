"""Finding a working variant: ranking of libraries, cache, fallback, and libraries that fail or abort."""

from __future__ import annotations

import json
import os
import stat
import sys

import pytest

from evanesce.core.errors import InputError
from evanesce.render import variant
from evanesce.render.variant import Attempt, find, llvm_candidates, llvm_major, probe, rank_llvm


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("EVANESCE_CACHE", str(tmp_path / "cache"))


@pytest.mark.parametrize(
    ("path", "major"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM-19.so", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM.so.20.1", 20),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14),
        ("/usr/lib/llvm-18/lib/libLLVM.so", 18),
        ("/opt/homebrew/opt/llvm@17/lib/libLLVM.dylib", 17),
        ("C:/Program Files/LLVM/bin/LLVM-C.dll", 0),
    ],
)
def test_version_of_a_library(path, major):
    assert llvm_major(path) == major


def test_nineteen_first_the_aborting_ones_last_the_refused_ones_never():
    paths = [f"/usr/lib/llvm-{v}/lib/libLLVM-{v}.so" for v in (14, 15, 16, 17, 18, 19, 20, 21)]
    assert [llvm_major(p) for p in rank_llvm(paths)] == [19, 20, 21, 18, 17, 16, 15]


def test_the_users_choice_is_the_only_candidate():
    assert llvm_candidates({"DRJIT_LIBLLVM_PATH": "/somewhere/libLLVM.so"}) == ["/somewhere/libLLVM.so"]


def test_scalar_works_and_is_remembered(monkeypatch):
    assert probe("scalar").works

    def fail(*_):
        raise AssertionError("probed twice")

    monkeypatch.setattr(variant, "_run_probe", fail)
    assert probe("scalar").works
    with pytest.raises(AssertionError, match="twice"):
        probe("scalar", fresh=True)


def _interpreter(tmp_path, body: str) -> str:
    """Return an executable that stands in for Python."""
    path = tmp_path / "fake-python"
    path.write_text(f"#!/bin/sh\n{body}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


@pytest.mark.skipif(os.name == "nt", reason="needs a POSIX shell")
@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("echo 'LLVM ERROR: Cannot select: fminimum' >&2; kill -ABRT $$", "signal 6.*Cannot select"),
        ("echo nonsense; exit 0", "failed"),
        ('echo \'PROBE{"mean": 0.1, "backend_version": "9"}\'', "wrong result"),
        ('echo \'PROBE{"mean": NaN, "backend_version": "9"}\'', "wrong result"),
    ],
)
def test_what_a_bad_backend_does_is_told(tmp_path, monkeypatch, body, expected):
    monkeypatch.setattr(sys, "executable", _interpreter(tmp_path, body))
    attempt = probe("llvm", "/lib/libLLVM-15.so")
    assert not attempt.works
    assert __import__("re").search(expected, attempt.error)


def test_auto_falls_back_to_scalar_and_says_how_to_get_llvm(monkeypatch):
    monkeypatch.setattr(variant, "llvm_candidates", lambda: ["/lib/libLLVM-15.so"])
    monkeypatch.setattr(
        variant,
        "probe",
        lambda family, path="", *, fresh=False: Attempt(family, path, error="aborted" if family == "llvm" else ""),
    )
    info = find("auto")
    assert info.name == "scalar_rgb"
    assert not info.is_jit
    assert "libLLVM-15.so: aborted" in info.note
    assert "libllvm19" in info.note
    with pytest.raises(InputError, match=r"libllvm19.*allowed: auto"):
        find("llvm")


def test_no_library_at_all(monkeypatch):
    monkeypatch.setattr(variant, "llvm_candidates", lambda: [])
    with pytest.raises(InputError, match="no libLLVM found"):
        find("llvm")


def test_unknown_variant_names_the_allowed_ones():
    with pytest.raises(InputError, match="auto, llvm, cuda, scalar"):
        find("opengl")


def test_unreadable_cache_is_no_obstacle(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    folder.mkdir()
    (folder / "variants.json").write_text("{broken", encoding="utf-8")
    monkeypatch.setattr(variant, "_run_probe", lambda family, path: Attempt(family, path, "1.2"))
    assert probe("scalar").backend_version == "1.2"
    assert json.loads((folder / "variants.json").read_text(encoding="utf-8"))
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("EVANESCE_CACHE", str(tmp_path / "file"))  # cannot be a folder
    assert probe("scalar").works


def test_record_holds_no_path_of_this_machine():
    info = variant.VariantInfo("llvm", "llvm_ad_mono", "19.1.7", "/usr/lib/somewhere/libLLVM-19.so")
    assert info.record()["llvm_path"] == "libLLVM-19.so"
