"""The viewer in headless Chromium: pictures a second while a light moves, and what each takes.

python -m benchmarks.viewer_speed PAGE.html ...   pages that `rfpipe view` wrote

Beside pictures a second, which depend on what else the machine does, the CPU time of the busiest
threads for a picture: the page's own and its workers'. The slowest of them bounds the pictures a
second of an idle machine.
"""

from __future__ import annotations

import csv
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import psutil

from benchmarks.harness import existing, given

SECONDS = 10


def threads(process: psutil.Process) -> dict[int, float]:
    return {thread.id: thread.user_time + thread.system_time for thread in process.threads()}


def renderer() -> psutil.Process:
    """The process that takes most CPU time among this one's children that render pages."""
    measurements = [
        child
        for child in psutil.Process().children(recursive=True)
        if "--type=renderer" in " ".join(child.cmdline())
    ]
    return max(measurements, key=lambda child: sum(child.cpu_times()[:2]))


def measure(chromium: Any, path: Path) -> dict[str, Any]:
    page = chromium.new_context(viewport={"width": 1280, "height": 900}).new_page()
    page.goto(path.resolve().as_uri(), wait_until="commit")
    while not page.evaluate("document.body && document.body.dataset.ready"):
        time.sleep(0.1)
    page_facts = page.evaluate("({...document.body.dataset, workers: engine.workers.length})")
    page.evaluate("startPlaying()")
    time.sleep(3)  # for the compilers
    first, process = page.evaluate("engine.id"), renderer()
    before, since = threads(process), time.perf_counter()
    time.sleep(SECONDS)
    pictures, seconds = page.evaluate("engine.id") - first, time.perf_counter() - since
    seconds_used = [spent - before.get(thread, 0) for thread, spent in threads(process).items()]
    busiest = sorted(seconds_used, reverse=True)[: 1 + page_facts["workers"]]
    page.context.close()
    return {
        "page": path.name,
        "megabytes": round(path.stat().st_size / 1e6, 1),
        "first_picture_seconds": round(int(page_facts["first"]) / 1000, 2),
        "all_levels_seconds": round(int(page_facts["ready"]) / 1000, 2),
        "pictures_a_second": round(pictures / seconds, 1),
        "cpu_ms_a_picture": " ".join(f"{1000 * spent / pictures:.1f}" for spent in busiest),
        "load_average": round(psutil.getloadavg()[0], 1),
    }


def main() -> None:
    from playwright.sync_api import sync_playwright

    pages, rows = list(given("page", existing)), []
    with sync_playwright() as driver:
        path = shutil.which("chromium")
        chromium = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        for page in pages:
            rows.append(measure(chromium, page))
            print(rows[-1], file=sys.stderr)
    if rows:
        folder = Path("results/bench")
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "viewer.csv").open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, rows[0])
            table.writeheader()
            table.writerows(rows)


if __name__ == "__main__":
    main()
