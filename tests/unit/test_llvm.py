"""Which LLVM is found for Mitsuba, and what is said where there is none."""

from pathlib import Path

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe_mitsuba import variant
from rfpipe_mitsuba.kind import Mitsuba, MitsubaOptions


def test_the_newest_that_mitsuba_can_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "libLLVM-15.so.1").touch()
    monkeypatch.setattr(variant, "_PLACES", (f"{tmp_path}/libLLVM*",))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    assert variant.usable_llvm() is None
    (tmp_path / "libLLVM.so.19.1").touch()
    (tmp_path / "libLLVM.so.22.1").touch()
    assert variant.usable_llvm() == tmp_path / "libLLVM.so.22.1"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so.19.1"))
    assert variant.usable_llvm() == tmp_path / "libLLVM.so.19.1"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-15.so.1"))
    assert variant.usable_llvm() is None


def test_without_it_a_transport_is_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "none")
    scene = Mitsuba.make(
        MitsubaOptions(kind="mitsuba", scene="two_blocks", shape=(4, 4), cache=str(tmp_path))
    )
    with pytest.raises(InputError, match=r"two_blocks.*libllvm19.*DRJIT_LIBLLVM_PATH"):
        scene.apply(np.ones((1, 16)))
