"""The workflow on small scenes: settings, runs, interruptions and comparisons."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import yaml
from tests.rigs.known_matrix import contents
from tests.services.waiting import PATIENCE_SECONDS, wait_until
from tests.workflow.starter import SNAKEMAKE, run_snakemake

ROOT = Path(__file__).parents[2]

CONFIG: dict[str, Any] = {
    "scenes": {
        "tiny": {"kind": "wedge", "surfaces": ["white", "texture"], "shape": [8, 8]},
        "long": {"kind": "wedge", "surfaces": ["white", "texture"], "shape": [5, 8]},
    },
    "methods": {"symmetric": {}, "dual": {}, "brute_force": {}},
    # one pattern at a time, so that a capture can be stopped anywhere
    "capture": {"batch_patterns": 1, "all_off_brackets": 4, "all_on_brackets": 4},
    # jobs of single stages, as for larger scenes
    "resources": {"jobs": "stage"},
}
"""`tiny` has 5 stages on each of its levels; `long` by brute force captures 40 patterns."""

TINY = "results/tiny/symmetric/transport.json"
DUAL = "results/tiny/dual/transport.json"
LONG = "results/long/brute_force/transport.json"

GLASS = {"kind": "frosted_glass.py:FrostedGlass", "shape": [6, 8], "channels": 1, "blur": 0.7}
OWN_METHODS = {
    "wide": {"method": "column_scan.py:ColumnScan", "width": 2},
    "module": {"method": "column_scan:ColumnScan"},
}

STAGES = ("schedule", "capture", "merge", "normalize", "refine")

_RUN_SECONDS = 4 * PATIENCE_SECONDS


class Workflow:
    """The workflow in a separate folder, with the folder's settings or, by default, CONFIG."""

    def __init__(self, folder: Path, config: dict[str, Any] | None = None) -> None:
        self.folder = folder
        self.config = folder / "config.yaml"
        self.source: Path | None = None  # source of an rfpipe other than the installed one
        folder.mkdir(parents=True, exist_ok=True)
        if config is not None or not self.config.exists():
            self.configure(**(config or {}))

    def configure(self, **changes: Any) -> None:
        """Write the settings: CONFIG with groups updated, and with scenes and methods replaced."""
        settings = dict(CONFIG)
        for name, value in changes.items():
            is_whole = name in ("scenes", "methods") or not isinstance(value, dict)
            settings[name] = value if is_whole else {**settings.get(name, {}), **value}
        self.config.write_text(yaml.safe_dump(settings))

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start Snakemake as the leader of a new process group."""
        return subprocess.Popen(
            [str(SNAKEMAKE), *self._options(), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=self.folder,
            env={**os.environ, **({"PYTHONPATH": str(self.source)} if self.source else {})},
            start_new_session=True,
        )

    def run(self, *arguments: str, succeeds: bool = True) -> str:
        """Run Snakemake to its end and return its output."""
        if self.source:  # the starter has loaded another rfpipe
            return self.end(self.start(*arguments), succeeds=succeeds)
        status, output = run_snakemake([*self._options(), *arguments], self.folder, _RUN_SECONDS)
        assert (status == 0) == succeeds, output
        return output

    def _options(self) -> tuple[str, ...]:
        of_folder = ("--snakefile", str(ROOT / "Snakefile"), "--directory", str(self.folder))
        return (*of_folder, "--configfile", str(self.config), "--cores", "2")

    def unlock(self) -> None:
        """Remove the locks, like ``snakemake --unlock`` but faster."""
        for lock in (self.folder / ".snakemake" / "locks").iterdir():
            lock.unlink()

    def end(self, process: subprocess.Popen[str], *, succeeds: bool = True) -> str:
        """Wait for Snakemake and check its exit status."""
        output, _ = process.communicate(timeout=_RUN_SECONDS)
        assert (process.returncode == 0) == succeeds, output
        return output

    def path(self, name: str) -> Path:
        return self.folder / "results" / name

    def contents(self, name: str) -> dict[str, bytes]:
        """Bytes of an acquisition's manifests, stores and journals."""
        files, excluded = contents(self.path(name)), (".log", "benchmark.tsv")
        return {name: files[name] for name in sorted(files) if not name.endswith(excluded)}

    def copy_to(self, folder: Path) -> Workflow:
        """Copy the run with Snakemake's records and the times of all files."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return Workflow(folder)


def journal(store: Path) -> list[str]:
    """Lines of a store's journal; an empty list without a journal."""
    try:
        return (store / "journal.jsonl").read_text().splitlines()
    except FileNotFoundError:
        return []


def freeze_writer(store: Path, items: int) -> int:
    """Stop the process that writes a store (SIGSTOP) after `items` items; return its number."""
    lock = store.with_name(f".{store.name}.lock")

    def writer() -> int | None:
        if len(journal(store)) < items:
            return None
        return int(lock.read_text().split()[0])

    process = int(wait_until(writer, f"{items} items in {store}"))
    os.kill(process, signal.SIGSTOP)
    return process


def kill_group(process: subprocess.Popen[str], number: int) -> None:
    """Send a signal to Snakemake and all its jobs, as Ctrl-C in a terminal does."""
    os.killpg(process.pid, number)


def undo(workflow: Workflow, level: int, stage: str) -> Path:
    """Remove a stage of a level of `tiny` and all later ones; return the path of its log."""
    folder = workflow.path("tiny/symmetric")
    for name in STAGES[STAGES.index(stage) :]:
        for path in folder.glob(f"L{level:02d}/{name}.*"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    (folder / "transport.json").unlink(missing_ok=True)
    return folder / f"L{level:02d}" / f"{stage}.log"
