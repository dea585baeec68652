"""README.md and docs/: every example runs, every link leads somewhere, every name exists, every table is up to date."""

import dataclasses
import importlib
import json
import re
import runpy
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fovconn_env import PRESETS, Scenario, Simulator, layout, scenario
from fovconn_env.baselines import ORACLES, POLICIES, Gains
from fovconn_env.flights.metrics import ERRORS, Meter
from fovconn_env.kernel import records, step

ROOT = Path(__file__).parents[1]
RECIPES = sorted((ROOT / "docs" / "recipes").glob("*.md"))
FILES = (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md")), *RECIPES)
PAGES = {str(file.relative_to(ROOT)): file for file in FILES}
README = PAGES["README.md"].read_text("utf-8")
FACTORIES = [field.default_factory for field in dataclasses.fields(Scenario)]
GROUPS = [kind for kind in FACTORIES if isinstance(kind, type)]  # Clock, Camera, ...: MISSING is no class
TABLES = runpy.run_path(str(ROOT / "docs" / "tables.py"))


def blocks(text: str, language: str) -> list[str]:
    """The fenced code blocks of a page in one language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def prose(text: str) -> str:
    """A page without its code."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE))


def commands(program: str) -> list[list[str]]:
    """Arguments of every call of a program in the pages' shell blocks."""
    scripts = [block.replace("\\\n", " ") for page in PAGES.values() for block in blocks(page.read_text("utf-8"), "sh")]
    lines = [line for script in scripts for line in script.splitlines()]
    return [words[1:] for words in (shlex.split(line, comments=True) for line in lines) if words[:1] == [program]]


def anchors(text: str) -> set[str]:
    """GitHub's anchors of a page's headings."""
    titles = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def table_rows(text: str) -> list[list[str]]:
    """Cells of all table rows, heads included."""
    return [re.split(r"(?<!\\)\|", line)[1:-1] for line in text.splitlines() if re.match(r"\|(?!-)", line)]


def named(text: str) -> set[str]:
    """Names in code style in the first column of a page's tables."""
    return {name for row in table_rows(text) for name in re.findall(r"`(\w+)`", row[0])}


# ------------------------------------------------------------------------------------------------------- examples
@pytest.mark.parametrize("page", PAGES)
def test_examples_run(page, tmp_path, monkeypatch):
    """All Python blocks of a page in order, in one namespace; presets are cut to 20 steps."""
    for name, preset in PRESETS.items():
        monkeypatch.setitem(PRESETS, name, dataclasses.replace(preset, max_cycles=20, warmup=1.0))
    policies = dict(POLICIES)
    for module in ("fovconn_env.baselines", "fovconn_env.baselines.registry"):  # an example may add to them
        monkeypatch.setattr(f"{module}.POLICIES", policies)
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "example"}
    text = PAGES[page].read_text("utf-8")
    for block in blocks(text, "python"):
        line = text[: text.index(block)].count("\n")
        exec(compile("\n" * line + block, str(PAGES[page]), "exec"), namespace)


def test_readme_is_short_and_has_the_examples_it_promises():
    assert len(README.splitlines()) <= 150
    assert "while env.agents:" in blocks(README, "python")[0]
    assert ["demo"] in commands("make")
    assert ["test"] in commands("make")
    assert len(commands("fovconn")) >= 3


