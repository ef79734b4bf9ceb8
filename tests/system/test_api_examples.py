"""The examples in the docstrings of the public names, run as they stand."""

from __future__ import annotations

import doctest
import inspect
from collections.abc import Iterator

import pytest

import evanesce as ev


def _examples() -> Iterator[doctest.DocTest]:
    """Yield the examples of every public function and class, and of the classes' own methods."""
    finder = doctest.DocTestFinder(recurse=False)
    for name in ev.__all__:
        found = getattr(ev, name)
        owners = {name: found}
        if inspect.isclass(found) and found.__module__.startswith("evanesce"):
            owners |= {f"{name}.{key}": value for key, value in vars(found).items() if callable(value) or
                       isinstance(value, classmethod)}  # fmt: skip
        for label, value in owners.items():
            value = value.__func__ if isinstance(value, classmethod) else value
            if inspect.isfunction(value) or inspect.isclass(value):
                yield from (test for test in finder.find(value, label, globs={}) if test.examples)


EXAMPLES = {test.name: test for test in _examples()}


def test_what_a_user_would_call_has_an_example() -> None:
    called = {"load", "solve_contact", "contact_sequence", "Camera", "measure", "Pipeline", "calibrate", "compare",
              "split_error", "make_dataset", "save_scene", "coarser", "criticise", "Scene.with_", "Truth"}  # fmt: skip
    assert called <= set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_prints_what_it_says(name: str) -> None:
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(EXAMPLES[name], out=report.append)
    assert runner.failures == 0, "".join(report)
    skipped = [example for example in EXAMPLES[name].examples if doctest.SKIP in example.options]
    assert runner.tries == len(EXAMPLES[name].examples) - len(skipped)
