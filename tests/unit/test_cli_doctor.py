"""The command doctor: exit codes, JSON, advice."""

from __future__ import annotations

import json
import sys

import pytest
import typer
from typer.testing import CliRunner

from evanesce.cli import doctor
from evanesce.render.variant import Attempt


@pytest.fixture
def app():
    app = typer.Typer()
    doctor.register(app)
    app.callback()(lambda: None)
    return app


def _pretend(monkeypatch, working):
    def attempts(family, *, fresh=False):
        path = "/usr/lib/libLLVM-19.so" if family == "llvm" else ""
        return [Attempt(family, path, "19.1" if family == "llvm" else "", "" if family in working else "broken")]

    monkeypatch.setattr("evanesce.render.variant.attempts", attempts)


def test_a_healthy_machine(app, monkeypatch, tmp_path):
    _pretend(monkeypatch, {"llvm", "scalar"})
    result = CliRunner().invoke(app, ["doctor", "--json", str(tmp_path / "a.json"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "a.json").read_text())
    assert report == json.loads((tmp_path / "out" / "doctor.json").read_text())
    assert report["ok"]
    assert report["auto"] == "llvm_ad_mono"
    assert report["missing"] == []
    assert any("cuda_ad_mono" in note for note in report["notes"])
    assert "/usr/lib" not in json.dumps(report)
    assert "taken by --variant auto" in result.output


@pytest.mark.parametrize("source", ["package karellen-llvm-core 19.1.7", "system"])
def test_it_tells_where_the_library_comes_from(app, monkeypatch, tmp_path, source):
    _pretend(monkeypatch, {"llvm", "scalar"})
    monkeypatch.setattr("evanesce.render.variant.llvm_source", lambda path: source)
    result = CliRunner().invoke(app, ["doctor", "--json", str(tmp_path / "a.json")])
    (library,) = json.loads((tmp_path / "a.json").read_text())["variants"][0]["libraries"]
    assert library == {"library": "libLLVM-19.so", "from": source, "works": True, "version": "19.1", "error": ""}
    assert f"works, from {source}" in result.output


def test_extras_that_are_missing_are_no_fault(app, monkeypatch, tmp_path):
    _pretend(monkeypatch, {"llvm", "scalar"})
    for name in ("dask", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    result = CliRunner().invoke(app, ["doctor", "--json", str(tmp_path / "a.json")])
    assert result.exit_code == 0
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["extras"]["dataset"]["missing"] == "dask and distributed"
    assert report["extras"]["dataset"]["packages"].keys() == {"dask", "distributed"}
    (note,) = (n for n in report["notes"] if "extras" in n)
    assert "dataset" in note
    assert "evanesce[NAME]" in note


def test_without_llvm_it_still_works_and_says_how_to_get_it(app, monkeypatch, tmp_path):
    _pretend(monkeypatch, {"scalar"})
    result = CliRunner().invoke(app, ["doctor", "--json", str(tmp_path / "a.json")])
    assert result.exit_code == 0
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["auto"] == "scalar_rgb"
    assert any("libllvm19" in note for note in report["notes"])


def test_nothing_renders(app, monkeypatch, tmp_path):
    _pretend(monkeypatch, set())
    result = CliRunner().invoke(app, ["doctor", "--json", str(tmp_path / "a.json")])
    assert result.exit_code == 1
    report = json.loads((tmp_path / "a.json").read_text())
    assert not report["ok"]
    assert report["auto"] is None
    assert len(report["missing"]) == 2


def test_missing_package(app, monkeypatch):
    _pretend(monkeypatch, {"llvm", "scalar"})
    monkeypatch.setattr("evanesce.core.provenance.package_versions", lambda *_: {"av": "missing"})
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 1
    assert "make install" in result.output


def test_unwritable_json_is_bad_input(app, tmp_path):
    result = CliRunner().invoke(app, ["doctor", "--json", str(tmp_path / "absent" / "a.json")])
    assert result.exit_code == 2
