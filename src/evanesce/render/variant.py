"""Which Mitsuba variant works on this machine: tried in a subprocess, because a bad LLVM aborts the process.

Dr.Jit 1.5 refuses libLLVM 14 and aborts in code generation with 15 and 16 on processors with AVX-512; an abort cannot
be caught, so each candidate renders a tiny scene in a process of its own, once, and the answer is kept on disk. On
x86-64 Linux the package karellen-llvm-core, a dependency, brings libLLVM 19; elsewhere, and where it does not work, the
system's libraries are tried.
"""

from __future__ import annotations

import glob
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import platformdirs

from evanesce.core.errors import InputError
from evanesce.core.provenance import digest, package_versions

FAMILIES = {"llvm": "llvm_ad_mono", "cuda": "cuda_ad_mono", "scalar": "scalar_rgb"}
CHOICES = ("auto", *FAMILIES)
PROBE_SECONDS = 180
LLVM_PACKAGE = "karellen-llvm-core"
"""The distribution that brings libLLVM where it has a wheel (x86-64 Linux)."""

LLVM_HELP = (
    f"install LLVM 19 (x86-64 Linux: pip install {LLVM_PACKAGE}==19.1.7; Debian, Ubuntu: apt install libllvm19) or set "
    "DRJIT_LIBLLVM_PATH to a libLLVM of 17 or newer"
)
_LLVM_PLACES = (
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
    "C:/Program Files/LLVM/bin/LLVM-C.dll",
)

# The probe: a furnace whose answer is known (albedo 0.5 in a uniform unit environment reads 0.5), with a complex number
# and a minimum in it, which is what the broken code generators choke on.
_PROBE = """
import json, sys
import drjit as dr, mitsuba as mi, numpy as np
mi.set_variant(sys.argv[1])
scene = mi.load_dict({
    "type": "scene", "integrator": {"type": "path", "max_depth": 3},
    "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": 0.5}}, "sky": {"type": "constant"},
    "sensor": {"type": "perspective", "fov": 5,
               "to_world": mi.ScalarTransform4f().look_at([0, 0, -9], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}},
})
mean = float(np.array(mi.render(scene, spp=64)).mean())
version = ""
if sys.argv[1].startswith("llvm"):
    version = ".".join(map(str, dr.detail.llvm_version()))
elif sys.argv[1].startswith("cuda"):
    version = ".".join(map(str, dr.detail.cuda_version()))
print("PROBE" + json.dumps({"mean": mean, "backend_version": version}))
"""


@dataclass(frozen=True)
class VariantInfo:
    """A working variant, as provenance records it.

    Attributes
    ----------
    family : str
        ``llvm``, ``cuda`` or ``scalar``.
    name : str
        Mitsuba's name of it.
    backend_version : str
        Of LLVM or CUDA; empty for scalar.
    llvm_path : str
        Library used; empty unless llvm.
    note : str
        What the user should know: why a slower family was taken, and how to get the faster one.
    """

    family: str
    name: str
    backend_version: str = ""
    llvm_path: str = ""
    note: str = ""

    @property
    def is_jit(self) -> bool:
        """Whether Python plugins run at full speed in it."""
        return self.family != "scalar"

    def record(self) -> dict[str, Any]:
        """Return JSON-able data for provenance: the library's name, not its place on this machine."""
        data = asdict(self)
        data["llvm_path"] = Path(self.llvm_path).name
        return data


@dataclass(frozen=True)
class Attempt:
    """Outcome of one probe: ``error`` is empty where the variant works."""

    family: str
    llvm_path: str = ""
    backend_version: str = ""
    error: str = ""
    notes: tuple[str, ...] = field(default=())

    @property
    def works(self) -> bool:
        """Whether the tiny scene came back with the right brightness."""
        return not self.error


def cache_folder() -> Path:
    """Return the folder of cached answers: ``EVANESCE_CACHE`` if set, else the user's cache folder."""
    return Path(os.environ.get("EVANESCE_CACHE") or platformdirs.user_cache_dir("evanesce"))


def llvm_major(path: str) -> int:
    """Return the major version that a library's path names, 0 where it names none."""
    found = re.findall(r"(?:LLVM(?:\.so\.|[-.]?)|llvm[-@]?)(\d{2})(?!\d)", path)
    return int(found[-1]) if found else 0


def packaged_llvm() -> list[str]:
    """Return the libLLVM files of the distribution karellen-llvm-core, wherever it was installed (user site, --prefix).

    Names that are links to the same file are left out. Empty where the distribution, or its library, is not there:
    ``pip install --target`` leaves out what belongs in ``lib``.
    """
    try:
        files = distribution(LLVM_PACKAGE).files or []
    except PackageNotFoundError:
        return []
    named = (Path(str(f.locate())).resolve() for f in files if re.fullmatch(r"libLLVM[-.].*", f.name))
    return sorted({str(path) for path in named if path.is_file()})


