"""Commands that read settings files: equal messages for an unreadable file."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.rigs.known_matrix import run

from rfpipe.errors import ConfigError, RfpipeError

COMMANDS = {
    "plan": ("plan",),
    "catalogue": ("catalogue",),
    "run": ("run", "--configfile"),
    "run, of several": ("run", "--configfile", "here.yaml"),
    "calibrate": ("calibrate",),
    "aim": ("aim",),
    "serve": ("serve",),
    "patterns": ("patterns",),
    "fit": ("fit", "pictures", "--output", "t.zarr", "--settings"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hree.yaml", r"^there is no file hree\.yaml in .*; did you mean here\.yaml"),
        ("absent/a.yaml", r"^there is no file absent/a\.yaml: there is no folder absent$"),
        ("folder", r"^folder: is a folder; name a settings file"),
        ("latin.yaml", r"^latin\.yaml: isn't text in the encoding UTF-8 .*save it as UTF-8"),
        ("empty.yaml", r"^empty\.yaml: is empty"),
    ],
)
def test_an_unreadable_file_has_the_same_message_in_every_command(
    command: str, name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RFPIPE_TOKEN", "a" * 32)
    Path("folder").mkdir()
    Path("pictures").mkdir()
    Path("here.yaml").write_text("scenes: {a: {kind: plane, surfaces: [white]}}\n")
    Path("latin.yaml").write_bytes("title: caf\xe9\n".encode("latin-1"))
    Path("empty.yaml").touch()
    with pytest.raises(RfpipeError, match=message) as caught:
        run(*COMMANDS[command], name)
    assert isinstance(caught.value, ConfigError)
    assert "Errno" not in str(caught.value)
