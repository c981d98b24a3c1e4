"""Collections in tables: their rows as scenes, and mistakes by file, line and column."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from rfpipe.config import CameraConfig, load_config
from rfpipe.errors import ConfigError

METHODS = {"near_far": {}}


def settings(folder: Path, rows: str | bytes, name: str = "scenes.csv", **more: Any) -> Path:
    """Write a settings file next to a collection, and return its path."""
    content = rows if isinstance(rows, bytes) else rows.encode()
    (folder / name).write_bytes(content)
    path = folder / "run.yaml"
    path.write_text(yaml.safe_dump({"collection": name, "methods": METHODS, **more}))
    return path


def refusal(folder: Path, rows: str | bytes, name: str = "scenes.csv", **more: Any) -> list[str]:
    """Return the lines of the error about a collection, without the folder's name."""
    with pytest.raises(ConfigError) as caught:
        load_config(settings(folder, rows, name, **more))
    return str(caught.value).replace(f"{folder}/", "").splitlines()


def test_rows_are_scenes_with_overrides(tmp_path: Path) -> None:
    rows = (
        "name,kind,surfaces,shape,channels,camera.exposures,camera.bits,settings.seed,"
        "methods,methods.near_far.target_error,about.number\n"
        "# a comment, then nothing\n\n,,,\n"
        "jug,wedge,white texture,12 x 16,1,0.1 0.5,,7,,,007\n"
        'bowl,plane,white,"[8, 9]",3,,14,,"near_far, dual",0.05,\n'
    )
    run = load_config(settings(tmp_path, rows))
    assert run.acquisitions == [("jug", "near_far"), ("bowl", "near_far"), ("bowl", "dual")]
    jug, bowl = run.of_scene("jug"), run.of_scene("bowl")
    assert run.scenes["jug"].shape == (12, 16)
    assert run.scenes["jug"].about == {"number": "007"}
    assert jug.camera is not None
    assert bowl.camera is not None
    assert (jug.camera.exposures, jug.seed, jug.camera.bits) == ((0.1, 0.5), 7, 12)
    assert (bowl.camera.exposures, bowl.seed, bowl.camera.bits) == (
        CameraConfig().exposures,
        1,
        14,
    )
    assert bowl.methods_of("bowl")["near_far"].options()["target_error"] == 0.05
    assert list(bowl.scenes) == ["bowl"]


def test_rigs_are_shared_and_a_scene_s_settings_win(tmp_path: Path) -> None:
    rows = "name,kind,surfaces,rig,camera.bits\na,plane,white,studio,\nb,plane,white,studio,10\n"
    rigs = {"studio": {"camera": {"bits": 14, "black_level_counts": 32}}}
    run = load_config(settings(tmp_path, rows, rigs=rigs))
    cameras = [run.of_scene(name).camera for name in "ab"]
    assert [(it.bits, it.black_level_counts) for it in cameras if it] == [(14, 32), (10, 32)]


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbfname,kind,surfaces,capture.asymmetry\r\na,plane,white,0.5\r\n",
        b"name;kind;surfaces;capture.asymmetry\r\na;plane;white;0,5\r\n",
        b"sep=;\r\nname;kind;surfaces;capture.asymmetry\r\na;plane;white;0,5\r\n",
        "name\tkind\tsurfaces\tcapture.asymmetry\na\tplane\twhite\t0.5\n".encode("utf-16"),
        b"name,kind,surfaces,capture.asymmetry\ra,plane,white,5e-1",
    ],
    ids=["byte order mark, CRLF", "semicolons", "sep=", "UTF-16, tabs", "CR, exponent"],
)
def test_tables_are_read_as_spreadsheets_write_them(tmp_path: Path, content: bytes) -> None:
    run = load_config(settings(tmp_path, content))
    assert list(run.scenes) == ["a"]
    assert run.of_scene("a").capture.asymmetry == 0.5


def test_lists_may_have_decimal_commas_if_semicolons_separate_cells(tmp_path: Path) -> None:
    rows = (
        "name;kind;surfaces;shape;camera.exposures;projector.position\n"
        "a;wedge_120;white white;8 x 10;0,25 0,5 1;1,72 0 0,54\n"
        "b;wedge_120;white white;8, 10;0.25, 0.5;1.72, 0, 0.54\n"
    )
    methods = {"dual": {}}
    run = load_config(settings(tmp_path, rows, methods=methods))
    cameras = [run.of_scene(name).camera for name in "ab"]
    assert [it.exposures for it in cameras if it] == [(0.25, 0.5, 1), (0.25, 0.5)]
    assert [run.scenes[name].shape for name in "ab"] == [(8, 10)] * 2
    for name in "ab":
        assert run.scenes[name].projector.position == (1.72, 0, 0.54)