def rank_llvm(paths: Iterable[str], first: Iterable[str] = ()) -> list[str]:
    """Order library paths by promise: 19, then newer, 18, 17, unknown, and 16 and 15 last; older ones are left out.

    Parameters
    ----------
    paths : iterable of str
    first : iterable of str
        Those of ``paths`` that precede others of the same major version.
    """
    preferred = frozenset(first)

    def rank(path: str) -> tuple[int, int]:
        major = llvm_major(path)
        if major == 19:
            return 0, 0
        if major > 19:
            return 1, major
        if major >= 17:
            return 2, -major
        return (3, 0) if major == 0 else (4, -major)

    able = (p for p in paths if not 0 < llvm_major(p) < 15)
    return sorted(able, key=lambda p: (rank(p), p not in preferred, p))


def llvm_candidates(environ: Mapping[str, str] | None = None) -> list[str]:
    """Return libLLVM paths worth trying, best first; ``DRJIT_LIBLLVM_PATH`` alone if it is set.

    Of one major version the package's library precedes the system's: it is the build that this project is tested with.
    """
    environ = os.environ if environ is None else environ
    given = environ.get("DRJIT_LIBLLVM_PATH")
    if given:
        return [given]
    packaged = packaged_llvm()
    places = [*_LLVM_PLACES, f"{sys.prefix}/lib/libLLVM*.so*", f"{sys.prefix}/lib/libLLVM*.dylib"]
    found = {p for place in places for p in glob.glob(place)}
    by_target: dict[str, str] = {}
    for path in rank_llvm(found.union(packaged), packaged):
        by_target.setdefault(os.path.realpath(path), path)
    return list(by_target.values())


def llvm_source(path: str) -> str:
    """Return where a libLLVM comes from: a package with its version, ``DRJIT_LIBLLVM_PATH``, or the system."""
    if os.path.realpath(path) in packaged_llvm():
        return f"package {LLVM_PACKAGE} {distribution(LLVM_PACKAGE).version}"
    return "DRJIT_LIBLLVM_PATH" if path == os.environ.get("DRJIT_LIBLLVM_PATH") else "system"


def _cpu_model() -> str:
    """Return the processor's model and its vector extensions: a broken code generator depends on both."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    model = re.search(r"^model name\s*:\s*(.*)$", text, re.MULTILINE)
    wide = " avx512f" if " avx512f" in text else ""
    return (model.group(1) if model else platform.machine()) + wide


def _cache_key(family: str, llvm_path: str) -> str:
    library = Path(llvm_path)
    stamp = library.stat().st_mtime_ns if llvm_path and library.is_file() else 0
    versions = package_versions(("mitsuba", "drjit"))
    return digest([family, llvm_path, stamp, versions, _cpu_model(), sys.version, digest(_PROBE)])


def _read_cache() -> dict[str, Any]:
    try:
        data = json.loads((cache_folder() / "variants.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def _write_cache(data: dict[str, Any]) -> None:
    """Keep the answers; a folder that cannot be written only costs the next start a few seconds."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=folder, prefix=".variants")
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            json.dump(data, stream, indent=1)
        os.replace(name, folder / "variants.json")
    except OSError:
        return


