"""Policies of one's own, from files: what is beside them, what they consist of, functions, and where they fail."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.baselines import Policy, find_policy, load_policy, source_files
from fovconn_env.flights.rollout import rollout
from fovconn_env.training.evaluation import evaluate
from tests.helpers import small

CONSTANT = """
import numpy as np
from fovconn_env.baselines import Policy
from helper import GAIN

class Mine(Policy):
    def decide(self, flat):
        return np.full((len(flat), 4), GAIN, np.float32)
"""


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write files below the working folder, which is not in `sys.path`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])

    def put(files=(), **modules):
        for name, text in {**dict(files), **{f"{name}.py": text for name, text in modules.items()}}.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    return put


def gain(name):
    policy = load_policy(name, small())
    actions = policy.act(np.zeros((4, policy.scenario.observation_size)))
    assert (actions == actions[0, 0]).all()
    return float(actions[0, 0])


# ---------------------------------------------------------------------------------------------- beside the file
def test_a_file_imports_what_is_beside_it(write):
    write(mine=CONSTANT, helper="GAIN = 0.25")
    before = list(sys.path)
    assert gain("mine.py") == 0.25
    assert gain(Path("mine.py")) == 0.25
    assert sys.path == before
    assert "helper" not in sys.modules


def test_two_folders_with_a_helper_each_do_not_mix(write):
    write({"a/mine.py": CONSTANT, "a/helper.py": "GAIN = 0.25", "b/mine.py": CONSTANT, "b/helper.py": "GAIN = 0.5"})
    assert [gain("a/mine.py"), gain("b/mine.py"), gain("a/mine.py")] == [0.25, 0.5, 0.25]


def test_a_file_shadows_nobody_elses_module(write):
    """`helper` and even `json` beside a policy are the policy's alone."""
    write(mine=CONSTANT + "\nimport json\nassert json.HERE\n", helper="GAIN = 0.25", json="HERE = True")
    assert gain("mine.py") == 0.25
    import json

    assert json.loads("[1]") == [1]
    with pytest.raises(ModuleNotFoundError):
        __import__("helper")


def test_imports_within_functions_relative_ones_and_packages(write):
    write(
        {
            "parts/__init__.py": "",
            "parts/gains.py": "from parts.more import MORE\nGAIN = 2 * MORE",
            "parts/more.py": "from . import gains\nMORE = 0.125",
        },
        late="LATE = 0.5",
        mine="""
import numpy as np
from fovconn_env.baselines import Policy
import parts.gains
from .parts import more

class Mine(Policy):
    def decide(self, flat):
        import late
        return np.full((len(flat), 4), parts.gains.GAIN + more.MORE + late.LATE, np.float32)
""",
    )
    assert gain("mine.py") == 0.875
    names = [file.name for file in source_files(find_policy("mine.py"))]
    assert sorted(names) == ["__init__.py", "gains.py", "late.py", "mine.py", "more.py"]


def test_a_package_of_the_working_folder(write):
    write({"pk/__init__.py": "", "pk/mine.py": CONSTANT.replace("helper", "pk.helper"), "pk/helper.py": "GAIN = 0.25"})
    assert gain("pk.mine:Mine") == 0.25
    Path("plain").mkdir()
    for name in ("pk.yours", "pk", "park", "plain"):
        with pytest.raises(ValueError, match=rf"there is no module {name}$|policy class of {name}, got 'Mine'"):
            find_policy(f"{name}:Mine")
    assert "pk" not in sys.modules


def test_what_python_finds_itself_is_not_loaded_twice(write, monkeypatch, tmp_path):
    """With the folder in `sys.path`, the policy's helper is the one that everybody else gets."""
    write(
        shared_helper="GAIN = 0.25\nTABLE = {}",
        mine=CONSTANT.replace("from helper import GAIN", "from shared_helper import GAIN, TABLE"),
    )
    monkeypatch.syspath_prepend(tmp_path)
    import shared_helper

    assert sys.modules[find_policy("mine.py").__module__].TABLE is shared_helper.TABLE
    assert tmp_path / "shared_helper.py" in source_files(find_policy("mine.py"))


def test_a_change_beside_the_file_is_seen(write):
    """Also one within a second that leaves the size; and a file that did not load is tried again."""
    write(mine=CONSTANT, helper="GAIN = 0.25", other=CONSTANT)
    assert gain("mine.py") == gain("other.py") == 0.25
    write(helper="GAIN = 0.50")
    assert gain("mine.py") == gain("other.py") == 0.5
    write(helper="GAIN = 1 / 0")
    with pytest.raises(ValueError, match="ZeroDivisionError"):
        find_policy("mine.py")
    write(helper="GAIN = 0.75")
    assert gain("mine.py") == 0.75


def test_a_file_runs_once_in_a_process(write):
    write(mine=CONSTANT, helper="from pathlib import Path\nwith Path('runs').open('a') as f: f.write('x')\nGAIN = 0.5")
    kinds = {find_policy(name) for name in ("mine.py", "mine.py:Mine", Path("mine.py").absolute(), "safe:mine.py:Mine")}
    assert len(kinds) == 2
    assert Path("runs").read_text() == "x"


# ------------------------------------------------------------------------------------- what a policy consists of
def test_source_files(write):
    write(mine=CONSTANT, helper="GAIN = 0.25\nimport numpy, json, fovconn_env", unused="")
    mine = find_policy("mine.py")
    assert source_files(mine) == [Path("mine.py").absolute(), Path("helper.py").absolute()]
    assert source_files(find_policy("safe:mine.py")) == source_files(mine)
    assert source_files(find_policy("expert")) == []
    assert [file.name for file in source_files(find_policy("safe:dagger"))] == ["dagger.safetensors", "dagger.json"]