HEAD = "name,kind,surfaces"
MISTAKES: list[tuple[str | bytes, *tuple[str, ...]]] = [
    ("name,kind\na,plane\na,plane\n", "line 3: the name a is also in line 2"),
    (
        "name,kind\nVase-3,plane\n1992.3,plane\nSch\u00fcssel,plane\n,plane\nnul,plane\n",
        "line 2: the name 'Vase-3' is unsuitable for a folder; expected a lower-case letter",
        "line 3: the name '1992.3'",
        "line 4: the name 'Sch\u00fcssel'",
        "line 5: the scene has no name",
        "line 6: the name 'nul'",
    ),
    (
        f"{HEAD},shapee\na,plane,white,3\nb,plane,white,3\n",
        "line 2: scenes.a.shapee is unknown; did you mean shape?",
        "line 3: scenes.b.shapee is unknown; did you mean shape?",
    ),
    (  # all kinds of mistakes in one go
        "name,kind,file,camera.exposure\nA,matrix,no\na,plane,,3\na,plane,,,7\nb,pla,[2\n",
        "line 2: the name 'A' is unsuitable for a folder",
        "line 2: file is 'no'; there is no such file",
        "line 4: the name a is also in line 3",
        "line 4: '7' is in a column without",
        "line 5: file: while parsing a flow sequence",
        "line 5: scenes.b: 'pla' is unknown",
        "line 3: scenes.a.settings.camera.exposure is unknown; did you mean exposures?",
    ),
    (
        f"{HEAD},shape\na,plane,white,0 x 3\nb,plane,white,2 x 2\n",
        "line 2: scenes.a.shape[0] is 0; it should be at least 1",
    ),
    ("name,kind\na,pla\n", "line 2: scenes.a: 'pla' is unknown"),
    (
        'name,kind,about.note\na,plane,"two\nlines"\nb,plane,1,2\n',
        "line 4: '2' is in a column without",
    ),
    ("name,kind,name\n", "line 1: the header has name twice"),
    ('name,kind\na,"pla\n', "can't be read as a table: "),
    (b"name,kind,about.x\na,plane,caf\xe9\n", "can't be read as a table: 'utf-8' codec"),
    ("name,kind\n", "has no scenes; expected a row for each"),
    ("name,kind,file\na,matrix,nowhere\n", "line 2: file is 'nowhere'; there is no such file"),
    (
        f"{HEAD},capture.rig\na,plane,white,remote\n",
        "line 2: scenes.a.settings.capture.rig: can't be set for a",
    ),
    (f"{HEAD}\nreport,plane,white\n", "line 2: scenes.report: this name is reserved"),
    (b"PK\x03\x04\x14\x00", "line 1: the header has no column 'name'"),
]


@pytest.mark.parametrize("case", MISTAKES)
def test_every_mistake_is_reported_with_its_line(
    tmp_path: Path, case: tuple[str | bytes, *tuple[str, ...]]
) -> None:
    lines = refusal(tmp_path, case[0])
    assert len(lines) == len(case) - 1
    for line, start in zip(lines, case[1:], strict=True):
        assert line.startswith(f"scenes.csv: {start}")


def test_only_the_first_of_many_mistakes_are_reported(tmp_path: Path) -> None:
    rows = "name,kind,surfaces,shapee\n" + "".join(f"a{n},plane,white,3\n" for n in range(1000))
    lines = refusal(tmp_path, rows)
    assert len(lines) < 50
    assert "and 970 more" in lines[-1]


def test_facts_for_the_catalogue_are_stored_unchanged(tmp_path: Path) -> None:
    rows = (
        "name,kind,surfaces,about.title,about.from,about.Inv.-Nr. (alt)\n"
        "a,plane,white,[Untitled],~,1992.3\nb,plane,white,[Jug] with {handle,null,\n"
    )
    scenes = load_config(settings(tmp_path, rows)).scenes
    assert scenes["a"].about == {
        "title": "[Untitled]",
        "from": "~",
        "Inv.-Nr. (alt)": "1992.3",
    }
    assert scenes["b"].about == {"title": "[Jug] with {handle", "from": "null"}


def test_a_wrong_rig_and_a_missing_file_are_reported(tmp_path: Path) -> None:
    rows = "name,kind,surfaces,rig\na,plane,white,studio\n"
    (line,) = refusal(tmp_path, rows, rigs={"studio": {"camera": {"bits": 40}}})
    assert line.startswith("run.yaml: rigs.studio.camera.bits is 40; it should be at most 16")
    (tmp_path / "run.yaml").write_text("collection: gone.csv\n")
    with pytest.raises(ConfigError, match=f"no file gone.csv nor {tmp_path}/gone.csv"):
        load_config(tmp_path / "run.yaml")
