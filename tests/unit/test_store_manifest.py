"""Manifests: canonical bytes, atomic writes, detection of damage."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store import read_manifest, write_manifest

DATA: dict[str, Any] = {"digest": "00ff", "shape": [3, 4], "units": {"frames": "count"}, "ü": 0.1}


def test_a_manifest_is_read_as_written_and_has_reproducible_bytes(tmp_path: Path) -> None:
    write_manifest(tmp_path / "new" / "a.json", DATA)
    write_manifest(tmp_path / "b.json", dict(reversed(DATA.items())) | {"shape": (3, 4)})
    assert read_manifest(tmp_path / "new" / "a.json") == DATA
    content = (tmp_path / "b.json").read_bytes()
    assert content == (tmp_path / "new" / "a.json").read_bytes()
    assert content.endswith(b"}\n")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.json"]


def test_manifests_and_locks_do_not_import_zarr(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from rfpipe.store import *\n"
        "path = Path(sys.argv[1])\n"
        "with StoreLock(path): write_manifest(path, {'a': 1})\n"
        "print(read_manifest(path), 'zarr' in sys.modules)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.json")]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout == "{'a': 1} False\n"


def test_damage_is_found(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_manifest(path, DATA)
    original = path.read_bytes()
    for content in (
        *(original[:-4], b"", b"\xff\xfe", b"[1]\n", b"{}\n"),
        *(original.replace(b"00ff", b"01ff"), original.replace(b"0.1", b"NaN")),
    ):
        path.write_bytes(content)
        with pytest.raises(IntegrityError, match=r"damaged or altered.*remove it and run the"):
            read_manifest(path)


def test_data_that_json_cannot_represent_are_refused(tmp_path: Path) -> None:
    for data in ({"a": float("nan")}, {"a": {1, 2}}, {"checksum": "mine"}):
        with pytest.raises(InputError, match=r"a\.json"):
            write_manifest(tmp_path / "a.json", data)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_keeps_the_previous_manifest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    write_manifest(path, DATA)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"No space left on device.*bytes free.*make room"):
        write_manifest(path, {"other": 1})
    assert read_manifest(path) == DATA
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
