"""What tests of physically based scenes need: Mitsuba with an LLVM that it can use."""

import os

import pytest

from rfpipe.scenes.mitsuba.variant import usable_llvm

ADVICE = "apt-get install libllvm19 (or another LLVM from version 19 on)"


def require_llvm() -> None:
    """Skip the test, or fail where it is required, unless a transport can be recorded here."""
    if usable_llvm() is None:
        if os.environ.get("RFPIPE_REQUIRE_LLVM"):
            pytest.fail(f"RFPIPE_REQUIRE_LLVM is set, but there is no usable LLVM: {ADVICE}")
        pytest.skip(f"needs an LLVM that Mitsuba can use: {ADVICE}")