@pytest.mark.parametrize("arguments", commands("fovconn"), ids=" ".join)
def test_commands_parse(arguments):
    typer_main = pytest.importorskip("typer.main")
    from fovconn_env.training.commands.app import app, words
    from fovconn_env.training.commands.options import parse
    from fovconn_env.training.evaluation.campaign import parse_seeds, suite

    command = typer_main.get_command(app).commands[arguments[0]]
    values = command.make_context(arguments[0], words(arguments[1:])).params
    policies = values.get("policies") or [values.get("policy") or "expert"]
    policies = [policy.rpartition("=")[2] for policy in policies]  # fovconn fleet takes "uav_3=follow" as well
    # written or trained by the reader
    yours = re.compile(
        r"my_policy\.py(:\w+)?|model\.(?:zip|pt|onnx)|out/rllib|(lambda2-cbf:)?out/(\w+)/\3\.safetensors"
    )
    known = [policy.removeprefix("informed:") for policy in policies]
    assert all(policy in (*POLICIES, *ORACLES) or yours.fullmatch(policy) for policy in known)
    names = values.get("scenario_names") or [values.get("scenario_name") or "LeaderFollow-v0"]
    if values.get("suite_name"):
        names = suite(values["suite_name"], policies, values.get("only") or ())[1]
    for name in names:
        name, *settings = name.split()  # fovconn train takes "LossyRadio-v0 level=4" as well
        scenario(name, **parse([*settings, *(values.get("settings") or [])]))
    if values.get("seeds"):
        parse_seeds(values["seeds"])


def test_make_targets_and_extras_exist():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert {target for target, *_ in commands("make")} <= set(targets)
    for arguments in [words for words in commands("pip") if "-e" in words]:
        if not any(word.startswith(("ray[", "benchmarl")) for word in arguments):  # these hold others back
            assert (ROOT / arguments[arguments.index("-c") + 1]).is_file()
        extras = re.search(r"\[(.*)\]", arguments[arguments.index("-e") + 1])
        assert extras is None or set(extras[1].split(",")) <= set(project["optional-dependencies"])
    install = README.partition("## Install")[2].partition("\n## ")[0]
    assert named(install) == set(project["optional-dependencies"])
    for version in re.findall(r"^Programming Language :: Python :: (3\.\d+)$", "\n".join(project["classifiers"]), re.M):
        assert version in README


# ---------------------------------------------------------------------------------------------------------- files
def test_pictures_are_shown_and_have_palettes():
    text = "".join(page.read_text("utf-8") for page in PAGES.values())
    for path in (ROOT / "docs" / "images").rglob("*.png"):
        assert f"{path.relative_to(ROOT / 'docs')})" in text, f"no page shows {path.name}"
        with Image.open(path) as picture:
            assert picture.mode == "P", f"{path.name}: run python docs/shrink.py"


def test_the_picture_of_the_readme_moves_and_is_small():
    first = ROOT / re.findall(r"^!\[.*\]\((.*)\)$", README, re.MULTILINE)[0]
    assert first.stat().st_size < 1_000_000
    with Image.open(first) as picture:
        assert picture.n_frames > 50


