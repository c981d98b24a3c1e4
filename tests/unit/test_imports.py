"""``import rfpipe`` stays light, and its public names are found when asked for."""

import subprocess
import sys

import pytest

import rfpipe

HEAVY = ["zarr", "numba", "scipy", "pandas", "dask", "colour", "matplotlib", "OpenImageIO"]


def loaded_after(statement: str) -> set[str]:
    """Top-level packages that a fresh interpreter holds after a statement."""
    code = f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "statement",
    ["import rfpipe", "import rfpipe.config", "import rfpipe.provenance", "import rfpipe.cli"],
)
def test_import_is_light(statement: str) -> None:
    assert loaded_after(statement).isdisjoint(HEAVY)


def test_rigs_and_server_load_no_device_and_no_http_before_they_are_used() -> None:
    loaded = loaded_after("import rfpipe.rigs, rfpipe.server")
    assert loaded.isdisjoint({"fastapi", "uvicorn", "httpx", "pypylon", "pygame", "matplotlib"})


def test_import_of_rfpipe_alone_loads_not_even_numpy() -> None:
    assert "numpy" not in loaded_after("import rfpipe")


def test_a_small_merge_loads_no_compiler_and_no_colour_science() -> None:
    """Which is why it stands in NumPy beside the compiled kernel."""
    taken = "frame = np.full((1, len(camera.exposures), 4, 4), 900, np.uint16)"
    made = "import numpy as np; from rfpipe.photometry import CameraModel as Camera"
    merge = "camera = Camera(bayer='RGGB'); {}; camera.merge(frame, frame[0])"
    loaded = loaded_after(f"{made}; {merge.format(taken)}")
    assert loaded.isdisjoint({"numba", "colour", "colour_demosaicing"})


def test_every_public_name_is_found() -> None:
    assert rfpipe.__version__
    for name in rfpipe.__all__:
        assert getattr(rfpipe, name) is not None
        assert name in dir(rfpipe)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="'rfpipe' has no attribute 'aquire'"):
        rfpipe.aquire  # noqa: B018
