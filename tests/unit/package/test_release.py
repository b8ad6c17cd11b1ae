"""What is published elsewhere says what the package says."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

from gnomon import __version__

ROOT = Path(__file__).parents[3]
OTHER_NAMES = {"opencv-python-headless": "py-opencv", "isal": "python-isal"}


def names_and_versions(requirements):
    """Return the names of packages with their lowest versions, of three numbers at most."""
    pairs = (re.match(r"([\w-]+) ?>=([\d.]+)", line).groups() for line in requirements)
    return {OTHER_NAMES.get(name.lower(), name.lower()): version.split(".")[:2] for name, version in pairs}


def test_the_conda_recipe_says_what_the_package_says():
    package = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = package["project"]
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text(encoding="utf-8"))
    needed = [line for line in recipe["requirements"]["run"] if not line.startswith("python ")]
    assert names_and_versions(needed) == names_and_versions(project["dependencies"])
    assert f"python {project['requires-python']}" in recipe["requirements"]["run"]
    assert recipe["context"]["version"] == __version__
    built_with = [line.replace(" ", "") for line in recipe["requirements"]["host"]]
    assert set(package["build-system"]["requires"]) <= set(built_with)
    programs = [f"{name} = {start}" for name, start in project["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == programs
    about = recipe["about"]
    assert (about["summary"], about["license"]) == (project["description"], project["license"])
    assert (ROOT / about["license_file"]).is_file()


@pytest.mark.parametrize("name", ["ci.yml", "release.yml"])
def test_workflows_name_files_that_are_there(name):
    workflow = yaml.safe_load((ROOT / ".github/workflows" / name).read_text(encoding="utf-8"))
    runs = [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]
    assert runs
    for path in re.findall(r"(?<![\w/])((?:\.ci|src|docs)/[\w/.]+\.py)", "\n".join(runs)):
        assert (ROOT / path).is_file(), path


def test_citations_of_the_paper_are_in_its_bibliography():
    cited = set(re.findall(r"@([a-z]+\d+)", (ROOT / "paper/paper.md").read_text(encoding="utf-8")))
    listed = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper/paper.bib").read_text(encoding="utf-8"), re.MULTILINE))
    assert cited == listed
