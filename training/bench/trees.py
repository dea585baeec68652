"""Comparison of two trees of this project: a program runs in a process for each tree, on the tree's own code.

    python -m fovconn_env.training.bench.trees --baseline ../other

flies every level that both trees have, with several policies, and compares hashes of the state and of what the robots
got.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import fovconn_env
from fovconn_env.errors import SettingError

HERE = Path(fovconn_env.__file__).resolve().parents[1]  # the checkout; an installed one is found by a link
LAWS = ("expert", "cohesive", "follow", "springs", "residual")
EVERY = 100  # steps between two hashes

# Names that a program may use, found in this tree's rooms or in those of 0.1.0 (commit 66e4a23).
PRELUDE = """
import hashlib, inspect, json, sys
import numpy as np
import fovconn_env
from fovconn_env import LEVELS, PRESETS, Simulator, scenario
try:
    from fovconn_env.baselines import POLICIES, find_policy, load_policy
    from fovconn_env.envs.vector import VectorEnv
    from fovconn_env.flights.recording import state_hash as _state_hash
except ImportError:
    from baselines import POLICIES, find_policy, load_policy
    from fovconn_env.recording import state_hash as _state_hash
    from fovconn_env.vector import VectorEnv
_OLD = {"format": 1} if "format" in inspect.signature(_state_hash).parameters else {}

def state_hash(simulator):
    '''As 0.1.0 hashed a state.'''
    return _state_hash(simulator, **_OLD)

arguments = json.loads(sys.stdin.readline())
"""

FLY = """
INFOS = '''lambda2 lambda2_hat connected n_edges min_distance clearance yaw_error success collision disconnected
lost_link_cause bytes_sent neighbors_dropped alive'''.split() + [
    'reward_' + name for name in 'connectivity progress proximity effort success collision disconnected'.split()
]  # of 0.1.0: later ones are no difference

def fly(name, level, policy, seed, every):
    chosen = scenario(name, level=level)
    kind = find_policy(policy)
    simulator = Simulator(kind.equip(chosen), starts=chosen)
    pilot = kind(simulator.scenario)
    observations, hashes, step = simulator.reset(seed), [], 0
    got = hashlib.sha256()
    while True:
        infos = [simulator.infos[name] for name in INFOS]
        for array in (observations, simulator.rewards, *infos):
            got.update(np.ascontiguousarray(array).view(np.uint8).data)
        if step % every == 0 or simulator.over[0]:
            hashes.append([step, state_hash(simulator), got.hexdigest()])
        if simulator.over[0]:
            return hashes
        observations = simulator.step(pilot.act(observations))
        step += 1

for cell in arguments["cells"]:
    if cell[0] in PRESETS and cell[1] <= len(LEVELS.get(cell[0], ())) + 1:
        print(json.dumps([cell, fly(*cell, arguments["seed"], arguments["every"])]), flush=True)
"""


class Cell(NamedTuple):
    """One flight: a level of a scenario, and a policy."""

    scenario: str
    level: int
    policy: str


class Difference(NamedTuple):
    """A flight with different results: `since` is the last equal step, -1 for none."""

    cell: Cell
    since: int


class Pipes(NamedTuple):
    """Input and output of a running program, lines of text."""

    stdin: IO[str]
    stdout: IO[str]

    def ask(self, question: Any) -> Any:
        """The program's answer, one line of JSON each way."""
        self.stdin.write(json.dumps(question) + "\n")
        return self.read()

    def read(self) -> Any:
        """The next line, as JSON; `EOFError` if the program has ended."""
        line = self.stdout.readline()
        if not line:
            raise EOFError("the program ended")
        return json.loads(line)


def check_tree(tree: Path) -> None:
    """`SettingError` for a folder that is no tree of this project."""
    if not (tree / "fovconn_env").is_dir():
        raise SettingError(f"--baseline must be a checkout of this project, got {str(tree)!r}: it has no fovconn_env")


@contextmanager
def running(tree: Path, program: str, arguments: Any) -> Iterator[Pipes]:
    """Run a program in a tree, which finds `arguments` (as JSON gives them back) under that name; wait for its end.

    Raises `ValueError` if the tree is none of this project, `RuntimeError` with what the program said if it fails.
    """
    check_tree(tree)
    variables = {**os.environ, "PYTHONPATH": str(tree.resolve())}
    command = [sys.executable, "-P", "-c", textwrap.dedent(PRELUDE) + textwrap.dedent(program)]
    with tempfile.TemporaryFile("w+", encoding="utf-8") as errors:
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        with subprocess.Popen(command, env=variables, text=True, bufsize=1, **pipes) as task:
            assert task.stdin is not None
            assert task.stdout is not None
            try:
                task.stdin.write(json.dumps(arguments) + "\n")
                yield Pipes(task.stdin, task.stdout)
                task.stdin.close()
            except (BrokenPipeError, EOFError):
                if task.wait() == 0:  # else it said why
                    raise
            except BaseException:  # an interruption: nobody listens to it any more
                task.kill()
                raise
            if task.wait():
                errors.seek(0)
                raise RuntimeError(f"a program failed in {tree}:\n{errors.read()[-2000:]}")


def run_in(tree: Path, program: str, arguments: Any) -> Iterator[str]:
    """Lines that a program prints in a tree; `arguments` and what it raises as in `running`."""
    with running(tree, program, arguments) as pipes:
        yield from pipes.stdout


def cells(policies: Sequence[str]) -> list[Cell]:
    """Every level of every scenario with each of the policies."""
    from fovconn_env import LEVELS, PRESETS

    levels = [(name, level) for name in PRESETS for level in range(1, len(LEVELS.get(name, ())) + 2)]
    return [Cell(name, level, policy) for name, level in levels for policy in policies]


def compare(baseline: Path, chosen: Sequence[Cell], seed: int = 0) -> Iterator[Difference | Cell]:
    """Fly each cell in this tree and in the other; yields the cell if all hashes are equal, else the difference.

    A level that one of them does not have is left out.
    """
    arguments = {"cells": chosen, "seed": seed, "every": EVERY}
    with ThreadPoolExecutor(2) as pool:
        own, other = pool.map(lambda tree: list(run_in(tree, FLY, arguments)), (HERE, baseline))
    flown = [{Cell(*cell): hashes for cell, hashes in map(json.loads, lines)} for lines in (own, other)]
    for cell in flown[0]:
        if cell in flown[1]:
            ours, theirs = (hashes[cell] for hashes in flown)
            same = [a[0] for a, b in zip(ours, theirs, strict=False) if a == b]
            yield cell if ours == theirs else Difference(cell, same[-1] if same else -1)


def main() -> None:
    """Compare the trees, print the differences, and exit with 1 if there are any."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--baseline", type=Path, required=True, metavar="PATH", help="Another tree of this project.")
    parser.add_argument("--policy", action="append", help=f"Instead of {', '.join(LAWS)}, dagger and ppo; repeatable.")
    parser.add_argument("--scenario", help="This one alone.")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    policies = given.policy or [*LAWS, "dagger", "ppo"]
    chosen = [cell for cell in cells(policies) if given.scenario in (None, cell.scenario)]
    results = list(compare(given.baseline, chosen, given.seed))
    differences = [result for result in results if isinstance(result, Difference)]
    for cell, since in differences:
        print(f"differs: {cell.scenario} level {cell.level}, {cell.policy}: equal until step {since}")
    print(f"{len(results) - len(differences)} of {len(results)} flights are equal, bit for bit")
    sys.exit(bool(differences))


if __name__ == "__main__":
    main()
