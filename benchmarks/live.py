"""How many updates a second the live page makes: of the engine alone, and round trip in a browser.

``python benchmarks/live.py --json FILE``; needs the extra ``page``, and for the browser Playwright and a Chromium.
Each control is moved on its own, at half the resolution of the thesis's camera, which is what the page shows at first.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.live.controls import Controls, controls_of
from evanesce.live.engine import Engine
from evanesce.live.present import present
from evanesce.rig import load_scene

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
MOVES: dict[str, Callable[[Controls, int], Controls]] = {
    "threshold": lambda c, i: c.changed(threshold=0.05 + 0.005 * i),
    "minimum blob size": lambda c, i: c.changed(min_blob_px=500.0 + 50 * i),
    "profile line": lambda c, i: c.changed(line_mm=-2.0 + 0.05 * i),
    "LED voltage": lambda c, i: c.changed(voltage_V=8.0 + 0.05 * i),
    "one LED": lambda c, i: c.changed(led_power=tuple(0.02 * i if k == 3 else p for k, p in enumerate(c.led_power))),
    "force": lambda c, i: c.changed(force_N=0.5 + 0.05 * i),
    "ridge height": lambda c, i: c.changed(ridge_height_um=20.0 + i),
    "defocus": lambda c, i: c.changed(defocus_um=-150.0 + 5 * i),
    "material": lambda c, i: c.changed(material=f"silskin_{10 * (i % 3)}", force_N=1.0 + 0.01 * i),
}
SLIDERS = ("threshold", "voltage_V", "force_N", "ridge_height_um", "defocus_um")

DRIVE = """async ([name, seconds, every]) => {
  const slider = document.querySelector(`[data-knob="${name}"] input[type=range]`);
  const picture = document.querySelector('#picture-overlay img');
  const low = Number(slider.min), high = Number(slider.max), step = Number(slider.step);
  const start = Number(slider.value), drawn = [];
  const note = () => drawn.push(performance.now());
  picture.addEventListener('load', note);
  const began = performance.now();
  for (let i = 1; performance.now() - began < 1000 * seconds; i++) {
    // up and down by a fifth of the way, as a hand would
    const share = 0.1 * Math.abs((i % 80) - 40) / 40;
    const value = Math.min(high, Math.max(low, start + Math.round(share * (high - low) / step) * step));
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(slider, value);
    slider.dispatchEvent(new Event('input', {bubbles: true}));
    await new Promise(done => setTimeout(done, every));
  }
  picture.removeEventListener('load', note);
  return drawn;
}"""

ONCE = """([name, value]) => new Promise(done => {
  const slider = document.querySelector(`[data-knob="${name}"] input[type=range]`);
  const picture = document.querySelector('#picture-overlay img');
  const began = performance.now();
  picture.addEventListener('load', () => requestAnimationFrame(() => done(performance.now() - began)), {once: true});
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(slider, value);
  slider.dispatchEvent(new Event('input', {bubbles: true}));
})"""


def server_part(name: str, repeats: int) -> dict[str, Any]:
    """Time what the server does for one update: scene, contact, frame, measurement, pictures, charts."""
    engine = Engine(load_scene(name))
    start = engine.prepare().controls
    rows = {}
    for control, move in MOVES.items():
        for i in range(3):  # the first few meet kernels and maps that are not there yet
            engine.show(move(start, repeats + i))
        walls, cpus, parts = [], [], {}
        for i in range(repeats):
            wall, cpu = time.perf_counter(), time.process_time()
            shown = engine.show(move(start, i))
            before = time.perf_counter()
            present(shown)
            shown.seconds["pictures"] = time.perf_counter() - before
            walls.append(time.perf_counter() - wall)
            cpus.append(time.process_time() - cpu)
            for part, seconds in shown.seconds.items():
                parts.setdefault(part, []).append(seconds)
        quiet = float(np.convolve(walls, np.ones(10) / 10, mode="valid").min())
        rows[control] = {
            "best_ms": 1e3 * min(walls),
            "quietest_ten_ms": 1e3 * quiet,
            "median_ms": 1e3 * float(np.median(walls)),
            "processor_ms": 1e3 * float(np.median(cpus)),
            "parts_ms": {part: 1e3 * float(np.median(seconds)) for part, seconds in parts.items()},
        }
        r = rows[control]
        print(f"{control:14s} best {r['best_ms']:6.1f}  quietest ten {r['quietest_ten_ms']:6.1f}  "
              f"median {r['median_ms']:6.1f}  processor {r['processor_ms']:6.1f} ms  "
              + " ".join(f"{k} {v:.1f}" for k, v in r["parts_ms"].items()))  # fmt: skip
    return rows


@contextmanager
def served(name: str) -> Iterator[str]:
    """Serve a scene; yield its address."""
    server = subprocess.Popen([sys.executable, "-m", "evanesce.cli", "serve", name, "--port", "0"],
                              stdout=subprocess.PIPE, text=True)  # fmt: skip
    try:
        assert server.stdout is not None
        found = re.match(r"(http://\S+)", server.stdout.readline())
        assert found is not None
        yield found[1]
    finally:
        server.terminate()
        server.wait()


def processor_s() -> dict[str, float]:
    """Return the processor time so far of the page's renderer, the rest of the browser, and the server [s] (Linux)."""
    parents: dict[int, list[tuple[int, float]]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            fields = stat.read_text().rsplit(")", 1)[1].split()
            ticks = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
            parents.setdefault(int(fields[1]), []).append((int(stat.parent.name), ticks))
    found = {"renderer": 0.0, "browser": 0.0, "server": 0.0}
    below = list(parents.get(os.getpid(), []))
    while below:
        process, ticks = below.pop()
        below += parents.get(process, [])
        with suppress(OSError):
            words = Path(f"/proc/{process}/cmdline").read_text()
            kind = "renderer" if "--type=renderer" in words else "server" if "evanesce.cli" in words else "browser"
            found[kind] += ticks
    return found


def browser_part(name: str, seconds: float) -> dict[str, Any]:
    """Move sliders in a browser; count the pictures that it has drawn, and time single moves."""
    from playwright.sync_api import sync_playwright

    chromium = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
    if chromium is None:
        raise SystemExit("no Chromium is installed")
    rows = {}
    with served(name) as address, sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(address)
        page.wait_for_selector("#figure-area_mm2", timeout=120_000)
        for slider in SLIDERS:
            handle = page.locator(f'[data-knob="{slider}"] input[type="range"]')
            low, high, step = (float(handle.get_attribute(k)) for k in ("min", "max", "step"))
            at = float(handle.input_value())
            page.evaluate(DRIVE, [slider, 2.0, 25])  # warm
            before = processor_s()
            drawn = np.array(page.evaluate(DRIVE, [slider, seconds, 25])) / 1e3
            processor_ms = {kind: 1e3 * (t - before[kind]) / drawn.size for kind, t in processor_s().items()}
            time.sleep(1.0)
            trips = []
            for i in range(12):
                value = (
                    min(high, at + step * (3 + i % 7)) if at + step * 10 < high else max(low, at - step * (3 + i % 7))
                )
                trips.append(page.evaluate(ONCE, [slider, value]))
                time.sleep(0.15)
            # the best second and the mean over all
            rate = (drawn.size - 1) / (drawn[-1] - drawn[0])
            per_second = [int(((drawn >= t) & (drawn < t + 1)).sum()) for t in drawn[drawn <= drawn[-1] - 1]]
            rows[slider] = {
                "updates_per_s": float(rate),
                "best_second": max(per_second, default=0),
                "worst_second": min(per_second, default=0),
                "round_trip_best_ms": float(min(trips)),
                "round_trip_median_ms": float(np.median(trips)),
                "processor_ms": processor_ms,
            }
            r = rows[slider]
            print(f"{slider:16s} {r['updates_per_s']:5.1f} updates/s (best second {r['best_second']}, worst "
                  f"{r['worst_second']}), round trip best {r['round_trip_best_ms']:.0f}, median "
                  f"{r['round_trip_median_ms']:.0f} ms; processor "
                  + ", ".join(f"{kind} {ms:.0f} ms" for kind, ms in processor_ms.items()))  # fmt: skip
            page.get_by_role("button", name="Reset").click()
            time.sleep(0.5)
        browser.close()
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="thesis_ridged")
    parser.add_argument("--part", choices=("server", "browser", "both"), default="both")
    parser.add_argument("--repeats", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    result: dict[str, Any] = {"scene": arguments.scene, "cores": os.cpu_count(), "load_before": os.getloadavg()}
    assert controls_of(load_scene(arguments.scene)).coarser == 2
    if arguments.part in ("server", "both"):
        result["server"] = server_part(arguments.scene, arguments.repeats)
    if arguments.part in ("browser", "both"):
        result["browser"] = browser_part(arguments.scene, arguments.seconds)
    result["load_after"] = os.getloadavg()
    print("load", result["load_before"], result["load_after"])
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(result, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
