"""Fingerprints, versions and seeded generators."""

import re
from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import settings_of_a_plane

from rfpipe import provenance
from rfpipe.errors import InputError
from rfpipe.provenance import code_digest, fingerprint, generator, versions


def test_fingerprint_is_the_same_in_every_process() -> None:
    # a changed value would make all stored captures stale
    assert fingerprint({"b": [1, 2.5], "a": None}) == fingerprint({"a": None, "b": (1, 2.5)})
    run = settings_of_a_plane()
    assert fingerprint(run) == fingerprint(run.model_dump(mode="json"))
    assert fingerprint({"seed": 1, "name": "wedge"}) == "f0ed6bcc7ce98fbfac204f1292f64376"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (1, 1.0),
        (1, True),
        ("1", 1),
        (np.zeros(4, np.float32), np.zeros(4, np.float64)),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (np.zeros(3), np.array([0.0, 0.0, 1e-9])),
    ],
)
def test_fingerprints_of_different_values_differ(first: object, second: object) -> None:
    assert fingerprint({"value": first}) != fingerprint({"value": second})


def test_fingerprint_of_an_array_depends_on_its_values() -> None:
    image = np.arange(12.0).reshape(3, 4)
    assert fingerprint(image[:, ::2]) == fingerprint(image[:, ::2].copy())
    assert fingerprint(np.float64(2.5)) == fingerprint(2.5)


@pytest.mark.parametrize("value", [float("nan"), np.array([None]), {"a": {1, 2}}])
def test_values_without_stable_bytes_are_refused(value: object) -> None:
    with pytest.raises(InputError, match="fingerprint: "):
        fingerprint(value)


SOURCE = """\
import math

LIMITS = frozenset({"a", "b", "c"})


class Shape:
    '''A square.'''

    side = 2

    def area(self, scale=1.0):
        return scale * self.side**2


def kept(name):
    '''Return some.'''
    return [each for each in LIMITS if each != name]
"""


def digest_of(folder: Path, source: str, name: str = "mine.py") -> str:
    path = folder / fingerprint(source) / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(source)
    return code_digest(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("import math", "# a comment\nimport math"),
        ("A square.", "A figure.\n\n    It has sides."),
        ("Return some.", "Return those that stay."),
        ("import math\n", "import math\n\n\n\n"),
        ("[each for each in LIMITS if", "[\n        each for each in LIMITS\n        if"),
    ],
    ids=["comment", "docstring of a class", "of a function", "lines", "layout"],
)  # fmt: skip
def test_changes_without_effect_keep_the_digest(tmp_path: Path, old: str, new: str) -> None:
    assert old in SOURCE
    assert digest_of(tmp_path, SOURCE.replace(old, new)) == digest_of(tmp_path, SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"c"', '"d"'),
        ("scale=1.0", "scale=2.0"),
        ("scale * self", "scale + self"),
        ("each != name", "each == name"),
    ],
)
def test_changes_with_effect_change_the_digest(tmp_path: Path, old: str, new: str) -> None:
    assert old in SOURCE
    assert digest_of(tmp_path, SOURCE.replace(old, new)) != digest_of(tmp_path, SOURCE)


def test_code_that_displays_results_only_counts_for_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def digests(name: str) -> tuple[str, str]:
        """Return digests, without and with pages, after a change of one module."""
        package = tmp_path / name.replace("/", "_")
        for file in ("methods/dual.py", "report/page.py", "jobs/job.py"):
            (package / file).parent.mkdir(parents=True, exist_ok=True)
            (package / file).write_text(f"x = {file == name}\n")
        monkeypatch.setattr(provenance, "_PACKAGE", package)
        code_digest.cache_clear()
        return code_digest(), code_digest(pages=True)

    before, of_pages = digests("none")
    assert digests("methods/dual.py")[0] != before
    for name in ("report/page.py", "jobs/job.py"):
        assert digests(name)[0] == before
        assert digests(name)[1] != of_pages
    code_digest.cache_clear()


@pytest.mark.parametrize("source", [None, "def\n"], ids=["absent", "no Python"])
def test_a_file_without_code_is_refused(tmp_path: Path, source: str | None) -> None:
    path = tmp_path / "mine.py"
    if source is not None:
        path.write_text(source)
    with pytest.raises(InputError, match=re.escape(str(path))):
        code_digest(path)


def test_versions_contain_the_packages_that_influence_results() -> None:
    recorded = versions()
    assert recorded["numpy"] == np.__version__
    assert {"python", "rfpipe", "zarr"} <= recorded.keys()
    assert list(recorded) == sorted(recorded)


def test_generator_depends_only_on_seed_and_key() -> None:
    keys = [(), (0,), (0, 0), (1,), (0, 1), (1, 0)]
    draws = {(seed, *key): generator(seed, *key).random(4) for seed in (0, 7) for key in keys}
    assert len({tuple(values) for values in draws.values()}) == len(draws)
    for key in reversed(list(draws)):
        np.testing.assert_array_equal(generator(*key).random(4), draws[key])
