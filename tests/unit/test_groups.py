"""Groups that no node of a cluster can run are refused before anything is submitted."""

from pathlib import Path

import pytest

from rfpipe.errors import ConfigError
from rfpipe.stages.jobs.groups import check_groups, largest_node


def sinfo(folder: Path, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    program = folder / "sinfo"
    program.write_text(f"#!/bin/sh\nprintf '{says}'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


def test_a_group_larger_than_any_node_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sinfo(tmp_path, "1\\n2\\n", monkeypatch)
    assert largest_node() == 2
    check_groups({}, 64)
    check_groups({"small": 8}, 2)
    check_groups({"small": 2}, 64)
    with pytest.raises(ConfigError, match=r"small=8 jobs .* ask for 4 .*has 2\. Add --cores 2"):
        check_groups({"small": 8, "other": 3}, 4)
    sinfo(tmp_path, "1\\n", monkeypatch)
    with pytest.raises(ConfigError, match="one after the other"):
        check_groups({"small": 8}, None)


@pytest.mark.parametrize("says", ["", "16+\\n", "no controller\\n"])
def test_what_isn_t_known_is_let_pass(
    says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sinfo(tmp_path, says, monkeypatch)
    check_groups({"small": 8}, 64)
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    check_groups({"small": 8}, 64)
