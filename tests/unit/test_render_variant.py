"""Finding a working variant: ranking of libraries, cache, fallback, and libraries that fail or abort."""

from __future__ import annotations

import json
import os
import platform
import stat
import subprocess
import sys

import pytest

from evanesce.core.errors import InputError
from evanesce.render import variant
from evanesce.render.variant import (
    LLVM_PACKAGE,
    Attempt,
    attempts,
    find,
    llvm_candidates,
    llvm_major,
    llvm_source,
    packaged_llvm,
    probe,
    rank_llvm,
)
from support.rigs import need


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


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install a stand-in of the package in a folder of its own, and give a system that has LLVM 14, 15 and 19."""

    def install(name: str = "libLLVM.so.19.1", version: str = "19.1.7") -> dict[str, str]:
        lib, site = tmp_path / "user" / "lib", tmp_path / "user" / "lib" / "python3" / "site-packages"
        info = site / f"karellen_llvm_core-{version}.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {LLVM_PACKAGE}\nVersion: {version}\n")
        (lib / name).write_bytes(b"")
        (lib / "libLLVM.so").symlink_to(name)
        (lib / "libLTO.so.19.1").write_bytes(b"")
        files = [name, "libLLVM.so", "libLTO.so.19.1", "libLLVM-gone.so"]
        (info / "RECORD").write_text("".join(f"../../{file},,\n" for file in files))
        system = tmp_path / "system"
        system.mkdir()
        for major in (14, 15, 19):
            (system / f"libLLVM-{major}.so").write_bytes(b"")
        monkeypatch.syspath_prepend(site)
        monkeypatch.setattr(sys, "prefix", str(tmp_path / "elsewhere"))
        monkeypatch.setattr(variant, "_LLVM_PLACES", (f"{system}/libLLVM*.so*",))
        monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
        return {"package": str(lib / name)} | {str(m): str(system / f"libLLVM-{m}.so") for m in (15, 19)}

    return install


def test_the_package_is_found_where_it_was_installed_and_comes_first_of_its_version(installed):
    """By the distribution's own list of files: a user site or `--prefix` lies outside of `sys.prefix`."""
    paths = installed()
    assert packaged_llvm() == [paths["package"]]
    assert llvm_candidates() == [paths["package"], paths["19"], paths["15"]]
    assert llvm_source(paths["package"]) == f"package {LLVM_PACKAGE} 19.1.7"
    assert llvm_source(paths["15"]) == "system"


def test_nineteen_of_the_system_precedes_another_version_of_the_package_which_precedes_fifteen(installed):
    paths = installed("libLLVM.so.18.1", "18.1.8")
    assert llvm_candidates() == [paths["19"], paths["package"], paths["15"]]


def test_a_library_that_aborts_is_not_even_tried_where_the_package_works(installed, monkeypatch):
    paths = installed()
    tried = []

    def run(family, path):
        tried.append(path)
        return Attempt(family, path, "19.1.7")

    monkeypatch.setattr(variant, "_run_probe", run)
    assert [a.llvm_path for a in attempts("llvm")] == [paths["package"]]
    assert find("auto").llvm_path == paths["package"]
    assert tried == [paths["package"]]


def test_the_system_is_tried_where_the_package_does_not_work(installed, monkeypatch):
    paths = installed()
    broken = {paths["package"]: "aborted (signal 6)"}
    monkeypatch.setattr(
        variant, "_run_probe", lambda family, path: Attempt(family, path, "19.1.0", error=broken.get(path, ""))
    )
    assert find("auto").llvm_path == paths["19"]


def test_without_the_package_only_the_system_counts(monkeypatch):
    monkeypatch.setattr(variant, "LLVM_PACKAGE", "no-such-distribution")
    assert packaged_llvm() == []


@pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="the package has no wheel for this platform"
)
def test_the_package_is_installed_here_and_its_library_works(monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    info = find("llvm")
    assert info.llvm_path == packaged_llvm()[0]
    assert info.backend_version == "19.1.7"
    assert info.record()["llvm_path"] == "libLLVM.so.19.1"


def test_a_file_that_is_not_there_is_told_without_a_process(tmp_path, monkeypatch):
    monkeypatch.setattr(subprocess, "run", None)
    assert probe("llvm", str(tmp_path / "libLLVM.so")).error == "no such file"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    assert llvm_source(str(tmp_path / "libLLVM.so")) == "DRJIT_LIBLLVM_PATH"


def _in_a_process_of_its_own(script: str, **environ: str) -> str:
    given = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"} | environ
    done = subprocess.run([sys.executable, "-c", script], env=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_chosen_library_is_the_one_that_dr_jit_loads():
    need("llvm")
    chosen = find("llvm")
    script = """
from evanesce.render.variant import select
path = select("llvm").llvm_path
import os, drjit.llvm
assert drjit.sum(drjit.llvm.Float([1, 2, 3]))[0] == 6
maps = open("/proc/self/maps").read() if os.path.exists("/proc/self/maps") else os.path.realpath(path)
print(path, os.path.realpath(path) in maps)
"""
    environ = {"DRJIT_LIBLLVM_PATH": chosen.llvm_path} if "DRJIT_LIBLLVM_PATH" in os.environ else {}
    assert _in_a_process_of_its_own(script, **environ).split() == [chosen.llvm_path, "True"]


def test_dr_jit_imported_too_early_leads_to_scalar_with_a_note_and_not_to_an_abort():
    """Dr.Jit keeps the LLVM that it finds when it is imported: here none, on a bare machine one that aborts."""
    need("llvm")
    script = f"""
import os
os.environ["DRJIT_LIBLLVM_PATH"] = "/nowhere/libLLVM.so"
import mitsuba
os.environ["DRJIT_LIBLLVM_PATH"] = {find("llvm").llvm_path!r}
from evanesce.core.errors import InputError
from evanesce.render.variant import select
info = select()
print(info.name, mitsuba.variant(), info.note)
try:
    select("llvm")
except InputError as error:
    print(error)
"""
    auto, asked = _in_a_process_of_its_own(script).strip().splitlines()
    assert auto.startswith("scalar_rgb scalar_rgb Dr.Jit was imported before")
    assert "has loaded no LLVM" in auto
    assert asked.startswith("--variant: Dr.Jit was imported before")


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
    library = tmp_path / "libLLVM-15.so"
    library.touch()
    attempt = probe("llvm", str(library))
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
