"""Leases under a simulated clock, tokens, and settings of remote rigs."""

from __future__ import annotations

from pathlib import Path

import pytest
from starlette.exceptions import HTTPException

from rfpipe.config import SceneSettings, parse_config
from rfpipe.errors import ConfigError, InputError
from rfpipe.rigs.messages import read_token
from rfpipe.scenes import scene_from_config
from rfpipe.server.worker import Leases


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_lease_lasts_while_heartbeats_arrive() -> None:
    clock = Clock()
    leases = Leases(10, clock)
    lease = leases.acquire("one")
    for clock.now in (9.0, 18.0, 27.0):
        leases.renew(lease)
    with pytest.raises(HTTPException, match=r"409.*held by 'one', for another 10\.0 s"):
        leases.acquire("two")
    assert leases.holder == "one"
    clock.now = 37.0
    assert leases.holder is None
    assert not leases.is_held_by(lease)
    with pytest.raises(HTTPException, match="410"):
        leases.renew(lease)
    second = leases.acquire("two")
    assert second != lease
    with pytest.raises(HTTPException, match="410"):
        leases.renew(lease, 0)
    leases.renew(second, 0)
    assert leases.holder is None


@pytest.mark.parametrize("identity", ["", "x", "\udcff", "é" * 10])
def test_a_lease_is_identified_by_its_id(identity: str) -> None:
    leases = Leases(10)
    leases.acquire("one")
    assert not leases.is_held_by(identity)
    with pytest.raises(HTTPException, match="410"):
        leases.renew(identity)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "rig.token"
    file.write_text("0123456789abcdef\n")
    file.chmod(0o600)
    return file


def test_a_token_is_read_from_a_file_or_the_environment(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read_token(file) == "0123456789abcdef"
    monkeypatch.setenv("RFPIPE_TOKEN", "fedcba9876543210")
    assert read_token() == "fedcba9876543210"


@pytest.mark.parametrize(
    "token", ["short", "", "x" * 513, "0123456789abcde\xe9", "0123456789 abcdef"]
)
def test_invalid_tokens_are_refused(
    file: Path, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text(token)
    with pytest.raises(ConfigError, match=r"rig\.token: has a token of \d+ char") as error:
        read_token(file)
    assert not token or token not in str(error.value)
    monkeypatch.setenv("RFPIPE_TOKEN", token)
    with pytest.raises(ConfigError, match="environment variable RFPIPE_TOKEN"):
        read_token()


def test_readable_and_missing_token_files_are_refused(file: Path) -> None:
    file.chmod(0o640)
    with pytest.raises(ConfigError, match=r"has the mode 640.*chmod 600"):
        read_token(file)
    file.unlink()
    with pytest.raises(ConfigError, match=r"can't be read as a token file.*token_urlsafe"):
        read_token(file)


def test_a_captured_scene_has_a_ray_domain_but_no_simulation() -> None:
    desk = {"desk": {"kind": "captured", "shape": [4, 5]}}
    scene = parse_config({"scenes": desk, "capture": {"rig": "remote"}}, "test").scenes["desk"]
    assert scene.is_captured
    assert scene.camera_ray_shape == scene.ray_shape == (4, 5)
    with pytest.raises(InputError, match="can't be simulated"):
        scene_from_config(scene)
    array = SceneSettings.of("captured", shape=(4, 5), views=(3, 3))
    assert array.ray_shape == (9, 4, 5)
