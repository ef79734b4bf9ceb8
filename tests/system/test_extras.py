"""Optional packages: what is missing is named in one line with the extra that brings it, and nothing else needs it."""

from __future__ import annotations

import importlib
import pickle
import re
import subprocess
import sys
import tomllib
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evanesce.cli.app import COMMANDS, app
from evanesce.contact.fem.felupe_adapter import Body
from evanesce.contact.fem.importer import read_foreign
from evanesce.contact.fem.material import rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize, finger_section
from evanesce.contact.fem.result import write_vtk
from evanesce.core.errors import InputError
from evanesce.core.extras import EXTRAS, PURPOSES, MissingExtraError, distribution_name, listed, missing, require
from evanesce.dataset.cluster import cluster_client
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.export import export
from evanesce.dataset.job import new_job, save_job
from evanesce.dataset.run import Engine, make, resume
from evanesce.design.search import read
from evanesce.design.sensitivity import indices, sample
from evanesce.rig import load_scene
from evanesce.studies.voltage.analysis import sensitivity
from evanesce.studies.voltage.study import run_study
from evanesce.studies.voltage.unknowns import Plan

ROOT = Path(__file__).resolve().parents[2]
OPTIONAL = sorted({name for modules in EXTRAS.values() for name in modules})


@pytest.fixture
def hide(monkeypatch: pytest.MonkeyPatch):
    """Give a function that makes packages as if they were not installed."""

    def hidden(*names: str) -> None:
        for name in names:
            monkeypatch.setitem(sys.modules, name, None)

    return hidden


# --- the helper -------------------------------------------------------------------------------------------------------


def test_the_message_names_what_for_which_packages_and_the_extra(hide):
    hide("h5py", "pandas")
    with pytest.raises(MissingExtraError) as caught:
        require("export", "an export")
    assert str(caught.value).startswith("an export needs h5py")
    assert str(caught.value).endswith("pip install 'evanesce[export]'")
    assert caught.value.extra == "export"
    assert "pandas" in missing(EXTRAS["export"])
    assert listed(["sklearn"]) == "scikit-learn"
    assert listed(["a", "b", "c"]) == "a, b and c"


def test_the_error_is_bad_input_and_an_import_error_and_survives_a_process_boundary():
    error = MissingExtraError("something needs torch", "torch")
    assert isinstance(error, InputError)
    assert isinstance(error, ImportError)
    assert error.exit_code == 2
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.extra) == (str(error), "torch")


def test_what_is_there_is_not_asked_for():
    require("dataset", "anything", "json", "pathlib")
    assert missing(("json", "pathlib")) == ()


def test_extras_are_those_of_the_project_file():
    """Every package of every extra is known to the helper, so that its absence can be reported."""
    data = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    def names(requirements: list[str]) -> set[str]:
        return {re.split(r"[<>=;\[ ]", text, maxsplit=1)[0] for text in requirements}

    optional = data["optional-dependencies"]
    for extra, modules in EXTRAS.items():
        assert names(optional[extra]) == {distribution_name(name) for name in modules}
    assert set(PURPOSES) == set(EXTRAS)
    assert set(optional) >= {*EXTRAS, "all", "dev"}
    (everything,) = (text for text in optional["all"])
    inside = set(everything.removeprefix("evanesce[").removesuffix("]").split(","))
    assert inside == set(EXTRAS) - {"fem", "torch", "rerun"}, "fem has GPL parts, the others are large: by name"
    assert "evanesce[all]" in optional["dev"]
    assert not names(data["dependencies"]) & {distribution_name(name) for name in OPTIONAL}


# --- without any extra ------------------------------------------------------------------------------------------------


ADAPTERS = {
    "torch", "export_hdf5", "export_lerobot", "export_parquet", "export_rrd", "export_mcap", "export_tiff", "grip",
    "layout", "page", "server", "widgets",
}  # fmt: skip
"""Modules that are for one optional library, and import it."""


