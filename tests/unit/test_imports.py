"""``import rfpipe`` loads few modules; public names load theirs on first access."""

import subprocess
import sys

import pytest

import rfpipe

HEAVY = ["zarr", "numba", "scipy", "pandas", "dask", "colour", "matplotlib", "OpenImageIO"]


def loaded_after(statement: str) -> set[str]:
    """Return the top-level packages that a new interpreter has loaded after a statement."""
    code = f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("modules", "unused"),
    [
        ("rfpipe", [*HEAVY, "numpy"]),
        ("rfpipe.config, rfpipe.provenance, rfpipe.cli", HEAVY),
        ("rfpipe.rigs, rfpipe.server", ["fastapi", "uvicorn", "httpx", "pypylon", "pygame"]),
    ],
)
def test_import_loads_few_modules(modules: str, unused: list[str]) -> None:
    assert loaded_after(f"import {modules}").isdisjoint({*unused, "matplotlib"})


def test_every_public_name_can_be_imported() -> None:
    assert rfpipe.__version__
    for name in rfpipe.__all__:
        assert getattr(rfpipe, name) is not None
        assert name in dir(rfpipe)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'rfpipe' has no attribute 'aquire'"):
        rfpipe.aquire  # noqa: B018
