"""Fingerprints, versions and seeded generators."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rfpipe.config import Config
from rfpipe.errors import InputError
from rfpipe.provenance import code_fingerprint, fingerprint, generator, versions

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
