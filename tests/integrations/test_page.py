"""docs/integrations.md: its versions are those that are installed, its scripts and recipes are all there are."""

import re
import sys
import warnings
from importlib import import_module, metadata
from pathlib import Path

import pytest

from tests.integrations import EXAMPLES, RECIPES

PAGE = (EXAMPLES.parent / "integrations.md").read_text("utf-8")
LISTS = [Path(__file__).with_name(name) for name in ("current.txt", "older.txt")]
CONSTRAINTS = EXAMPLES.parents[1] / "constraints.txt"
DISTRIBUTIONS = {"RLlib": "ray"}  # where the library's name is another


def pins(file: Path) -> dict[str, str]:
    """Versions by name, in lower case, of a list of requirements."""
    return {
        name.lower(): version for name, version in re.findall(r"^([\w-]+)(?:\[\w+\])?==(.+)$", file.read_text(), re.M)
    }


CURRENT, OLDER = (pins(file) for file in LISTS)
CURRENT = {**pins(CONSTRAINTS), **CURRENT}


def rows() -> list[list[str]]:
    """Cells of the table of libraries, without its head."""
    table = [line.strip("|").split("|") for line in re.findall(r"(?:^\|.*\n)+", PAGE, re.M)[0].splitlines()]
    return [[cell.strip() for cell in row] for row in table[2:]]


def scripts() -> dict[str, str]:
    """Names of the scripts in the table, by library."""
    found = {library: re.findall(r"\(examples/(\w+)\.py\)", cell) for library, _, _, cell, *_ in rows()}
    return {library: names[0] for library, names in found.items() if names}


def test_versions_are_those_that_are_installed():
    assert len(rows()) == 10
    for library, versions, *_ in rows():
        name = DISTRIBUTIONS.get(library, library.lower())
        installed = list(dict.fromkeys(listed[name] for listed in (CURRENT, OLDER) if name in listed))
        assert versions.split(", ") == installed, library


def test_pages_and_scripts_say_the_same_versions():
    texts = [file.read_text("utf-8") for file in (*EXAMPLES.glob("*.py"), *RECIPES)]
    said = {version for text in texts for version in re.findall(r"(torch|benchmarl|ray\[rllib\])==([\d.]+\d)", text)}
    assert said == {("torch", CURRENT["torch"]), ("ray[rllib]", OLDER["ray"]), ("benchmarl", OLDER["benchmarl"])}
    gymnasium = {each for text in texts for each in re.findall(r"Gymnasium ([\d.]+\d) exactly", text)}
    assert gymnasium == {OLDER["gymnasium"]}


def test_lists_agree():
    constraints = pins(CONSTRAINTS)
    for file, listed in zip(LISTS, (pins(LISTS[0]), OLDER), strict=True):
        lines = [line for line in file.read_text().splitlines() if line and line[0] not in "#-"]
        assert lines[0] == f"torch=={constraints['torch']}"
        assert all("==" in line for line in lines)
        others = {name for name in listed if listed[name] != constraints.get(name, listed[name])}
        assert others == ({"gymnasium", "av", "pillow"} if listed is OLDER else set())  # RLlib, TorchRL and moviepy ask


def test_every_recipe_is_in_the_table_or_told_below():
    assert {f"recipes/{file.name}" for file in RECIPES} == set(re.findall(r"\((recipes/\w+\.md)\)", PAGE))


def test_every_script_is_in_the_table_and_has_its_test():
    found = {file.stem for file in EXAMPLES.glob("*.py")} - {"ros_pilot"}  # of docs/fleet.md
    assert set(scripts().values()) == found
    tests = "".join(file.read_text() for file in Path(__file__).parent.glob("test_*.py"))
    assert {name for name in found if f'example("{name}")' in tests} == found


@pytest.mark.skipif(".venvs" not in sys.prefix, reason="not in an environment of `make test-integrations`")
def test_this_environment_has_what_its_list_says():
    listed = pins(LISTS[0] if Path(sys.prefix).name == "current" else LISTS[1])
    assert {name: metadata.version(name).split("+")[0] for name in listed} == listed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for library, *_ in rows():  # else a broken one would only be skipped
            name = DISTRIBUTIONS.get(library, library.lower())
            if name in listed:
                import_module(name.replace("-", "_"))