# ------------------------------------------------------------------------------------------------------ functions
FUNCTION = """
import numpy as np
def act(flat):
    "Half speed."
    return np.full((len(flat), 4), 0.5, np.float32)
def other(flat):
    return act(flat) / 2
"""


def test_a_function_is_a_policy(write):
    write(half=FUNCTION)
    assert gain("half.py") == gain("half.py:act") == 0.5
    assert gain("half.py:other") == 0.25
    assert [find_policy(name).__name__ for name in ("half.py", "half.py:other")] == ["half", "other"]
    assert source_files(find_policy("half.py")) == [Path("half.py").absolute()]
    assert gain(lambda flat: np.ones((len(flat), 4), np.float32)) == 1.0
    with pytest.raises(ValueError, match="must be a policy class or a function, got 7"):
        find_policy(7)
    with pytest.raises(ValueError, match="must be a policy class or a function"):
        find_policy(dict)


def test_an_object_that_is_called_starts_anew_with_each_policy():
    class Counter:
        count = 0

        def __call__(self, flat):
            self.count += 1
            return np.full((len(flat), 4), self.count / 8, np.float32)

    counter = Counter()
    assert gain(counter) == gain(counter) == 1 / 8
    policy, team = load_policy(counter, small()), np.zeros((4, small().observation_size))
    for _ in range(2):
        policy.reset()
        assert [policy.act(team)[0, 0] for _ in range(2)] == [1 / 8, 2 / 8]


def test_functions_and_files_are_evaluated(write):
    write(half=FUNCTION)
    task = small(max_cycles=3)
    name, path, function = (
        evaluate(policy, task, [5]) for policy in ("half.py", Path("half.py"), find_policy("half.py:other").original[0])
    )
    assert [name.policy, path.policy, function.policy] == ["half", "half", "other"]
    assert name.episodes["mean_speed"] == path.episodes["mean_speed"] != function.episodes["mean_speed"]


def test_compiled_code_in_a_file_of_ones_own(write):
    """numba, and the kernels' own decorator, find the globals of such a module."""
    write(
        mine="""
import numba
import numpy as np
from fovconn_env.baselines import Policy
from fovconn_env.kernel.jit import entry
from helper import GAIN

@numba.njit
def double(x):
    return 2.0 * x

@entry
def fill(out):
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = abs(-double(GAIN))

class Mine(Policy):
    def decide(self, flat):
        actions = np.empty((len(flat), 4), np.float32)
        fill(actions)
        return actions
""",
        helper="GAIN = 0.25",
    )
    assert gain("mine.py") == 0.5


# ------------------------------------------------------------------------------------------------- where it fails
@pytest.mark.parametrize(
    "text, says",
    {
        "import numpy as np\nGAIN = np.zeros(3) + np.zeros(4)": r"ValueError: operands .*helper\.py:2\b",
        "\n\nGAIN = missing": r"NameError: name 'missing' .*helper\.py:3\b",
        "\nGAIN = (": r"SyntaxError: .*helper\.py:2\b",
        "import sys\nsys.exit(0)": r"SystemExit: 0 \(.*helper\.py:2\b",
        "import no_such_module": r"ModuleNotFoundError: .*'no_such_module' .*helper\.py:1\b",
    }.items(),
)
def test_a_file_that_does_not_load_says_where(text, says, write):
    write(mine=CONSTANT, helper=text)
    with pytest.raises(ValueError, match=rf"policy 'mine\.py' must load, got {says}"):
        find_policy("mine.py")


def test_a_law_that_fails_says_where(write):
    write(mine=CONSTANT.replace("GAIN, np.float32", "half(GAIN)").replace("import GAIN", "import GAIN, half"))
    write(helper="import numpy as np\nGAIN = 0.25\ndef half(x):\n    return np.ones(3) @ np.ones(4)")
    with pytest.raises(ValueError, match=r"policy Mine failed on .* in step 0: ValueError: matmul.*helper\.py:4\b"):
        list(rollout(find_policy("mine.py"), small(), [0]))


# -------------------------------------------------------------------------------------------------- other processes
PICKLED = (
    CONSTANT.replace("from helper import GAIN", "from helper import GAIN, Table")
    + """
    def __init__(self, scenario):
        super().__init__(scenario)
        self.table = Table()
"""
)


def test_an_own_policy_is_unpickled_in_another_process(write):
    write({"my-policy.v2.py": PICKLED}, helper="GAIN = 0.25\nclass Table: pass")
    policy = load_policy("my-policy.v2.py", small())
    Path("policy.pickle").write_bytes(pickle.dumps(policy))
    program = (
        "import pickle, numpy; from pathlib import Path\n"
        "policy = pickle.loads(Path('policy.pickle').read_bytes())\n"
        "print(type(policy.table).__name__, policy.decide(numpy.zeros((1, policy.scenario.observation_size))).max())"
    )
    paths = os.pathsep.join(path for path in sys.path if path)
    done = subprocess.run([sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": paths}, capture_output=True)
    assert done.stdout.split() == [b"Table", b"0.25"], done.stderr


def test_the_class_is_the_same_after_pickle(write):
    write(mine=CONSTANT, helper="GAIN = 0.25")
    for name in ("mine.py", "safe:mine.py", "dagger", "safe:dagger", "expert"):
        kind = find_policy(name)
        assert pickle.loads(pickle.dumps(kind)) is kind
        assert issubclass(kind, Policy)
        assert type(pickle.loads(pickle.dumps(kind(kind.equip(scenario()))))) is kind
