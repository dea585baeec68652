"""docs/integrations.md: its versions are those that are installed, its scripts are all there are, its code runs."""

import re
import sys
import warnings
from importlib import import_module, metadata, util
from pathlib import Path

import pytest

from tests.integrations import EXAMPLES

PAGE = (EXAMPLES.parent / "integrations.md").read_text("utf-8")
LISTS = [Path(__file__).with_name(name) for name in ("current.txt", "older.txt")]
CONSTRAINTS = EXAMPLES.parents[1] / "constraints.txt"
DISTRIBUTIONS = {"RLlib": "ray"}  # where the library's name is another
OURS = {"sb3": "stable_baselines3", "rllib": "ray", "benchmarl": "benchmarl"}  # what rooms of training import
BLOCKS = re.findall(r"^```py\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)


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
    return {library: re.findall(r"\(examples/(\w+)\.py\)", cell)[0] for library, _, cell, *_ in rows()}


def test_versions_are_those_that_are_installed():
    assert len(rows()) == 7
    for library, versions, *_ in rows():
        name = DISTRIBUTIONS.get(library, library.lower())
        installed = list(dict.fromkeys(listed[name] for listed in (CURRENT, OLDER) if name in listed))
        assert versions.split(", ") == installed, library


def test_scripts_say_the_same_versions():
    text = {library: (EXAMPLES / f"{name}.py").read_text() for library, name in scripts().items()}
    assert f"torch=={CURRENT['torch']}" in text["TorchRL"]
    assert f"ray[rllib]=={OLDER['ray']}" in text["RLlib"]
    assert f"Gymnasium {OLDER['gymnasium']} exactly" in text["RLlib"]
    assert f"benchmarl=={OLDER['benchmarl']}" in text["BenchMARL"]


def test_lists_agree():
    constraints = pins(CONSTRAINTS)
    for file, listed in zip(LISTS, (pins(LISTS[0]), OLDER), strict=True):
        lines = [line for line in file.read_text().splitlines() if line and line[0] not in "#-"]
        assert lines[0] == f"torch=={constraints['torch']}"
        assert all("==" in line for line in lines)
        others = {name for name in listed if listed[name] != constraints.get(name, listed[name])}
        assert others == ({"gymnasium", "av", "pillow"} if listed is OLDER else set())  # RLlib, TorchRL and moviepy ask


def test_every_script_is_in_the_table_and_has_its_test():
    found = {file.stem for file in EXAMPLES.glob("*.py")} - {"ros_pilot"}  # of docs/fleet.md
    assert set(scripts().values()) == found
    tests = "".join(file.read_text() for file in Path(__file__).parent.glob("test_*.py"))
    assert {name for name in found if f'example("{name}")' in tests} == found


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_code_runs(block, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # where what makes a folder makes it
    ours = [library for room, library in OURS.items() if f"fovconn_env.training.{room}" in block]
    for name in [*re.findall(r"^(?:from|import) (\w+)", block, re.M), *ours]:
        if util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the libraries' tests say which of theirs are expected
        exec(compile(block, "integrations.md", "exec"), {"__name__": "example"})


@pytest.mark.skipif(".venvs" not in sys.prefix, reason="not in an environment of `make test-integrations`")
def test_this_environment_has_what_its_list_says():
    listed = pins(LISTS[0] if Path(sys.prefix).name == "current" else LISTS[1])
    assert {name: metadata.version(name).split("+")[0] for name in listed} == listed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for library in scripts():  # else a broken one would only be skipped
            name = DISTRIBUTIONS.get(library, library.lower())
            if name in listed:
                import_module(name.replace("-", "_"))