def test_lines_that_a_newcomer_needs_are_counted():
    """Of the first block of code in the section that a row links to."""
    rows = table_rows(PAGES["docs/find.md"].read_text("utf-8"))[1:]
    assert len(rows) >= 8
    for wish, page, lines in rows:
        name, _, anchor = re.findall(r"\]\((.*)\)", page)[0].partition("#")
        parts = re.split(r"^(?=#+ )", (ROOT / "docs" / name).read_text("utf-8"), flags=re.MULTILINE)
        [section] = [part for part in parts if anchors(part) == {anchor}] if anchor else ["".join(parts)]
        code = re.search(r"^```\w*\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)
        assert code is not None, wish
        assert int(lines) == len([line for line in code[1].splitlines() if line.strip()]), wish


def test_the_notebook_is_kept_without_outputs():
    cells = json.loads((ROOT / "docs" / "quickstart.ipynb").read_text("utf-8"))["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


def test_loops_name_the_robot_and_reset_the_policy():
    """A policy with a memory flies as it should in every loop that is printed."""
    examples = [*(ROOT / "docs").glob("examples/*.py"), *(ROOT / "docs").glob("*.ipynb")]
    texts = {str(path): path.read_text("utf-8").replace('\\"', '"') for path in [*FILES, *examples]}
    calls = {name: re.findall(r"\bact\((.*)", text) for name, text in texts.items() if ".act(observation" in text}
    assert len(calls) >= 6
    for name, lines in calls.items():
        assert re.search(r"(policy|pilot)\.reset\(", texts[name]), f"{name} never resets the policy"
        for line in lines:
            assert not re.match(r"observations\[", line) or "agent=" in line, f"{name}: act({line}"


def test_numbers_in_the_notebooks_text_come_from_its_record():
    """What a training ends with is said for three seeds or more, and nothing else is in per cent."""
    record = json.loads((ROOT / "docs" / "quickstart.json").read_text("utf-8"))
    book = (ROOT / "docs" / "quickstart.ipynb").read_text("utf-8")
    cells = json.loads(book)["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    shares = [f"{each['64']['success']:.0%}" for each in record["trained"]]
    assert len({each["seed"] for each in record["trained"]}) >= 3
    assert re.findall(r"[\d.]+ ?%", text) == shares
    assert f"STEPS = {record['made']['steps']:_}" in book


# ---------------------------------------------------------------------------------------------------------- links
@pytest.mark.parametrize("page", PAGES)
def test_links_and_images_resolve(page):
    text, here = PAGES[page].read_text("utf-8"), PAGES[page].parent
    for name, target in re.findall(r"([\w.]*)\]\(([^)\s]+)\)", prose(text)):
        assert not name.endswith(".py") or target.endswith(name), f"{page} calls {target} {name}"
        if target.startswith(("https://", "http://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        path = (here / name).resolve() if name else PAGES[page]
        assert path.exists(), f"{page} links to {target}"
        assert path.is_relative_to(ROOT), f"{page} links out of the repository: {target}"
        if anchor:
            assert anchor in anchors(path.read_text("utf-8")), f"{page} links to {target}"


def test_every_page_is_reached_from_the_readme():
    """Recipes by the page that the README has of them."""
    for page, file in PAGES.items():
        listed = PAGES["docs/integrations.md"].read_text("utf-8") if file in RECIPES else README
        assert page == "README.md" or f"({page.removeprefix('docs/') if file in RECIPES else page})" in listed


# --------------------------------------------------------------------------------------------------------- tables
def test_generated_tables_are_up_to_date():
    stale = [page for page, text in TABLES["pages"]().items() if not page.exists() or page.read_text("utf-8") != text]
    assert not stale, "run: make docs"


def test_all_tables_are_shown():
    text = "".join(page.read_text("utf-8") for page in PAGES.values())
    for table in "SELF NEIGHBOR RANGE ACTION MESSAGE STATE STATE_TEAM INFO LOST_LINK".split():
        assert f"<!-- layout:{table} -->" in text
    for kind in (Scenario, Gains, *GROUPS):
        assert f"<!-- settings:{kind.__name__} -->" in text


@pytest.mark.parametrize("kind", [Scenario, Gains, *GROUPS])
def test_settings_table_has_every_field(kind):
    rows = table_rows(TABLES["settings_table"](kind.__name__))
    assert [row[0].strip() for row in rows[1:]] == [f"`{field.name}`" for field in dataclasses.fields(kind)]


@pytest.mark.parametrize(
    "changes", [{}, {"speed_limit": 2.0, "yaw_rate_limit": 0.7, "stick_speed": 0.3, "n_agents": 4}]
)
def test_bounds_are_what_the_table_says(changes):
    chosen = scenario(**changes)
    settings = {field.name: getattr(chosen, field.name) for field in dataclasses.fields(chosen)}
    scales = {name: eval(rule, {}, settings) for name, rule in TABLES["SCALES"].items()}
    assert scales == {name: value for name, value in chosen.scales().items() if name != "inf"}


def test_sizes_in_the_text_are_right():
    text, chosen = PAGES["docs/observation.md"].read_text("utf-8"), scenario()
    assert f"`self` ({len(layout.SELF)} numbers)" in text
    assert f"rows of {len(layout.NEIGHBOR)}," in text
    assert f"rows of {len(layout.RANGE)}," in text
    assert f"one box of {chosen.observation_size} numbers" in text.replace("\n", " ")
    assert f"{layout.BYTES_PER_MESSAGE} bytes a message" in text
    assert f"[{len(layout.MESSAGE)} numbers]" in PAGES["docs/decisions.md"].read_text("utf-8")


# ---------------------------------------------------------------------------------------------------------- names
def symbols() -> list[list[str]]:
    """Rows of the table of the paper's symbols."""
    page = PAGES["docs/symbols.md"].read_text("utf-8")
    return table_rows(re.search(r"<!-- symbols -->\n(.*?)<!-- end symbols -->", page, re.DOTALL)[1])[1:]


def resolve(name: str) -> object:
    """What a name in the symbol table stands for: a gain, a column, a record's field, or a setting."""
    group, _, field = name.rpartition(".")
    if group == "Gains":
        return getattr(Gains(), field)
    if group.isupper():
        table = getattr(layout, group, None)
        fields = [column.name for column in table] if table else getattr(records, group).names
        return fields.index(field)
    value = scenario()
    for part in name.split("."):
        value = getattr(value, part)
    return value


def test_names_in_the_symbol_table_exist():
    rows = symbols()
    names = [name for row in rows for name in re.findall(r"`([^`]+)`", row[2])]
    assert len(rows) > 20
    assert len(names) > 30
    for name in names:
        resolve(name)


def test_functions_in_the_symbol_table_exist():
    found = [link for row in symbols() for link in re.findall(r"\[`(\w+)`\]\(\.\./([\w/]+)\.py\)", row[4])]
    assert len(found) > 15
    for function, file in found:
        module = file.removeprefix("fovconn_env/").replace("/", ".")
        assert callable(getattr(importlib.import_module(f"fovconn_env.{module}"), function))


def test_stages_of_a_step_are_called_as_the_architecture_says():
    chart = re.search(
        r"^## How a step runs\n(.*?)^There is", PAGES["docs/architecture.md"].read_text("utf-8"), re.M | re.S
    )
    stages = re.findall(r"^        [| ]*((?:\w+, )*\w+)  +", chart[1], re.MULTILINE)
    assert len(stages) > 10
    for name in ", ".join(stages).split(", "):
        assert callable(getattr(step, name))
    rooms = re.findall(r"(?:maths|world|onboard)/\w+", chart[1])
    assert len(rooms) > 10
    for room in rooms:
        assert (ROOT / "fovconn_env" / "kernel" / f"{room}.py").is_file()


def test_new_places_in_the_changelog_exist():
    rows = re.findall(r"^\| `[\w.]+` \| `([\w.]+)` \|$", PAGES["CHANGELOG.md"].read_text("utf-8"), re.MULTILINE)
    assert len(rows) > 60
    for module in rows:
        path = ROOT / module.replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file(), module


def test_every_measure_is_defined():
    from fovconn_env.training.evaluation import evaluate, summary

    chosen = scenario(n_agents=2, max_cycles=1, warmup=0.0)
    simulator = Simulator(chosen)
    simulator.reset(0)
    meter = Meter(simulator)
    simulator.step(np.zeros((1, 2, 4)))
    meter.update()
    text = PAGES["docs/metrics.md"].read_text("utf-8")
    parts = re.split(r"^## ", text, flags=re.MULTILINE)
    sections = {part.partition("\n")[0]: named(part) for part in parts}
    assert sections["Of an episode"] == set(meter.results())
    assert sections["Pooled errors"] == set(ERRORS)
    assert sections["Of an evaluation"] == set(summary(evaluate("expert", chosen, [0])))


def test_every_scenario_has_a_card_and_every_reward_term_a_row():
    cards = PAGES["docs/scenarios.md"].read_text("utf-8")
    for name in PRESETS:
        assert f"\n## {name}\n" in cards
        assert f"| `{name}` |" in README
    weights = {field.name for field in dataclasses.fields(scenario().reward)}
    assert set(layout.REWARDS) <= named(PAGES["docs/reward.md"].read_text("utf-8")) <= weights
