"""How `fovconn` ends when something goes wrong: one line for what the user can put right, else a traceback."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from fovconn_env import LEVELS, PRESETS, files, fovconn_v0
from fovconn_env.baselines import ORACLES, POLICIES
from fovconn_env.errors import EXTRAS, FovconnError, MachineError, MissingPackage, PolicyError, SettingTypeError
from fovconn_env.flights import recording
from fovconn_env.scenarios.hard import TASKS
from fovconn_env.training.commands import bench

ROOT = Path(__file__).parents[2]
TINY = ("--set", "n_agents=3", "--set", "max_cycles=4", "--set", "warmup=0.1")
FLY = ("train", "record", "--seeds", "0", *TINY, "--out", "flights.npz")
ERRORS = ("ValueError", "TypeError", "KeyError", "OverflowError", "MemoryError", "RecursionError", "FileNotFoundError")
MINE = """\
from fovconn_env.baselines import Policy

class Mine(Policy):
    def decide(self, flat):
        return self.helper()

    def helper(self):
        raise {error}
"""


def failing(error):
    """A function that seems to be of this package and raises an error."""
    space = {"__name__": "fovconn_env.somewhere"}
    exec(f"def fail(*_, **__):\n    raise {error}", space)
    return space["fail"]


def one_line(shown, *parts):
    """The command has ended with status 2 and one line that has these parts."""
    assert shown.status == 2
    assert shown.out == ""
    last = shown.err.rstrip("\n").splitlines()[-1]
    assert last.startswith("fovconn: ")
    assert "Traceback" not in shown.err
    for part in parts:
        assert part in last


def traceback_below(shown, sentence, last):
    """The command has ended with status 1: the sentence, then a traceback that ends with this line."""
    assert shown.status == 1
    lines = shown.err.rstrip("\n").splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("fovconn: "))
    assert sentence in lines[first]
    assert lines[first + 1].startswith("Traceback")
    assert last in shown.err[shown.err.index("Traceback") :]


@pytest.mark.parametrize("kind", [*ERRORS, "SettingError"])
def test_the_users_own_code_fails(kind, fovconn, tmp_path):
    """Type, file and line of the user's code are visible, also where it raises this package's own error."""
    imports = "from fovconn_env.errors import SettingError\n" if kind == "SettingError" else ""
    (tmp_path / "mine.py").write_text(imports + MINE.format(error=f"{kind}('of mine')"))
    shown = fovconn(*FLY, "--policy", "mine.py:Mine")
    sentence = f"your own code failed, at {tmp_path}/mine.py:{8 + bool(imports)} in helper: policy Mine failed on "
    traceback_below(shown, sentence, "SettingError: of mine" if imports else f"{kind}: ")
    assert "raise" in shown.err, "the line itself"


@pytest.mark.parametrize("where", ["__init__", "the module"])
def test_the_users_own_code_fails_before_the_flight(where, fovconn, tmp_path):
    text = MINE.format(error="IndexError") + "    def __init__(self, scenario):\n        open('weights.bin')\n"
    (tmp_path / "mine.py").write_text("open('weights.bin')" if where == "the module" else text)
    shown = fovconn(*FLY, "--policy", "mine.py:Mine")
    traceback_below(shown, f"your own code failed, at {tmp_path}/mine.py:", "FileNotFoundError: [Errno 2]")


def test_the_users_own_code_fails_in_another_process(fovconn, tmp_path):
    (tmp_path / "mine.py").write_text(MINE.format(error="IndexError('of mine')"))
    shown = fovconn("eval", "--policy", "mine.py:Mine", "--seeds", "0-1", *TINY, "--processes", "1")
    traceback_below(shown, f"your own code failed, at {tmp_path}/mine.py:8 in helper: ", "IndexError: of mine")


@pytest.mark.parametrize("kind", [*ERRORS, "AssertionError", "NotImplementedError"])
def test_our_own_code_fails(kind, fovconn, monkeypatch):
    monkeypatch.setattr(bench, "agenda", failing(f"{kind}('of ours')"))
    sentence = "the memory is full" if kind == "MemoryError" else "a fault of fovconn_env "
    traceback_below(fovconn("bench", "--quick"), sentence, f"{kind}: ")


@pytest.mark.parametrize("kind", FovconnError.__subclasses__())
def test_what_the_user_can_put_right_is_one_line(kind, fovconn, monkeypatch):
    def refuse(*_):
        raise kind("n_agents must be [/red] at least 2")

    monkeypatch.setattr(bench, "agenda", refuse)
    one_line(fovconn("bench", "--quick"), "n_agents must be [/red] at least 2")


def test_errors_keep_the_types_that_python_code_catches():
    for kind in (files.OtherKind, files.Damaged, recording.OtherVersion, recording.Diverged, SettingTypeError):
        assert issubclass(kind, FovconnError)
        assert issubclass(kind, ValueError)
    assert issubclass(SettingTypeError, TypeError)
    assert issubclass(MachineError, OSError)
    assert issubclass(MissingPackage, ImportError)
    assert issubclass(PolicyError, ValueError)
    assert not issubclass(PolicyError, FovconnError)
    with pytest.raises(TypeError, match="unexpected keyword"):
        fovconn_v0.parallel_env(n_agent=3)


@pytest.mark.parametrize(
    "words, path",
    [
        (("replay", "no.npz"), "no.npz"),
        (("replay", "."), "."),
        (("replay", "a/b"), "a/b"),
        (("train", "record", "--out", "a/b.npz"), "a"),
        (("eval", "--out", "a/b"), "a/b"),
        (("demo", "--out", "a/b"), "a/b"),
        (("demo", "--out", "a"), "--out must name a folder"),
        (("eval", "--seeds", "0-99999999999"), "seeds must be at most 1000000"),
        (("figures", "--map", "no.json"), "no.json"),
        (("bench", "--quick", "--json", "/dev/full"), "/dev/full"),
    ],
)
def test_a_path_that_cannot_be_used_is_named(words, path, fovconn, tmp_path, monkeypatch):
    (tmp_path / "a").write_text("a file")
    monkeypatch.setattr(bench, "_alone", lambda *_: {})
    one_line(fovconn(*words), path)


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_any_encoding_of_the_terminal_will_do(encoding, tmp_path):
    variables = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "fovconn_env.training.cli", "scenarios"]
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert b"Corridor-v0" in done.stdout


def test_what_is_refused_has_an_error_of_its_own():
    """No plain ValueError, TypeError or OSError is raised outside of what reads bytes and what compiles."""
    sources = [file for room in ("fovconn_env", "baselines", "training") for file in (ROOT / room).rglob("*.py")]
    assert len(sources) > 200
    plain = set()
    for file in sources:
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            raised = node.exc.func if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) else None
            if isinstance(raised, ast.Name) and raised.id in ("ValueError", "TypeError", "OSError", "Exception"):
                plain.add(file.name)
    assert plain <= {"npz.py", "jit.py"}


def test_a_full_disk_names_the_file_that_was_to_be_written(fovconn, monkeypatch):
    monkeypatch.setattr(os, "fsync", failing("OSError(28, 'No space left on device')"))
    one_line(fovconn(*FLY), "No space left on device", "flights.npz")


# ------------------------------------------------------------------------------------------------ what is not installed
IMPORTED = {"pillow": "PIL", "pygame-ce": "pygame", "stable-baselines3": "stable_baselines3", "rerun-sdk": "rerun"}
IMPORTED["sb3-contrib"] = "sb3_contrib"
IMPORTED["sb3-contrib"] = "sb3_contrib"


def test_every_package_of_an_extra_is_known():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    for extra in ("cli", "render", "export", "rerun", "onnx", "learn"):
        packages = {re.match(r"[\w-]+", line)[0] for line in extras[extra]} - {"fovconn-env"}
        assert {IMPORTED.get(name, name) for name in packages} == {name for name in EXTRAS if EXTRAS[name] == extra}


def test_a_base_install_flies_and_says_what_the_command_needs(tmp_path):
    """No package of an extra can be imported: environments and policies work, any call of the command is one line."""
    program = """if True:
        import sys
        from fovconn_env.errors import EXTRAS
        sys.modules.update(dict.fromkeys(EXTRAS))
        import fovconn_env
        from fovconn_env.baselines import load_policy
        env = fovconn_env.parallel_env(n_agents=3, warmup=0.1)
        load_policy("residual", env)
        env.reset(seed=0)
        from fovconn_env.training.cli import main
        main()
    """
    command = [sys.executable, "-c", program, "--version"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1] == 'fovconn: fovconn needs typer: pip install "fovconn-env[cli]"'
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "package, words",
    [
        ("torch", ("train", "dagger", "--steps", "10")),
        ("pygame", ("play",)),
        ("matplotlib", ("demo",)),
        ("av", ("replay", "flight.npz", "--out", "flight.mp4")),
        ("rerun", ("replay", "flight.npz", "--out", "flight.rrd")),
    ],
)
def test_what_needs_an_extra_names_it(package, words, fovconn, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "fovconn_env.training.play.app", raising=False)
    one_line(fovconn(*words), f"needs {package}: pip install", EXTRAS[package])


# ---------------------------------------------------------------------------------------------------- what there is
def test_the_lists_have_all_there_is(fovconn):
    shown, known = fovconn("scenarios"), fovconn("policies")
    assert shown.status == known.status == 0
    lines = shown.out.splitlines()
    readme = (ROOT / "README.md").read_text("utf-8")
    for name in PRESETS:
        [line] = [line for line in lines if line.startswith(f"  {name} ")]
        assert (f"levels 1-{len(LEVELS.get(name, ())) + 1}" in line) == (name in LEVELS)
        summary = re.search(rf"^\| `{name}` \| (.*) \|$", readme, re.MULTILINE)[1]
        assert line.endswith(f"  {summary}")
    for name in (*POLICIES, *ORACLES):
        [line] = [line for line in known.out.splitlines() if line.startswith(f"  {name} ")]
        assert line.rstrip().endswith(".")
    assert [line.split()[0] for line in lines[lines.index("suites") + 1 :][:3]] == ["quick", "full", "hard-v1"]
    for name, task in TASKS.items():
        [line] = [line for line in lines if line.startswith(f"  {name} ")]
        assert line.endswith(f"  {task.summary}")
