"""Publication of a run as a crate: atomic, reproducible, with a citation."""

import hashlib
import json
import os
import pty
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.results.finished_run import SHAPE, write_run
from tests.rigs import known_matrix
from typer.testing import CliRunner

import rfpipe
from rfpipe import provenance
from rfpipe.cli import app
from rfpipe.config import parse_config
from rfpipe.errors import InputError, IntegrityError
from rfpipe.provenance import source_digest
from rfpipe.publishing.metadata import Citation, check_digit, stored_values
from rfpipe.publishing.publication import encoded
from rfpipe.publishing.publication import publish as publish_run
from rfpipe.publishing.run import find_run
from rfpipe.publishing.writing import Writer
from rfpipe.store import read_manifest, write_manifest

GIVEN = ["--license", "CC-BY-4.0", "--creator", "Doe, Jane; 0000-0002-1825-0097; A Lab"]
STORE = "results/desk/dual/transport.zarr"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a small finished run with a report."""
    return write_run(tmp_path / "run", "desk")


def published(run: Path, *options: object) -> str:
    result = CliRunner().invoke(app, ["publish", str(run), *map(str, options)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


def contents(path: Path) -> dict[str, bytes]:
    if path.is_dir():
        return known_matrix.contents(path)
    with zipfile.ZipFile(path) as archive:
        assert all(info.compress_type == zipfile.ZIP_STORED for info in archive.infolist())
        return {name: archive.read(name) for name in archive.namelist() if name[-1] != "/"}


def test_zips_and_folders_have_the_same_bytes_and_digests(run: Path) -> None:
    (run / "results/desk/symmetric/L00").mkdir(parents=True)
    output = published(run, *GIVEN)
    assert str(run / "publication.zip") in output
    assert "aren't complete: desk by symmetric" in output
    full_name = (run / "publication.zip").read_bytes()
    published(run, "--overwrite")
    assert (run / "publication.zip").read_bytes() == full_name
    # no content depends on the time of writing
    assert b"1980:01:01 00:00:00" in encoded(np.ones((4, 5, 3), np.float32), "exr")
    published(run, "-o", run / "crate")
    files = contents(run / "publication.zip")
    assert contents(run / "crate") == files
    listed = dict(
        reversed(line.split("  "))
        for line in files.pop("manifest-sha256.txt").decode().splitlines()
    )
    assert listed == {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
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
    assert settings.result_settings() == known_matrix.settings_of_a_plane().result_settings()


def test_the_command_prompts_once_for_licence_and_creators(run: Path) -> None:
    with pytest.raises(
        InputError, match=r"creators is missing.*--creator.*\n.*license is missing.*--license"
    ):
        published(run)
    person, terminal = pty.openpty()
    os.write(person, b"Doe, Jane\nCC0-1.0\n")
    command = "from rfpipe.cli import main; main()"
    with os.fdopen(terminal) as stdin:
        prompted = subprocess.run(
            [sys.executable, "-c", command, "publish", str(run)],
            stdin=stdin, capture_output=True, text=True, check=True,
        )  # fmt: skip
    os.close(person)
    assert "Licence" in prompted.stdout
    stored = yaml.safe_load((run / "publication.yaml").read_text())
    assert stored["license"] == "CC0-1.0"
    stored |= {"title": "A desk", "doi": "https://doi.org/10.5281/zenodo.1234567"}
    (run / "publication.yaml").write_text(yaml.safe_dump(stored))
    published(run, "--overwrite")
    assert "doi: 10.5281/zenodo.1234567" in (run / "publication.yaml").read_text()
    files = contents(run / "publication.zip")
    assert json.loads(files["datacite.json"])["doi"] == "10.5281/zenodo.1234567"
    assert b"https://doi.org/10.5281/zenodo.1234567" in files["README.md"]
    cited = yaml.safe_load(files["CITATION.cff"])
    assert (cited["title"], cited["license"]) == ("A desk", "CC0-1.0")
    assert cited["authors"] == [{"name": "Doe, Jane"}]


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        ({"license": "CC BY 4.0"}, r"'CC BY 4.0'; it should be .* SPDX .*did you mean CC-BY-4.0\?"),
        ({"license": "cc-by"}, r"did you mean CC-BY-4.0\?"),
        ({"license": "CC-BY-4.1"}, r"did you mean CC-BY-4.0\?"),
        ({"license": "Apache 2"}, r"did you mean Apache-2.0\?"),
        ({"license": "MIT AND ISC"}, "should be the name of one licence"),
        ({"license": "LicenseRef-mine"}, "or an address"),
        ({"creators": ["Doe, Jane; 000-0002"]}, "ORCID iD such as"),
        (
            {"creators": ["Doe, Jane; 0000-0002-1825-0096"]},
            "0096'; it should end in the check digit 7",
        ),
        ({"creators": ["Doe, Jane; 0000-0002-1852-0097"]}, "two are exchanged"),
        ({"doi": "zenodo.12"}, "doi is .*should be 10.*such as 10"),
        ({"version": "1.0"}, "version is '1.0'; it should be three numbers"),
        ({"titel": "A desk"}, "titel is unknown; did you mean title"),
        ("a desk", "a desk is unknown"),
    ],
)
def test_invalid_citations_are_explained(stored: object, message: str, run: Path) -> None:
    (run / "publication.yaml").write_text(yaml.safe_dump(stored))
    given = [] if set(stored) & {"license", "creators"} else GIVEN
    with pytest.raises(InputError, match=message):
        published(run, *given)
    assert yaml.safe_load((run / "publication.yaml").read_text()) == stored
    assert not (run / "publication.zip").exists()


@pytest.mark.parametrize(
    "orcid",  # from the documentation and the registry of ORCID
    ["0000-0002-1825-0097", "0000-0001-5109-3700", "0000-0002-1694-233X", "0000-0003-1415-9269"],
)
def test_check_digits_follow_iso_7064(orcid: str) -> None:
    assert check_digit(orcid[:-1].replace("-", "")) == orcid[-1]
    for place, digit in enumerate(orcid[:-1]):
        if digit.isdigit():
            wrong = f"{orcid[:place]}{(int(digit) + 1) % 10}{orcid[place + 1 :]}"
            assert check_digit(wrong[:-1].replace("-", "")) != orcid[-1]


@pytest.mark.parametrize("name", ["mit", "cc0-1.0", "odbl-1.0", "https://example.org/licence"])
def test_licences_are_normalized_to_the_spdx_list(name: str) -> None:
    expected = {"mit": "MIT", "cc0-1.0": "CC0-1.0", "odbl-1.0": "ODbL-1.0"}.get(name, name)
    facts = {"title": "a", "creators": ["Doe, Jane"], "published": "2026-01-01"}
    assert Citation.model_validate({**facts, "license": name}).license == expected


OWN = {
    "lab/__init__.py": "",
    "lab/methods.py": "import tools\nfrom lab.more import x\nclass Mine: ...",
    "lab/more.py": "x = 1",
    "tools.py": "import numpy",
    "unused.py": "",
    "scenes/desk.py": "import tools\nclass Desk: ...",
    "scenes/box.xml": """<scene version="3.0.0"><include filename="lamp.xml"/>
        <shape type="ply"><string name="filename" value="../meshes/a.ply"/></shape></scene>""",
    "scenes/lamp.xml": """<scene version="3.0.0"><texture type="bitmap">
        <string name="filename" value="wood.png"/></texture></scene>""",
    "scenes/wood.png": "wood",
    "meshes/a.ply": "a mesh",
    "matrix.npy": "numbers",
}


def write_user_files(run: Path, far: Path) -> None:
    """Write user files in the run's folder and in a folder far away from it."""
    for name, content in OWN.items():
        (run / name).parent.mkdir(exist_ok=True)
        (run / name).write_text(content)
    far.mkdir()
    (far / "room.xml").write_text(OWN["scenes/box.xml"].replace("../meshes/a", "b"))
    (far / "lamp.xml").write_text("<scene/>")
    (far / "b.ply").write_text("another mesh")
    (far / "gone.xml").write_text(f"<a value='{far / 'b.ply'}'/>")


