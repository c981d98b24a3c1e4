"""Fingerprints, versions and seeded generators."""

import ast
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rfpipe
from rfpipe.config import Config
from rfpipe.errors import InputError
from rfpipe.provenance import (
    code_fingerprint,
    fingerprint,
    generator,
    import_fingerprint,
    imported_sources,
    versions,
)

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), PLAIN, max_size=4))
def test_fingerprint_ignores_the_order_of_keys(value: dict[str, object]) -> None:
    backwards = dict(reversed(value.items()))
    assert fingerprint(backwards) == fingerprint(value)


def test_fingerprint_is_the_same_in_every_process() -> None:
    # a changed value would make every stored capture look stale
    assert fingerprint({"b": [1, 2.5], "a": None}) == fingerprint({"a": None, "b": (1, 2.5)})
    assert fingerprint({"seed": 1, "name": "wedge"}) == "f0ed6bcc7ce98fbfac204f1292f64376"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (1, 1.0),
        (1, True),
        ("1", 1),
        ([], {}),
        (np.zeros(4, np.float32), np.zeros(4, np.float64)),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.zeros(3), np.array([0.0, 0.0, 1e-9])),
    ],
)
def test_fingerprint_tells_values_apart(first: object, second: object) -> None:
    assert fingerprint({"value": first}) != fingerprint({"value": second})


def test_fingerprint_of_an_array_is_that_of_its_values() -> None:
    image = np.arange(12.0).reshape(3, 4)
    assert fingerprint(image[:, ::2]) == fingerprint(image[:, ::2].copy())
    assert fingerprint(np.float64(2.5)) == fingerprint(2.5)


def test_fingerprint_of_settings_follows_their_values() -> None:
    assert fingerprint(Config()) == fingerprint(Config().model_dump(mode="json"))
    assert fingerprint(Config(seed=2)) != fingerprint(Config())


@pytest.mark.parametrize(
    "value", [float("nan"), {1: "a"}, {"a": object()}, np.array([None]), {"a": {1, 2}}]
)
def test_fingerprint_refuses_what_has_no_stable_bytes(value: object) -> None:
    with pytest.raises(InputError, match="fingerprint: "):
        fingerprint(value)


def test_code_fingerprint_follows_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "fingerprinted"
    (package / "inner").mkdir(parents=True)
    for name in ("__init__.py", "alone.py", "inner/__init__.py", "inner/deep.py"):
        (package / name).write_text("x = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    everything = code_fingerprint("fingerprinted")
    alone = code_fingerprint("fingerprinted.alone")
    pair = code_fingerprint("fingerprinted.inner", "fingerprinted.alone")
    assert len({everything, alone, pair}) == 3
    assert pair == code_fingerprint("fingerprinted.alone", "fingerprinted.inner")

    (package / "inner/deep.py").write_text("x = 2\n")
    assert code_fingerprint("fingerprinted") != everything
    assert code_fingerprint("fingerprinted.inner", "fingerprinted.alone") != pair
    assert code_fingerprint("fingerprinted.alone") == alone
    assert "fingerprinted" not in sys.modules


@pytest.mark.parametrize("name", ["rfpipe.absent", "no_such_package", "sys"])
def test_code_fingerprint_of_no_module(name: str) -> None:
    with pytest.raises(InputError, match=name):
        code_fingerprint(name)


SOURCES = {
    "__init__.py": "",
    "stage.py": """
        from __future__ import annotations
        import os, shapes.whole
        from typing import TYPE_CHECKING
        from shapes import (
            alone,  # with a comment (and more)
            NAME,
        )
        if TYPE_CHECKING:
            from shapes.typed import Typed

            import shapes.typed_too
        from .inner import near as nearby
        def work():
            from shapes.late import work
        if True:
            from shapes.registry import get
    """,
    "whole.py": "", "alone.py": "", "typed.py": "", "typed_too.py": "", "late.py": "import json",
    "unused.py": "",
    "inner/__init__.py": "from . import beside",
    "inner/near.py": "from ..far import away",
    "inner/beside.py": "",
    "far.py": "",
    "registry.py": """
        import importlib
        NAMES = {"one": "shapes.one", "other": ("shapes.other", "Class"), "none": "shapes.none"}
        def get(name):
            return importlib.import_module(NAMES[name])
    """,
    "one.py": "", "other.py": "",
}  # fmt: skip


@pytest.fixture
def shapes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in SOURCES.items():
        path = tmp_path / "shapes" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text))
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path / "shapes"


