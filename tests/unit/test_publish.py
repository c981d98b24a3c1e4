"""A run becomes a crate: whole or not at all, the same bytes twice, licence asked for once."""

import hashlib
import json
import os
import pty
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests import helpers
from tests.finished import SHAPE, write_run
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app
from rfpipe.config import parse_config
from rfpipe.errors import InputError, IntegrityError
from rfpipe.store import write_manifest
from rfpipe_publish.metadata import Citation, kept_values
from rfpipe_publish.publication import encoded
from rfpipe_publish.publication import publish as publish_run
from rfpipe_publish.run import find_run
from rfpipe_publish.writing import Writer

GIVEN = ["--license", "CC-BY-4.0", "--creator", "Doe, Jane; 0000-0002-1825-0097; A Lab"]
STORE = "results/desk/dual/transport.zarr"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a small run with a report, as its stages leave it."""
    return write_run(tmp_path / "run", "desk")


def published(run: Path, *options: object) -> str:
    result = CliRunner().invoke(app, ["publish", str(run), *map(str, options)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def contents(path: Path) -> dict[str, bytes]:
    if path.is_dir():
        return helpers.contents(path)
    with zipfile.ZipFile(path) as archive:
        assert all(info.compress_type == zipfile.ZIP_STORED for info in archive.infolist())
        return {name: archive.read(name) for name in archive.namelist() if name[-1] != "/"}


def test_zips_and_folders_hold_the_same_bytes_with_their_digests(run: Path) -> None:
    (run / "results/desk/symmetric/L00").mkdir(parents=True)
    output = published(run, *GIVEN)
    assert str(run / "publication.zip") in output
    assert "aren't complete: desk by symmetric" in output
    whole = (run / "publication.zip").read_bytes()
    published(run, "--overwrite")
    assert (run / "publication.zip").read_bytes() == whole
    # nothing tells of the second in which it was written
    assert b"1980:01:01 00:00:00" in encoded(np.ones((4, 5, 3), np.float32), "exr")
    published(run, "-o", run / "crate")
    files = contents(run / "publication.zip")
    assert contents(run / "crate") == files
    listed = dict(
        reversed(line.split("  "))
        for line in files.pop("manifest-sha256.txt").decode().splitlines()
    )
    assert listed == {name: hashlib.sha256(found).hexdigest() for name, found in files.items()}
    expected = {
        *(f"{STORE}/{file}" for file in contents(run / STORE)),
        "results/desk/dual/transport.json",
        *(f"provenance/desk/dual/{name}.json" for name in ("relight", "L00/capture")),
        *("results/report/index.html", "results/report/view/desk.html"),
        *("results/report/results.json", "results/report/tables/errors.csv", "settings.yaml"),
        *("README.md", "read.py", "CITATION.cff", "datacite.json"),
        *("ro-crate-metadata.json", "ro-crate-preview.html"),
    }
    assert {name for name in files if not name.startswith("source/")} == expected
    assert not any(str(run).encode() in content for content in files.values())
    settings = parse_config(yaml.safe_load(files["settings.yaml"]), "settings.yaml")
    assert settings.shaping() == helpers.settings_of_a_plane().shaping()


def test_licence_and_creators_are_asked_for_once(run: Path) -> None:
    with pytest.raises(
        InputError, match=r"creators is missing.*--creator.*\n.*license is missing.*--license"
    ):
        published(run)
    person, terminal = pty.openpty()
    os.write(person, b"Doe, Jane\nCC0-1.0\n")
    command = "from rfpipe.cli import main; main()"
    with os.fdopen(terminal) as stdin:
        asked = subprocess.run(
            [sys.executable, "-c", command, "publish", str(run)],
            stdin=stdin, capture_output=True, text=True, check=True,
        )  # fmt: skip
    os.close(person)
    assert "Licence" in asked.stdout
    kept = yaml.safe_load((run / "publication.yaml").read_text())
    assert kept["license"] == "CC0-1.0"
    kept |= {"title": "A desk", "doi": "https://doi.org/10.5281/zenodo.1234567"}
    (run / "publication.yaml").write_text(yaml.safe_dump(kept))
    published(run, "--overwrite")
    assert "doi: 10.5281/zenodo.1234567" in (run / "publication.yaml").read_text()
    files = contents(run / "publication.zip")
    assert json.loads(files["datacite.json"])["doi"] == "10.5281/zenodo.1234567"
    assert b"https://doi.org/10.5281/zenodo.1234567" in files["README.md"]
    cited = yaml.safe_load(files["CITATION.cff"])
    assert (cited["title"], cited["license"]) == ("A desk", "CC0-1.0")
    assert cited["authors"] == [{"name": "Doe, Jane"}]


@pytest.mark.parametrize(
    ("kept", "says"),
    [
        ({"license": "CC BY 4.0"}, "license is 'CC BY 4.0'; it should match .* SPDX"),
        ({"creators": ["Doe, Jane; 000-0002"]}, "ORCID iD such as"),
        ({"doi": "zenodo.12"}, "doi is .*such as 10"),
        ({"titel": "A desk"}, "titel is unknown; did you mean title"),
        ("a desk", "a desk is unknown"),
    ],
)
def test_what_a_citation_cannot_be_is_said(kept: object, says: str, run: Path) -> None:
    (run / "publication.yaml").write_text(yaml.safe_dump(kept))
    given = [] if set(kept) & {"license", "creators"} else GIVEN
    with pytest.raises(InputError, match=says):
        published(run, *given)
    assert yaml.safe_load((run / "publication.yaml").read_text()) == kept
    assert not (run / "publication.zip").exists()


def test_the_example_runs_from_the_zip_and_the_folder(run: Path) -> None:
    published(run, *GIVEN, "-o", run / "crate")
    published(run, "-o", run / "crate.zip")
    example = (run / "crate/read.py").read_text()
    assert len(example.splitlines()) == 10
    light = np.arange(SHAPE[1]) >= SHAPE[1] // 2
    mean = rfpipe.open_transport(run / STORE).relight(np.tile(light, (SHAPE[0], 1))).mean()
    for where in ((), (str(run / "crate.zip"),)):
        command = [sys.executable, str(run / "crate/read.py"), *where]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=run)
        assert f"mean {mean:.4f}" in done.stdout


def test_nothing_that_stands_there_is_lost(run: Path, tmp_path: Path) -> None:
    published(run, *GIVEN)
    before = (run / "publication.zip").read_bytes()
    with pytest.raises(InputError, match="--overwrite"):
        published(run)
    home = tmp_path / "home"
    home.mkdir()
    (home / "thesis.txt").touch()
    with pytest.raises(InputError, match="didn't make"):
        published(run, "-o", home, "--overwrite")
    with pytest.raises(InputError, match="lies among the results"):
        published(run, "-o", run / "results/crate.zip")
    assert (home / "thesis.txt").exists()
    assert (run / "publication.zip").read_bytes() == before


@pytest.mark.parametrize("name", ["crate", "crate.zip"])
def test_an_interrupted_publication_leaves_the_one_before(
    name: str, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    published(run, *GIVEN, "-o", run / name)
    before = contents(run / name)
    add = Writer.add

    def interrupted(self: Writer, name: str, source: Path | bytes) -> None:
        if name == "read.py":
            raise KeyboardInterrupt
        add(self, name, source)

    monkeypatch.setattr(Writer, "add", interrupted)
    citation = Citation.model_validate(kept_values(run) | {"version": "2.0.0"})
    with pytest.raises(KeyboardInterrupt):
        publish_run(find_run(run), citation, run / name, overwrite=True)
    assert contents(run / name) == before
    assert [file.name for file in run.iterdir() if file.name.startswith(".crate")] == []
    monkeypatch.undo()
    publish_run(find_run(run), citation, run / name, overwrite=True)
    assert b"Version 2.0.0" in contents(run / name)["README.md"]


def test_a_damaged_or_foreign_transport_is_not_published(run: Path) -> None:
    chunk = next((run / STORE / "matrix").glob("c*"))
    content = chunk.read_bytes()
    chunk.write_bytes(content[:-1])
    with pytest.raises(IntegrityError, match="truncated"):
        published(run, *GIVEN)
    chunk.write_bytes(content)
    manifest = run / "results/desk/dual/transport.json"
    facts = {**json.loads(manifest.read_text()), "digest": "of another"}
    facts.pop("checksum")
    write_manifest(manifest, facts)
    with pytest.raises(IntegrityError, match="rfpipe verify"):
        published(run, *GIVEN)
    assert not (run / "publication.zip").exists()


def test_settings_that_no_report_knows_are_given(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(helpers.settings_of_a_plane(seed=7).model_dump(mode="json")))
    (run / "results/report/results.json").unlink()
    published(run, "--config", other, *GIVEN)
    assert b"seed: 7" in contents(run / "publication.zip")["settings.yaml"]


def test_a_calibration_goes_with_a_real_rig(run: Path) -> None:
    (run / "calibration").mkdir()
    (run / "calibration/calibration.json").write_text("{}")
    published(run, *GIVEN)
    assert "calibration/calibration.json" not in contents(run / "publication.zip")
    (run / "results/report/results.json").unlink()
    published(run, "--overwrite")
    assert "calibration/calibration.json" in contents(run / "publication.zip")
