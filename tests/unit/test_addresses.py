"""Invalid addresses are explained in one line, and passwords in addresses are never printed."""

from __future__ import annotations

import logging
import pickle
from pathlib import Path

import numpy as np
import pytest
from tests.services.web_servers import serving
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app
from rfpipe.config import parse_config
from rfpipe.errors import CaptureError, ConfigError, InputError, RfpipeError, StoreError
from rfpipe.rigs import RemoteRig

TOKEN = "a-token-for-tests-only"
SECRET = "geheim"

NONE = [
    "", "rig:8750", "ftp://rig", "http://", "http:///rig", "http://rig/v1", "http://rig?x=1",
    "http://rig#x", "http://[::1", "http://a b:8750", "http://..", "http://-rig:8750",
    "http://" + "a" * 70, "http://\x00:8750", "http://%zz:8750",
    "http://rig:0", "http://rig:99999", "http://rig:port",
    f"http://otto:{SECRET}@127.0.0.1:8750", f"https://{SECRET}@rig", f"http://otto:{SECRET}@[::1",
]  # fmt: skip


@pytest.mark.parametrize("url", NONE)
def test_impossible_urls_are_refused(url: str) -> None:
    with pytest.raises(InputError, match=r"^url is '.*'; it should ") as caught:
        RemoteRig(url, TOKEN)
    assert "\n" not in str(caught.value)
    assert SECRET not in str(caught.value)
    desk = {"desk": {"kind": "captured", "shape": [4, 5]}}
    with pytest.raises(ConfigError, match=r"capture\.url is ") as refused:
        parse_config({"scenes": desk, "capture": {"rig": "remote", "url": url}}, "test")
    assert SECRET not in str(refused.value)


@pytest.mark.parametrize(
    "url", ["http://127.0.0.1:9", "http://[::1]:9/", "https://a_rig.example:9", "http://rig-é:9"]
)
def test_possible_urls_are_requested(url: str) -> None:
    with pytest.raises(CaptureError, match="no answer"):
        RemoteRig(url, TOKEN, patience_seconds=0)


def test_no_error_shows_the_password_of_an_address() -> None:
    for text in (
        f"http://otto:{SECRET}@rig:1 and s3://{SECRET}@b/c: no answer",
        f"'https://otto:{SECRET}@x@rig/run.zip'; http:/otto:{SECRET}@rig/run",
    ):
        error = StoreError(text)
        assert SECRET not in f"{error} {error!r} {error.args}"
        assert str(pickle.loads(pickle.dumps(error))) == str(error)
        assert "rig" in str(error)
    assert str(RfpipeError("https://host/a@b.zip: so it is")) == "https://host/a@b.zip: so it is"


@pytest.mark.parametrize("arguments", [
    ("info", "{run}/transport.zarr"), ("info", "{run}/nothing.zarr"), ("info", "{run}/no.zip"),
    ("relight", "{run}/transport.zarr", "--pattern", "white", "--output", "{out}/a.png"),
    ("view", "{run}/transport.zarr", "--output", "{out}/v.html"), ("verify", "{run}"),
    ("export", "{run}/transport.zarr", "-o", "{out}/m.npz"),
])  # fmt: skip
def test_no_command_shows_the_password_of_an_address(
    tmp_path: Path, arguments: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    rig = rfpipe.OperatorRig(np.eye(16)[None] / 2, (4, 4), (4, 4))
    transport = rfpipe.acquire(rig, "dual", progress=False).transport
    rfpipe.transport.save_transport(transport, tmp_path / "transport.zarr")
    output = tmp_path / "out"
    output.mkdir()
    with serving(tmp_path) as served, caplog.at_level(logging.DEBUG):
        run = served.address.replace("://", f"://otto:{SECRET}@")
        given = [argument.format(run=run, out=output) for argument in arguments]
        result = CliRunner().invoke(app, given)
    assert result.exception is None or isinstance(result.exception, RfpipeError)
    raised = f"{result.output} {result.exception}"
    assert SECRET not in raised + caplog.text
    assert "127.0.0.1" in raised or result.exception is None
    for file in output.rglob("*"):
        assert SECRET.encode() not in file.read_bytes()