def test_imported_sources_are_all_that_a_module_reaches(shapes: Path) -> None:
    always = "alone far inner inner.beside inner.near late registry stage whole"
    reached = {"shapes", *(f"shapes.{name}" for name in always.split())}
    chosen = imported_sources("shapes.stage", "shapes.one", choosing=["shapes.registry"])
    assert set(chosen) == {*reached, "shapes.one"}
    assert set(imported_sources("shapes.stage")) == {*reached, "shapes.one", "shapes.other"}
    assert chosen["shapes.inner"] == shapes / "inner/__init__.py"
    without = imported_sources(
        "shapes.stage", choosing=["shapes.registry"], without=["shapes.inner.near"]
    )
    assert set(without) == reached - {"shapes.inner.near", "shapes.far"}
    assert "shapes" not in sys.modules


def test_a_package_left_out_is_left_out_with_all_it_contains(shapes: Path) -> None:
    assert shapes.is_dir()
    without = imported_sources("shapes.stage", without=["shapes.inner", "shapes.registry"])
    assert not {"shapes.inner", "shapes.inner.near", "shapes.far"} & set(without)


def test_import_fingerprint_follows_what_is_reached_alone(shapes: Path) -> None:
    before = import_fingerprint("shapes.stage")
    for name in ("unused.py", "typed.py", "typed_too.py"):
        (shapes / name).write_text("edited = True\n")
    assert import_fingerprint("shapes.stage") == before
    for name in ("late.py", "far.py", "inner/__init__.py", "other.py", "stage.py"):
        (shapes / name).write_text((shapes / name).read_text() + "# edited\n")
        assert import_fingerprint("shapes.stage") != before
        before = import_fingerprint("shapes.stage")


def test_a_file_of_the_users_own_counts_with_what_it_imports(shapes: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text("from rfpipe.errors import InputError\n")
    assert set(imported_sources(str(mine), choosing=["rfpipe"])) == {
        "mine.py",
        "rfpipe",
        "rfpipe.errors",
    }
    before = import_fingerprint("shapes.stage", str(mine))
    mine.write_text("from rfpipe.errors import StoreError\n")
    assert import_fingerprint("shapes.stage", str(mine)) != before


@pytest.mark.parametrize("name", ["rfpipe.absent", "no_such_package", "sys", "no/such/file.py"])
def test_imported_sources_of_no_module(name: str) -> None:
    with pytest.raises(InputError, match=name):
        imported_sources(name)


def test_imports_are_found_as_the_parser_finds_them() -> None:
    # reading lines takes a tenth of the time, and must find as much
    folder = Path(rfpipe.__file__).parent
    for path in folder.rglob("*.py"):
        name = ".".join(["rfpipe", *path.relative_to(folder).with_suffix("").parts])
        module = name.removesuffix(".__init__")
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {name for name in parsed_imports(tree) if name.startswith("rfpipe")}
        found = imported_sources(module, choosing=["rfpipe", module])
        assert {name for name in names if is_module(folder.parent, name)} <= set(found), path


def parsed_imports(node: ast.AST) -> Iterator[str]:
    """Absolute imports below a node, but for those behind TYPE_CHECKING; packages included."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    if isinstance(node, ast.Import):
        found = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        found = [f"{node.module}.{alias.name}" for alias in node.names]
    else:
        found = []
    for name in found:
        yield from (name.rsplit(".", i)[0] for i in range(name.count(".") + 1))
    for child in ast.iter_child_nodes(node):
        yield from parsed_imports(child)


def is_module(folder: Path, name: str) -> bool:
    place = folder.joinpath(*name.split("."))
    return place.with_suffix(".py").exists() or (place / "__init__.py").exists()


def test_versions_name_what_shapes_a_result() -> None:
    found = versions()
    assert found["numpy"] == np.__version__
    assert {"python", "rfpipe", "zarr"} <= found.keys()
    assert list(found) == sorted(found)


def test_generator_depends_on_seed_and_key_alone() -> None:
    keys = [(), (0,), (0, 0), (1,), (0, 1), (1, 0)]
    draws = {(seed, *key): generator(seed, *key).random(4) for seed in (0, 7) for key in keys}
    assert len({tuple(values) for values in draws.values()}) == len(draws)
    for key in reversed(list(draws)):
        np.testing.assert_array_equal(generator(*key).random(4), draws[key])


@pytest.mark.parametrize(("seed", "key"), [(-1, ()), (0, (-1,)), (0, (2**32,))])
def test_generator_refuses_what_would_collide(seed: int, key: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="expected"):
        generator(seed, *key)
