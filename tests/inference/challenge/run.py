"""Run cases through the critic: ``python -m tests.inference.challenge.run --set dev --workers 2 --budget 3600``.

Each case is made, judged and deleted; its outcome is a line of ``outputs/challenge/<run>.jsonl``. A run that is started
again goes on where it stopped. Nothing is ever overwritten: another critic, another ``--run``.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from evanesce.bundle import read_bundle
from evanesce.sensor.codec import write_png

from .baselines import BASELINES
from .cases import CaseSpec, cases
from .isolable import table
from .make import write_case
from .report import markdown
from .rig import CACHE
from .score import said
from .strength import OutOfReach


class MixedRun(Exception):
    """A run goes on by the code that began it, so that one critic is judged."""


CRITIC = "evanesce.inference.critic:criticise_frames"
GROSS = "another rig"
Judge = Callable[..., dict[str, Any]]


def judge_of(name: str) -> Judge:
    """Return a baseline by name, or a function ``module:function`` called as ``judge(path, exclude=())``."""
    if name in BASELINES:
        return BASELINES[name]
    module, _, function = name.partition(":")
    found = getattr(importlib.import_module(module), function)
    parameters = inspect.signature(found).parameters
    wants_bundle = "Bundle" in str(next(iter(parameters.values())).annotation)

    def judge(path: Path, exclude: tuple[str, ...] = ()) -> dict[str, Any]:
        if exclude and "exclude" not in parameters:
            raise OutOfReach(f"{function} cannot leave members out of its library")
        options = {"exclude": exclude} if exclude else {}
        try:
            answer = found(read_bundle(path) if wants_bundle else path, **options)
        except Exception as error:
            if not hasattr(error, "as_dict"):
                raise
            return {"verdict": GROSS, **error.as_dict()}  # another rig was measured, it says
        return dict(answer.result if hasattr(answer, "result") else answer)

    return judge


def one_case(
    spec: CaseSpec, judge: str, strip: str = "", keep: Path | None = None, beside: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Make, judge and delete one case.

    Parameters
    ----------
    spec : CaseSpec
    judge : str
    strip : {"", "shuffle", "flat"}
        Take the pixels' information away: every frame's pixels in another order, or all at their mean.
    keep : Path, optional
        Folder in which the bundle is left.
    beside : tuple of str
        Other judges of the same bundle, baselines for example; their answers stand under ``beside``.
    """
    with tempfile.TemporaryDirectory(prefix="challenge-") as folder:
        try:
            path, truth = write_case(spec, keep or Path(folder))
        except OutOfReach as error:
            return {"truth": spec.as_dict(), "skipped": str(error)}
        if strip:
            strip_pixels(path, strip)
        start, busy = time.perf_counter(), time.process_time()
        try:
            answer = judge_of(judge)(path, exclude=spec.exclude)
        except OutOfReach as error:
            return {"truth": spec.as_dict(), "skipped": str(error)}
        except Exception as error:  # a critic that breaks has failed this case, not the run
            return {"truth": truth, "error": f"{type(error).__name__}: {error}", "load": os.getloadavg()[0]}
        seconds, busy = time.perf_counter() - start, time.process_time() - busy
        found = {
            "truth": truth, "answer": _plain(answer), "seconds": seconds, "processor_s": busy,
            "load": os.getloadavg()[0],
        }  # fmt: skip
        return found | {"beside": {name: _plain(judge_of(name)(path)) for name in beside}} if beside else found


def strip_pixels(path: Path, how: str) -> None:
    """Take away what the frames of a bundle show: ``shuffle`` pixels, or make each frame ``flat``."""
    shape = read_bundle(path, decode=False).shape
    order = np.random.default_rng(0).permutation(shape[0] * shape[1])
    for file in sorted(path.rglob("*.png")):
        frame = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if how == "shuffle":
            write_png(file, frame.ravel()[order].reshape(shape))
        else:
            write_png(file, np.full(shape, round(float(frame.mean())), np.uint8))


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v)))