def test_everything_but_the_adapters_imports_without_extras_and_every_command_has_help():
    hidden = [*OPTIONAL, "fastapi", "starlette", "uvicorn", "sqlalchemy"]
    script = f"""
import importlib, pkgutil, sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
import evanesce
from typer.testing import CliRunner
from evanesce.cli.app import COMMANDS, app
names = [m.name for m in pkgutil.walk_packages(evanesce.__path__, "evanesce.")]
done, failed = 0, set()
for name in names:
    if name.endswith("__main__"):
        continue
    try:
        importlib.import_module(name)
        done += 1
    except ModuleNotFoundError:
        failed.add(name.rpartition(".")[2])
for arguments in ([], *([c.replace("_", "-")] for c in COMMANDS)):
    shown = CliRunner().invoke(app, [*arguments, "--help"])
    assert shown.exit_code == 0, (arguments, shown.output)
print(done, *sorted(failed))
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    done, *failed = run.stdout.split()
    assert set(failed) == ADAPTERS
    assert int(done) > 200


@pytest.mark.parametrize(
    ("module", "hidden", "extra"), [("dataset.torch", "torch", "torch"), ("live.page", "nicegui", "page")]
)
def test_an_adapter_says_which_extra_it_needs(hide, monkeypatch, module, hidden, extra):
    hide(hidden)
    monkeypatch.delitem(sys.modules, f"evanesce.{module}", raising=False)
    for name in ("widgets", "layout", "server"):
        monkeypatch.delitem(sys.modules, f"evanesce.live.{name}", raising=False)
    with pytest.raises(MissingExtraError, match=rf"evanesce\[{extra}\]"):
        importlib.import_module(f"evanesce.{module}")


# --- commands ---------------------------------------------------------------------------------------------------------

MAKE = ["dataset", "make", "thesis_slide", "--n", "40", "--workers", "2", "--out", "{}/data"]
SEARCH = ["design", "same_cost", "--out", "{}/design"]
PRESS = ["fem", "press", "--no-cache", "--out", "{}/fem"]


@pytest.mark.parametrize(
    ("hidden", "extra", "arguments"),
    [
        ("dask", "dataset", MAKE),
        ("distributed", "dataset", MAKE),
        ("distributed", "dataset", ["dataset", "resume", "{}/begun", "--workers", "2"]),
        ("h5py", "export", ["dataset", "export", "{}/begun", "--to", "hdf5"]),
        ("pandas", "export", ["dataset", "export", "{}/begun", "--to", "lerobot"]),
        ("pyarrow", "export", ["dataset", "export", "{}/begun", "--to", "lerobot"]),
        ("pyarrow", "export", ["dataset", "export", "{}/begun", "--to", "parquet"]),
        ("optuna", "design", SEARCH),
        ("SALib", "design", SEARCH),
        ("dask", "design", [*SEARCH, "--workers", "2"]),
        ("distributed", "design", [*SEARCH, "--scheduler", "tcp://127.0.0.1:1"]),
        ("SALib", "design", ["study", "voltage", "thesis_ridged", "--out", "{}/voltage"]),
        ("nicegui", "page", ["serve", "thesis", "--port", "0"]),
        ("felupe", "fem", PRESS),
        ("meshio", "fem", [*PRESS, "--vtk"]),
        ("meshio", "fem", ["fem", "import", "{}/contact.vtu", "--out", "{}/fem"]),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value[:2]),
)
def test_a_command_without_its_package_ends_in_one_line(hide, tmp_path, hidden, extra, arguments):
    """Exit code 2, one line that names package and extra, and nothing computed or written."""
    (tmp_path / "contact.vtu").write_text("<VTKFile/>", encoding="utf-8")
    if "begun" in " ".join(arguments):
        job = new_job(load_scene("thesis_slide"), DatasetConfig(), frames=40, seed=1)
        (tmp_path / "begun").mkdir()
        save_job(tmp_path / "begun", job)
    before = sorted(tmp_path.rglob("*"))
    hide(hidden)
    done = CliRunner().invoke(app, [text.format(tmp_path) for text in arguments])
    assert done.exit_code == 2, done.output
    (line,) = done.stderr.strip().splitlines()
    assert line.endswith(f"pip install 'evanesce[{extra}]'")
    assert hidden in line
    left = [path for path in sorted(tmp_path.rglob("*")) if path not in before and path.name != "fem"]
    assert left == []


def test_every_command_that_needs_no_extra_is_one_of_the_rest():
    """A new command is put here or above."""
    core = {"demo", "render", "simulate", "bundle", "calibrate", "measure", "compare", "twin", "bench", "doctor",
            "criticise", "criticise_photo", "fit", "init", "scene"}  # fmt: skip
    with_extras = {"dataset", "design", "study", "serve", "fem"}
    assert core | with_extras == set(COMMANDS)


# --- functions --------------------------------------------------------------------------------------------------------


def test_functions_say_the_same(hide, tmp_path):
    hide(*set(OPTIONAL) - {"torch"})
    scene = load_scene("thesis_slide")
    job = new_job(scene, DatasetConfig(), frames=40, seed=1)
    shape, material = FingerShape(), rubber("silskin_0")
    calls = {
        "dataset": [
            lambda: make(tmp_path / "made", job, Engine(workers=2)),
            lambda: cluster_client(2, "").__enter__(),
        ],
        "export": [partial(export, tmp_path, tmp_path / "out", to) for to in ("hdf5", "lerobot", "parquet")],
        "design": [
            lambda: Plan(forces=(1.0,), voltages=(8.0, 9.0)).shares(),
            lambda: sensitivity(None, 1),
            lambda: sample((), {}, 1, 1),
            lambda: indices((), {}, None, None, 1),
            lambda: read(None, tmp_path),
            lambda: run_study(scene, (1.0,), (8.0, 9.0)),
        ],
        "fem": [
            lambda: Body(finger_section(shape, MeshSize(contact=1.0)), material),
            lambda: read_foreign(_empty(tmp_path / "a.vtu")),
            lambda: write_vtk(tmp_path / "b.vtu", None, 0),
        ],
    }
    for extra, functions in calls.items():
        for call in functions:
            with pytest.raises(MissingExtraError, match=rf"evanesce\[{extra}\]"):
                call()
    assert not (tmp_path / "made").exists()
    assert not (tmp_path / "out").exists()


def _empty(path: Path) -> Path:
    path.touch()
    return path


def test_a_data_set_in_one_process_needs_no_extra(hide, tmp_path):
    """What is refused is refused for its own reason, not for a package that one process does not need."""
    hide(*set(OPTIONAL) - {"torch"})
    (tmp_path / "other.txt").touch()
    job = new_job(load_scene("thesis_slide"), DatasetConfig(), frames=40, seed=1)
    with pytest.raises(InputError, match=r"holds other\.txt"):
        make(tmp_path, job, Engine(workers=0))
    with pytest.raises(InputError, match="dataset"):
        resume(tmp_path, Engine(workers=0))