def test_user_files_are_published_at_the_paths_in_the_settings(run: Path, tmp_path: Path) -> None:
    far = tmp_path / "far away"
    write_user_files(run, far)
    results = run / "results/report/results.json"
    report = json.loads(results.read_bytes())
    report["provenance"]["configuration"] |= {
        "scenes": {
            "desk": {"kind": "scenes/desk.py:Desk", "cache": "results/recorded"},
            "box": {"kind": "mitsuba", "scene": "scenes/box.xml"},
            "room": {"kind": "mitsuba", "scene": str(far / "room.xml")},
            "gone": {"kind": "mitsuba", "scene": str(far / "gone.xml")},
            "given": {"kind": "matrix", "file": "matrix.npy"},
            "lost": {"kind": "lost.py:Lost"},
        },
        "methods": {"mine": {"method": "lab.methods:Mine"}, "other": {"method": "numpy.fft:Other"}},
    }
    results.write_text(json.dumps(report))
    output = published(run, *GIVEN)
    files = contents(run / "publication.zip")
    inputs = {name.removeprefix("inputs/"): text.decode() for name, text in files.items()
              if name.startswith("inputs/")}  # fmt: skip
    published_files = {name: text for name, text in OWN.items() if name != "unused.py"}
    outside = {name: (far / name).read_text() for name in ("room.xml", "lamp.xml", "b.ply")}
    gone = {"outside/1/gone.xml": (far / "gone.xml").read_text()}
    assert (
        inputs
        == published_files | {f"outside/1/{name}": text for name, text in outside.items()} | gone
    )
    settings = yaml.safe_load(files["settings.yaml"])
    assert settings["scenes"]["room"]["scene"] == "outside/1/room.xml"
    assert settings["scenes"]["desk"] == {
        "kind": "scenes/desk.py:Desk",
        "cache": "results/recorded",
    }
    assert settings["methods"]["mine"]["method"] == "lab.methods:Mine"
    assert "methods.other.method is numpy.fft:Other: numpy is an installed package" in output
    assert "scenes.lost.kind is lost.py:Lost: there is no file lost.py" in output
    assert "gone.xml names it by an absolute path" in output
    assert b"cp -r inputs again" in files["README.md"]
    graph = json.loads(files["ro-crate-metadata.json"])["@graph"]
    (action,) = [entity for entity in graph if entity["@id"] == "#run"]
    assert {"@id": "inputs/lab/methods.py"} in action["object"]