def commit() -> str:
    """Return the commit that is judged, with a mark where the tree differs from it."""
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        dirty = subprocess.run(["git", "status", "--porcelain", "-uno"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head + ("+changes" if dirty.stdout.strip() else "")


def read_records(path: Path) -> list[dict[str, Any]]:
    """Return the outcomes of a run; a last line that was cut off is left out."""
    found = []
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                found.append(json.loads(line))
            except ValueError:
                continue
    return found


def specs_of(name: str) -> list[CaseSpec]:
    """Return the cases of ``dev`` or ``scored`` in an order that tells nothing."""
    return cases(name)


def run(
    name: str, out: Path, *, judge: str = CRITIC, workers: int = 2, budget_s: float = 1e9, limit: int = 0,
    groups: Iterable[str] = (), causes: Iterable[str] = (), strengths: Iterable[float] = (), noises: Iterable[str] = (),
    spent: Iterable[str] = (), strip: str = "", keep: Path | None = None, beside: tuple[str, ...] = (),
    show: Callable[[str], None] = print,
) -> list[dict[str, Any]]:  # fmt: skip
    """Run what is not done yet, within a budget, and return all outcomes.

    Parameters
    ----------
    name : str
        ``dev`` or ``scored``.
    out : Path
        JSONL; appended to.
    judge, budget_s, strip, keep, beside
    limit : int
        Cases judged at the most; 0 is all.
    workers : int
        Processes; 0 works in this one.
    groups : iterable of str
        Only these groups; all by default.
    causes, strengths, noises : iterable
        Only cases that hide one of these, one as strong as that, or that have such noise; all by default.
    spent : iterable of str
        Cases left out, by id: those whose outcome somebody has looked at before the critic was frozen.
    show : callable

    Raises
    ------
    MixedRun
        Where a scored run was begun by other code.
    """
    wanted = [(set(groups), lambda s: {s.group}), (set(causes), lambda s: set(s.causes))]
    wanted += [(set(strengths), lambda s: set(s.strengths)), (set(noises), lambda s: {s.noise})]
    specs = [spec for spec in specs_of(name) if all(not chosen or chosen & of(spec) for chosen, of in wanted)]
    done = {record["truth"]["id"] for record in read_records(out) if "error" not in record} | set(spent)
    todo = [spec for spec in specs if spec.id not in done][: limit or None]
    out.parent.mkdir(parents=True, exist_ok=True)
    start, origin = time.monotonic(), commit()
    begun = {record["commit"] for record in read_records(out) if "commit" in record}
    if name == "scored" and begun - {origin}:
        raise MixedRun(
            f"{out} was begun by the code of {', '.join(sorted(begun))}, this is {origin}: name another --run"
        )
    finished = 0

    def put(record: dict[str, Any], stream: TextIO) -> None:
        nonlocal finished
        stream.write(json.dumps(record | {"judge": judge, "commit": origin, "strip": strip}) + "\n")
        stream.flush()
        os.fsync(stream.fileno())
        finished += 1
        left = (time.monotonic() - start) / finished * (len(todo) - finished)
        truth = record["truth"]
        told = said(record) if "answer" in record else record.get("skipped") or record.get("error")
        hidden = "+".join(truth["causes"]) or "nothing"
        show(f"{finished}/{len(todo)}  {truth['group']} {hidden}: {told}, {record.get('seconds', 0):.0f} s; "
             f"about {left / 60:.0f} min left")  # fmt: skip

    cut = out.is_file() and not out.read_bytes().endswith(b"\n")  # the last run was killed while it wrote
    with out.open("a", encoding="utf-8") as stream:
        stream.write("\n" if cut else "")
        for record in _results(todo, (judge, strip, keep, beside), workers, start + budget_s):
            put(record, stream)
    return read_records(out)


def _results(
    todo: list[CaseSpec], options: tuple[str, str, Path | None], workers: int, deadline: float
) -> Iterator[dict[str, Any]]:
    """Yield outcomes as they come; none is begun after the deadline [s of the monotonic clock]."""
    if workers < 1:
        for spec in todo:
            if time.monotonic() >= deadline:
                return
            yield one_case(spec, *options)
        return
    fresh = multiprocessing.get_context("spawn")  # what has threads must not be forked
    if workers > 1:
        # One thread for each: linear algebra that takes all cores in every worker made a case six times as slow.
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
            os.environ.setdefault(name, "1")
    queue = iter(todo)
    waiting: set[Future[dict[str, Any]]] = set()
    with ProcessPoolExecutor(max_workers=workers, mp_context=fresh) as pool:
        while True:
            while len(waiting) < workers and time.monotonic() < deadline:
                spec = next(queue, None)
                if spec is None:
                    break
                waiting.add(pool.submit(one_case, spec, *options))
            if not waiting:
                return
            ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                yield future.result()


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.inference.challenge.run", description=__doc__)
    parser.add_argument("--set", choices=("dev", "scored"), default="dev")
    parser.add_argument("--judge", default=CRITIC, help=f"module:function, or {', '.join(BASELINES)}")
    parser.add_argument("--run", default="", help="name of the run; by default set and judge")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--budget", type=float, default=1e9, help="seconds after which no case is begun")
    parser.add_argument("--limit", type=int, default=0, help="cases judged at the most")
    parser.add_argument("--groups", nargs="*", default=())
    parser.add_argument("--causes", nargs="*", default=(), help="only cases that hide one of these")
    parser.add_argument("--strengths", nargs="*", type=float, default=(), help="only cases as strong as that")
    parser.add_argument("--noises", nargs="*", default=(), help="only cases behind such noise or codec")
    parser.add_argument("--spent", nargs="*", type=Path, default=(), help="earlier runs whose cases are left out")
    parser.add_argument("--strip", choices=("", "shuffle", "flat"), default="")
    parser.add_argument("--keep", type=Path, default=None, help="folder in which bundles are left")
    parser.add_argument(
        "--beside", nargs="*", choices=BASELINES, default=(), help="baselines asked about each bundle, too"
    )
    given = parser.parse_args(arguments)
    judge_name = "critic" if given.judge == CRITIC else given.judge.replace(":", "-")
    run_name = given.run or f"{given.set}-{judge_name}" + (f"-{given.strip}" if given.strip else "")
    out = CACHE / f"{run_name}.jsonl"
    spent = {record["truth"]["id"] for path in given.spent for record in read_records(path)}
    try:
        records = run(
            given.set, out, judge=given.judge, workers=given.workers, budget_s=given.budget, limit=given.limit,
            groups=given.groups, causes=given.causes, strengths=given.strengths, noises=given.noises, spent=spent,
            strip=given.strip, keep=given.keep, beside=tuple(given.beside),
            show=lambda text: print(text, file=sys.stderr, flush=True),
        )  # fmt: skip
    except MixedRun as error:
        print(error, file=sys.stderr)
        return 2
    latest = {record["truth"]["id"]: record for record in records}
    judged = [record for record in latest.values() if "skipped" not in record]
    # The table of what is isolable takes minutes to make: for a whole set, not for a look at some cases.
    whole = len(latest) >= len(specs_of(given.set)) // 2
    print(markdown(judged, table(given.set) if whole else None))
    print(f"out of reach: {len(latest) - len(judged)}")
    return 1 if any("error" in record for record in judged) else 0


if __name__ == "__main__":
    sys.exit(main())
