"""Make a script's figures and tables: ``python -m figures SCRIPT FOLDER [--side 48 ...]``.

Writes ``{slug}.png``, ``{slug}.pdf`` of vectors and ``{slug}.csv`` into the folder and, last,
``{script}.json`` with their names, captions and costs; ``python -m figures index FOLDER`` makes the
page of all of them, and ``python -m figures check`` checks for LLVM.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
from dataclasses import asdict, fields
from difflib import SequenceMatcher
from importlib import import_module
from pathlib import Path

from figures.common import Picture, Size, Table
from figures.index import write_index
from rfpipe.errors import RfpipeError
from rfpipe.report.page import pdf_of
from rfpipe.store.files import write_atomically
from rfpipe.text import did_you_mean

SCRIPTS = tuple(
    sorted(
        path.stem
        for path in Path(__file__).parent.glob("*.py")
        if "\ndef items(" in path.read_text(encoding="utf-8")
    )
)
"""Modules of this folder that yield figures and tables."""


def main() -> None:
    """Run a script, or write the page."""
    parser = argparse.ArgumentParser(prog="python -m figures", description=__doc__)
    parser.add_argument("script", help=f"{', '.join(SCRIPTS)}, index, or check")
    parser.add_argument("folder", type=Path, nargs="?", default=Path())
    for field in fields(Size):
        kind = type(field.default)
        keywords = {"nargs": "+", "type": int} if kind is tuple else {"type": kind}
        parser.add_argument(f"--{field.name}", default=field.default, **keywords)
    given = vars(parser.parse_args())
    script, folder = given.pop("script"), given.pop("folder")
    if script not in (*SCRIPTS, "index", "check"):
        parser.error(unknown(script))
    if script == "check":
        _check()
    elif script == "index":
        write_index(folder)
    else:
        folder.mkdir(parents=True, exist_ok=True)
        run(script, folder, Size(**given))


def unknown(script: str) -> str:
    """Return the message for a script that isn't there: all names, the most similar first."""
    names = (*SCRIPTS, "index", "check")
    nearest = sorted(names, key=lambda name: -SequenceMatcher(None, script, name).ratio())
    remedy = f"{did_you_mean(script, names)} There are {', '.join(nearest)}".strip()
    return f"there is no script {script!r}; {remedy}"


def _check() -> None:
    """End with a line that says what to install where physically based scenes can't be traced."""
    from rfpipe.mitsuba.variant import missing_llvm

    missing = missing_llvm("make figures")
    if missing is not None:
        sys.exit(f"figures: {missing}")


def run(script: str, folder: Path, size: Size) -> None:
    """Write what a script yields, each file whole or not at all."""
    shown: list[dict[str, object]] = []
    costs = []
    for item in import_module(f"figures.{script}").items(size):
        if isinstance(item, Picture):
            image = io.BytesIO()
            item.figure.savefig(image, format="png", metadata={"Software": None})
            write_atomically(folder / f"{item.slug}.png", image.getvalue())
            write_atomically(folder / f"{item.slug}.pdf", pdf_of(item.figure))
            shown.append({"file": f"{item.slug}.png", "name": item.name, "thesis": item.thesis,
                          "caption": item.caption})  # fmt: skip
        elif isinstance(item, Table):
            text = item.rows.to_csv(index=False, float_format="%.6g")
            write_atomically(folder / f"{item.slug}.csv", text.encode())
            shown.append({"file": f"{item.slug}.csv", "name": item.name, "caption": item.caption})
        else:
            costs.append(asdict(item))
    contents = json.dumps({"shown": shown, "costs": costs}, indent=1)
    write_atomically(folder / f"{script}.json", contents.encode())


if __name__ == "__main__":
    try:
        main()
    except RfpipeError as error:
        sys.exit(f"figures: {error}")