EDITED = {
    "scene": ("desk.py", {"scenes": {"desk": {"kind": "desk.py:Desk"}}}),
    "scene of a module": ("lab/desk.py", {"scenes": {"desk": {"kind": "lab.desk:Desk"}}}),
    "method": ("mine.py", {"methods": {"dual": {"method": "mine.py:Mine"}}}),
    "method of a scene": (
        "mine.py", {"scenes": {"desk": {"methods": {"dual": {"method": "mine.py:Mine"}}}}},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", EDITED)
def test_user_code_that_changed_after_the_run_is_refused(case: str, run: Path) -> None:
    name, settings = EDITED[case]
    file = run / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("x = 1\n")
    manifest, report = run / "results/desk/dual/transport.json", run / "results/report/results.json"
    write_manifest(
        manifest,
        {**read_manifest(manifest), "sources": {case.partition(" ")[0]: source_digest(file)}},
    )
    facts = json.loads(report.read_bytes())
    facts["provenance"]["configuration"] |= settings
    report.write_text(json.dumps(facts))
    file.write_text("x = 1  # a remark changes no result\n")
    published(run, *GIVEN)
    for text, message in (
        ("x = 2", ["was edited after it made results/desk/dual", "restore", "rfpipe run"]),
        ("x =", [", line 1: isn't Python", "restore"]),
    ):
        file.write_text(text)
        provenance._parsed.cache_clear()  # held by another process that publishes
        with pytest.raises(InputError) as caught:
            published(run, *GIVEN, "--overwrite")
        for words in (str(file), *message):
            assert words in str(caught.value)


def test_a_link_to_a_publication_stays_a_link(run: Path, tmp_path: Path) -> None:
    target, link = tmp_path / "far.zip", tmp_path / "link.zip"
    link.symlink_to(target)
    published(run, *GIVEN, "-o", link)
    published(run, *GIVEN, "-o", link, "--overwrite")
    assert link.is_symlink()
    assert "datacite.json" in contents(target)


def test_printed_commands_can_be_pasted(run: Path, tmp_path: Path) -> None:
    output = published(run, *GIVEN, "-o", tmp_path / "a crate; of mine.zip")
    (command,) = [line for line in output.splitlines() if "rfpipe verify" in line]
    words = shlex.split(command.partition(":")[2])
    assert words == ["rfpipe", "verify", str(tmp_path / "a crate; of mine.zip")]


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


def test_existing_files_are_not_overwritten(run: Path, tmp_path: Path) -> None:
    published(run, *GIVEN)
    before = (run / "publication.zip").read_bytes()
    with pytest.raises(InputError, match="--overwrite"):
        published(run)
    home = tmp_path / "home"
    home.mkdir()
    (home / "thesis.txt").touch()
    with pytest.raises(InputError, match="is not a publication"):
        published(run, "-o", home, "--overwrite")
    with pytest.raises(InputError, match="is within the results"):
        published(run, "-o", run / "results/crate.zip")
    assert (home / "thesis.txt").exists()
    assert (run / "publication.zip").read_bytes() == before


@pytest.mark.parametrize("name", ["crate", "crate.zip"])
def test_an_interrupted_publication_keeps_the_previous_one(
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
    citation = Citation.model_validate(stored_values(run) | {"version": "2.0.0"})
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


def test_publishing_a_run_without_a_report_needs_its_settings(run: Path, tmp_path: Path) -> None:
    settings_path = tmp_path / "other.yaml"
    settings_path.write_text(
        yaml.safe_dump(known_matrix.settings_of_a_plane(seed=7).model_dump(mode="json"))
    )
    (run / "results/report/results.json").unlink()
    published(run, "--config", settings_path, *GIVEN)
    assert b"seed: 7" in contents(run / "publication.zip")["settings.yaml"]


def test_the_calibration_of_a_real_rig_is_published(run: Path) -> None:
    (run / "calibration").mkdir()
    (run / "calibration/calibration.json").write_text("{}")
    published(run, *GIVEN)
    assert "calibration/calibration.json" not in contents(run / "publication.zip")
    (run / "results/report/results.json").unlink()
    published(run, "--overwrite")
    assert "calibration/calibration.json" in contents(run / "publication.zip")
