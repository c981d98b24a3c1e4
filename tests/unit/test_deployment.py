"""Files for deployment of the workflow: test run, catalogue, environment, container."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import rattler_build
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import rfpipe
from rfpipe.config import load_config

ROOT = Path(__file__).resolve().parents[2]


def locked_versions() -> set[tuple[str, str]]:
    """Names and versions in requirements.lock; some packages have one per version of Python."""
    text = (ROOT / "requirements.lock").read_text()
    return {
        (canonicalize_name(name), version)
        for name, version in re.findall(r"^([A-Za-z0-9._-]+)==([^\s;]+)", text, re.M)
    }


def test_the_pinned_environment_has_all_dependencies_at_locked_versions() -> None:
    environment = yaml.safe_load((ROOT / "workflow/envs/rfpipe.pinned.yaml").read_text())
    (pip,) = (entry["pip"] for entry in environment["dependencies"] if isinstance(entry, dict))
    pinned = {canonicalize_name(Requirement(line).name): line.partition("==")[2] for line in pip}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(pinned) == {canonicalize_name(Requirement(d).name) for d in project["dependencies"]}
    assert set(pinned.items()) <= locked_versions()


def test_one_script_completes_both_environments() -> None:
    scripts = [
        (ROOT / f"workflow/envs/{name}.post-deploy.sh").read_text()
        for name in ("rfpipe", "rfpipe.pinned")
    ]
    assert scripts[0] == scripts[1]


def test_an_environment_without_a_clone_is_refused(tmp_path: Path) -> None:
    ended = subprocess.run(
        ["bash", ROOT / "workflow/envs/rfpipe.post-deploy.sh"],
        env={**os.environ, "RFPIPE_HOME": str(tmp_path)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 1
    assert f"{tmp_path} has none. Run the Snakefile of a clone" in ended.stderr


def test_the_container_installs_the_locked_versions_by_their_hashes() -> None:
    lines = (ROOT / "Containerfile").read_text().splitlines()
    assert [line for line in lines if line.startswith("FROM")] == ["FROM python:3.12-slim"]
    assert any("--require-hashes --requirement requirements.lock" in line for line in lines)


CONDA_NAMES = {
    "dask[array,distributed]": ("dask-core", "distributed"),
    "matplotlib": ("matplotlib-base",),
    "openimageio": ("py-openimageio",),
    "snakemake>=9.27": ("snakemake-minimal >=9.27",),
}
"""Packages of the recipe for dependencies with another name in conda's channels."""


@pytest.mark.parametrize("platform", ["linux-64", "osx-arm64", "win-64"])
def test_the_recipe_has_the_version_and_all_dependencies(platform: str) -> None:
    target = rattler_build.PlatformConfig(target_platform=platform)
    config = rattler_build.RenderConfig(platform=target)
    recipe = rattler_build.Stage0Recipe.from_file(ROOT / "recipe/recipe.yaml")
    (rendered,) = recipe.render(rattler_build.VariantConfig(), config)
    package, requirements = rendered.recipe.package, rendered.recipe.requirements
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (package.name, package.version) == (project["name"], rfpipe.__version__)
    expected = {f"python {project['requires-python']}"}
    for dependency in project["dependencies"]:
        name, bound = re.match(r"([a-z0-9-]+)(.*)", dependency).groups()
        expected |= set(CONDA_NAMES.get(dependency, (f"{name} {bound}".strip(),)))
    assert {str(it) for it in requirements.run} == expected


def test_the_catalogue_entry_names_a_supported_deployment() -> None:
    usage = yaml.safe_load((ROOT / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    assert usage["software-stack-deployment"]["conda"] is True
    assert usage["report"] is True


def test_the_settings_of_the_test_run_are_valid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT / ".test")
    settings = load_config(Path("config/config.yaml"))
    assert settings.acquisitions == [("wedge", "symmetric")]
    assert Path(settings.scenes["wedge"].file).is_file()
