"""What ships beside the code: versions that agree, pinned packages, citation."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

from evanesce import __version__

ROOT = Path(__file__).resolve().parents[2]


def test_one_version_in_code_citation_and_changelog():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert str(citation["version"]) == __version__
    assert citation["authors"] == [{"name": "evanesce developers"}]
    assert {"cff-version", "message", "title", "license"} <= set(citation)
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert headings[0] == __version__
    assert headings == sorted(headings, key=lambda v: tuple(map(int, v.split("."))), reverse=True)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" not in project["project"], "the version stands in evanesce/core/version.py only"
    assert project["project"]["license"] == citation["license"]


def test_constraints_pin_versions_and_name_no_place():
    """A file with addresses of an index or of a disk works on one machine only."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [re.fullmatch(r"([A-Za-z0-9._-]+)==[0-9][A-Za-z0-9.+]*", line) for line in lines]
    assert all(pinned), [line for line, found in zip(lines, pinned, strict=True) if found is None]
    names = [found[1].lower().replace("_", "-") for found in pinned if found]
    assert len(set(names)) == len(names)


def test_every_required_package_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(text for name, texts in extras.items() if name != "torch" for text in texts)]
    names = {re.split(r"[<>=;\[ ]", text, maxsplit=1)[0].lower() for text in wanted} - {"evanesce"}
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").lower().replace("_", "-").splitlines()
    assert names <= {line.partition("==")[0] for line in lines}


def test_contracts_name_every_package_but_the_one_that_may():
    """The layers are exhaustive by themselves; the lists of what may not import a library are kept complete here."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    packages = {f"evanesce.{p.parent.name}" for p in (ROOT / "src" / "evanesce").glob("*/__init__.py")}
    named = {c["name"]: {".".join(m.split(".")[:2]) for m in c.get("source_modules", ())} for c in contracts}
    assert packages - named["Only render knows Mitsuba and Dr.Jit"] == {"evanesce.render"}
    assert packages - named["Only finite elements need the finite-element extra"] == {"evanesce.contact"}
    assert packages <= named["Only the adapters of the live page know the web framework"]
    (layers,) = (c for c in contracts if c["type"] == "layers")
    assert layers["exhaustive"]
    inside = {f"evanesce.{part.strip()}" for layer in layers["layers"] for part in layer.split("|")}
    assert inside == packages