def _run_probe(family: str, llvm_path: str) -> Attempt:
    if os.path.dirname(llvm_path) and not os.path.isfile(llvm_path):
        return Attempt(family, llvm_path, error="no such file")
    environ = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    if llvm_path:
        environ["DRJIT_LIBLLVM_PATH"] = llvm_path
    command = [sys.executable, "-c", _PROBE, FAMILIES[family]]
    try:
        done = subprocess.run(
            command, env=environ, capture_output=True, text=True, errors="replace", timeout=PROBE_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return Attempt(family, llvm_path, error=f"no answer within {PROBE_SECONDS} s")
    except OSError as error:
        return Attempt(family, llvm_path, error=f"cannot start: {error.strerror}")
    answer = re.search(r"PROBE(\{[^}]*\})", done.stdout)
    if done.returncode != 0 or answer is None:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        telling = [s for s in lines if re.search(r"LLVM ERROR|too old|Error|could not|hasn't been", s)]
        reason = (telling or lines or ["no message"])[-1][:200]
        ended = f"aborted (signal {-done.returncode})" if done.returncode < 0 else "failed"
        return Attempt(family, llvm_path, error=f"{ended}: {reason}")
    value = json.loads(answer.group(1))
    if not abs(value["mean"] - 0.5) < 0.03:  # 4096 samples: six standard deviations
        return Attempt(family, llvm_path, error=f"wrong result: a furnace of albedo 0.5 reads {value['mean']:.4g}")
    return Attempt(family, llvm_path, str(value["backend_version"]))


def probe(family: str, llvm_path: str = "", *, fresh: bool = False) -> Attempt:
    """Try one family (with one libLLVM) in a subprocess, or recall what came of it.

    Parameters
    ----------
    family : {"llvm", "cuda", "scalar"}
    llvm_path : str
        Library for llvm; empty otherwise.
    fresh : bool
        Try again even if the answer is known.
    """
    key = _cache_key(family, llvm_path)
    known = _read_cache()
    entry = known.get(key)
    if not fresh and isinstance(entry, dict) and set(entry) == {"backend_version", "error"}:
        return Attempt(family, llvm_path, str(entry["backend_version"]), str(entry["error"]))
    attempt = _run_probe(family, llvm_path)
    known[key] = {"backend_version": attempt.backend_version, "error": attempt.error}
    _write_cache(known)
    return attempt


def attempts(family: str, *, fresh: bool = False) -> list[Attempt]:
    """Return the probes of a family up to and including the first that works."""
    tried: list[Attempt] = []
    for path in llvm_candidates() if family == "llvm" else [""]:
        tried.append(probe(family, path, fresh=fresh))
        if tried[-1].works:
            break
    return tried


def _failure(family: str, tried: list[Attempt]) -> str:
    """Return in one line why a family does not work and what to do."""
    if family == "llvm":
        what = "; ".join(f"{Path(a.llvm_path).name}: {a.error}" for a in tried) or "no libLLVM found"
        return f"{what}; {LLVM_HELP}"
    if family == "cuda":
        return f"{tried[0].error}; it needs an NVIDIA GPU with a current driver"
    return f"{tried[0].error}; reinstall the packages mitsuba and drjit"


def find(variant: str = "auto", *, fresh: bool = False) -> VariantInfo:
    """Return a working variant without making it the current one.

    ``auto`` takes llvm, else scalar with a note. CUDA is taken only when asked for, so that the same scene gives the
    same bytes on machines with and without a GPU.

    Raises
    ------
    InputError
        If the variant is unknown, or was asked for by name and does not work here.
    """
    if variant not in CHOICES:
        raise InputError(f"'{variant}'", key="--variant", allowed=", ".join(CHOICES))
    families = ("llvm", "scalar") if variant == "auto" else (variant,)
    note = ""
    for family in families:
        tried = attempts(family, fresh=fresh)
        if tried and tried[-1].works:
            good = tried[-1]
            return VariantInfo(family, FAMILIES[family], good.backend_version, good.llvm_path, note)
        note = f"{family} does not work here ({_failure(family, tried)})"
        if family != families[-1]:
            note += "; using scalar, about ten times slower"
    raise InputError(note, key="--variant", allowed="auto, or a variant that 'evanesce doctor' finds working")


def _loaded_llvm() -> str:
    """Return the version of the libLLVM that this process's Dr.Jit has loaded; empty before Dr.Jit is imported."""
    drjit = sys.modules.get("drjit")
    if drjit is None:
        return ""
    version: tuple[int, ...] = drjit.detail.llvm_version()
    return "LLVM " + ".".join(map(str, version)) if min(version) >= 0 else "no LLVM"


def select(variant: str = "auto") -> VariantInfo:
    """Find a working variant, make it Mitsuba's current one and return its record.

    Dr.Jit loads its LLVM when it is imported, and keeps it. Where it was imported before, with another LLVM than the
    one that works, ``auto`` takes scalar with a note.

    Raises
    ------
    InputError
        See :func:`find`.
    """
    info = find(variant)
    if info.family == "llvm" and (loaded := _loaded_llvm()) not in ("", f"LLVM {info.backend_version}"):
        why = (
            f"Dr.Jit was imported before evanesce chose {Path(info.llvm_path).name} and has loaded {loaded}; import "
            "mitsuba and drjit after the first rendering, or set DRJIT_LIBLLVM_PATH"
        )
        if variant != "auto":
            raise InputError(why, key="--variant", allowed="auto, scalar")
        info = replace(find("scalar"), note=f"{why}; using scalar, about ten times slower")
    if info.llvm_path:
        os.environ["DRJIT_LIBLLVM_PATH"] = info.llvm_path  # Dr.Jit reads it when it is imported
    import mitsuba as mi

    if mi.variant() != info.name:
        mi.set_variant(info.name)
    return info
