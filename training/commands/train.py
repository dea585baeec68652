"""`fovconn train`: the trainers on the command line. torch is imported when one of them runs."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from fovconn_env import HARD, PRESETS
from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.baselines.learned.cards import BASES
from fovconn_env.baselines.learned.policy import Learned
from fovconn_env.bounds import listed
from fovconn_env.errors import rule
from fovconn_env.training.commands import dataset
from fovconn_env.training.commands.options import OUT, Processes, Task, check_folder, completing, parse, read_tasks
from fovconn_env.training.commands.screen import err, out, progress
from fovconn_env.training.learn.trainings import TRAINERS, Training

if TYPE_CHECKING:
    from fovconn_env.training.learn.learning import Budget

app = typer.Typer(no_args_is_help=True, help="Train policies, and record flights to train from.")
SHIPPED = ", ".join(name for name, kind in POLICIES.items() if issubclass(kind, Learned)) or "none yet"

Scenarios = Annotated[
    list[str] | None,
    typer.Option(
        "--scenario",
        help=f"Scenario id: {', '.join(PRESETS)}; settings may follow in the same word: 'ScaleUp-v0 level=3'. "
        "Repeatable: the worlds are shared out, one policy learns all. With weight=2 behind one, worlds draw what they "
        "fly at each reset; with teacher=follow, DAgger imitates that policy there. @FILE has one a line.  "
        "[default: LeaderFollow-v0]",
        autocompletion=completing(*PRESETS, *HARD),
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a setting of all scenarios, e.g. --set n_agents=4."),
]
Steps = Annotated[
    int | None, typer.Option(help="Length in agent steps (for bc: samples learned from). Repeats bit for bit.")
]
Minutes = Annotated[float | None, typer.Option(help="Length in minutes instead; the schedules follow the clock.")]
Seed = Annotated[
    int, typer.Option(help="Training seed: network, worlds (50000 and up) and order of learning.", min=0, max=2**32 - 1)
]
Seeds = Annotated[
    str | None,
    typer.Option(help="Training seeds instead of one: 0-4 or 0,2,7; each trains in a folder below --out."),
]
Sweep = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Try settings: a grid and ranges of what --tune names, in YAML, by Ray Tune."),
]
Ray = Annotated[
    str | None,
    typer.Option(
        metavar="[ADDRESS]",
        help="Train on a Ray cluster, --seeds or --sweep: auto or HOST:PORT; local, or none, starts a Ray here.",
    ),
]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for policy, card, model.zip, curves, checkpoint.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on from the folder's checkpoint, exactly as without a break.")
]
Anew = Annotated[bool, typer.Option("--fresh", help="Begin anew in a folder that holds a training, which is removed.")]
Kind = Annotated[str, typer.Option("--network", help="set (any team size and order of rows) or mlp (to compare).")]
Tune = Annotated[
    list[str] | None,
    typer.Option(
        "--tune", metavar="NAME=VALUE", help="Change a hyper-parameter; `--tune help` lists them. Repeatable."
    ),
]
Threads = Annotated[int, typer.Option(help="Threads of simulator and torch; more than one on idle cores only.", min=1)]
Scores = Annotated[int, typer.Option(help="How often the policy is scored, and a checkpoint written.", min=1)]
Start = Annotated[
    str | None, typer.Option("--start", help=f"Policy to go on from: a file.safetensors, or one of: {SHIPPED}.")
]
Filtered = Annotated[bool, typer.Option("--safe", help="Train with lambda2-cbf on what is flown.")]


Data = Annotated[list[Path], typer.Option("--data", help="File of `fovconn train record`; repeatable.")]
Base = Annotated[str, typer.Option("--base", help=f"Law to correct: {', '.join(BASES)}.")]

REQUIRED = inspect.Parameter.empty
COMMON = {
    "scenarios": (Scenarios, None),
    "settings": (Changes, None),
    "steps": (Steps, None),
    "minutes": (Minutes, None),
    "seed": (Seed, 0),
    "folder": (Out, None),
    "resume": (Resume, False),
    "fresh": (Anew, False),
    "network": (Kind, "set"),
    "tune": (Tune, None),
    "threads": (Threads, 1),
    "scores": (Scores, 10),
    "seeds": (Seeds, None),
    "sweep": (Sweep, None),
    "ray": (Ray, None),
    "processes": (Processes, None),
}  # name: (option, default)


class Command(NamedTuple):
    """An algorithm on the command line."""

    help: str
    options: Mapping[str, tuple[Any, Any]]  # beside COMMON
    arguments: Callable[[Mapping[str, Any]], dict[str, Any]]  # of a training, from the options


COMMANDS = {
    "dagger": Command(
        """Imitate the expert (or `--tune expert=augmented`) on the states the learner itself gets into.

        fovconn train dagger --steps 20000000 --out out/dagger
        """,
        {"start": (Start, None)},
        lambda given: {"start": start} if (start := _start(given["start"])) else {},
    ),
    "bc": Command(
        """Clone the behaviour in recorded flights; --scenario is what checkpoints are scored on.

        fovconn train record --policy expert --seeds 50000-50063 --out out/expert.npz
        fovconn train bc --data out/expert.npz --steps 10000000 --out out/bc
        """,
        {"data": (Data, REQUIRED)},
        lambda given: {"data": [str(file.resolve()) for file in given["data"]]},
    ),
    "ppo": Command(
        """PPO, one policy for all robots: from scratch, or from a policy that can fly, held near it at first.

        fovconn train ppo --start out/dagger/dagger.safetensors --steps 20000000 --out out/ppo
        """,
        {"start": (Start, None), "filtered": (Filtered, False)},
        lambda given: {"start": _start(given["start"]), "filtered": given["filtered"]},
    ),
    "mappo": Command(
        """PPO with a critic that knows the truth in training; what is trained flies by observations alone.

        fovconn train mappo --scenario LeaderFollow-v0 --scenario Mix-v0 --steps 20000000 --out out/mappo
        """,
        {"start": (Start, None), "filtered": (Filtered, False)},
        lambda given: {"start": _start(given["start"]), "filtered": given["filtered"]},
    ),
    "residual": Command(
        """PPO learns a bounded correction of a law's action; the first policy is the law itself.

        fovconn train residual --steps 4000000 --out out/residual
        """,
        {"base": (Base, "cohesive"), "filtered": (Filtered, False)},
        lambda given: {"filtered": given["filtered"]},
    ),
}


def _command(name: str) -> Callable[..., None]:
    """The command of an algorithm: a function with its options, which typer reads from the signature."""

    def command(**given: Any) -> None:
        _train(name, given)

    options = {**COMMON, **COMMANDS[name].options}
    signature = [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=option)
        for key, (option, default) in options.items()
    ]
    command.__signature__ = inspect.Signature(signature)  # pyright: ignore[reportFunctionMemberAccess]
    command.__annotations__ = {key: option for key, (option, _) in options.items()}
    return command


for _name, _described in COMMANDS.items():
    app.command(_name, help=inspect.cleandoc(_described.help))(_command(_name))


app.command("record")(dataset.command)


# ------------------------------------------------------------------------------------------------------------ common
def _train(name: str, given: Mapping[str, Any]) -> None:
    """Train what the options say: once, from several seeds, or a sweep."""
    from fovconn_env.training.learn.learning import Budget
    from fovconn_env.training.learn.model import Network

    if "help" in (given["tune"] or []):
        for line in [*listed(TRAINERS[name].find(TRAINERS[name].settings)), *listed(Network)]:
            out.print(line.replace(": ", "=", 1), soft_wrap=True)
        return
    budget = Budget(steps=given["steps"], minutes=given["minutes"])
    training = _training(name, given)
    rule(not (given["resume"] and given["fresh"]), "--resume and --fresh", "given one of the two", "both", "not both")
    target = given["folder"] or OUT / name
    check_folder(target)
    if given["seeds"] is not None or given["sweep"] is not None:
        from fovconn_env.training.commands.sweeps import sweep

        words = [word.partition("=")[0] for word in given["tune"] or []]
        sweep(training, budget, target, words, given)
        return
    for option in ("ray", "processes"):
        rule(
            given[option] is None, f"--{option}", "given with --seeds or --sweep", given[option], "one training is one"
        )
    _train_once(training, budget, target, given)


def _training(name: str, given: Mapping[str, Any]) -> Training:
    """The training that the options describe."""
    from fovconn_env.training.learn.model import Network

    tasks = read_tasks(given["scenarios"] or ["LeaderFollow-v0"], given["settings"])
    words: list[str] = [*([f"base={given['base']}"] if "base" in given else []), *(given["tune"] or [])]
    settings, network = tuned(TRAINERS[name].find(TRAINERS[name].settings), Network, words, given["network"])
    arguments = COMMANDS[name].arguments(given) | _drawn(name, tasks, settings)
    flown = tuple(task.scenario for task in tasks)
    return Training(name, flown, given["seed"], settings, network, given["threads"], arguments)


def _drawn(name: str, tasks: Sequence[Task], settings: Any) -> dict[str, Any]:
    """Weights and teachers of the tasks, as far as any are given."""
    weights, teachers = [task.weight for task in tasks], [task.teacher for task in tasks]
    arguments: dict[str, Any] = {}
    if any(weight is not None for weight in weights):
        rule(name != "bc", "weight", "given to what flies", weights, "bc learns from the flights in its data")
        arguments["weights"] = [1.0 if weight is None else float(weight) for weight in weights]
    if any(teacher is not None for teacher in teachers):
        rule(name == "dagger", "teacher", "given to dagger", teachers, f"{name} imitates nobody")
        arguments["teachers"] = [teacher or settings.expert for teacher in teachers]
    return arguments


def _train_once(training: Training, budget: Budget, target: Path, given: Mapping[str, Any]) -> None:
    """One training under a progress bar."""
    from fovconn_env.training.learn.learning import train

    name = training.name
    with progress() as bar:
        task = bar.add_task("loading (compiles once, 15 s)", total=1.0)
        best = train(
            training.make(),
            budget,
            target,
            resume=given["resume"],
            fresh=given["fresh"],
            scores=given["scores"],
            say=lambda line: None if err.is_terminal else err.print(line, highlight=False, soft_wrap=True),
            progress=lambda share, text: bar.update(task, completed=share, description=text or name),
        )
    shown = ", ".join(f"{key} {value:.3g}" for key, value in best.items() if key not in ("worth", "steps"))
    line = f"wrote {target}/{name}.safetensors, of step {best.get('steps', 0)}: {shown}"
    out.print(line, highlight=False, soft_wrap=True)


def tuned(kind: type, network: type, words: list[str], network_kind: str) -> tuple[Any, Any]:
    """Settings of the algorithm and of its network from NAME=VALUE words."""
    mine, nets = ({field.name: field for field in dataclasses.fields(part)} for part in (kind, network))
    hyper: dict[str, Any] = {}
    net: dict[str, Any] = {}
    for word in words:
        name, equals, _ = word.partition("=")
        known = ", ".join([*mine, *nets])
        rule(bool(equals) and (name in mine or name in nets), "--tune", f"NAME=VALUE of {known}", word, "--tune help")
        (hyper if name in mine else net)[name] = parse([word])[name]
    return kind(**hyper), network(**{"kind": network_kind, **net})


def _start(name: str | None) -> Path | None:
    if name is None:
        return None
    kind = find_policy(name)
    rule(issubclass(kind, Learned), "--start", "a learned policy", name, f"a file.safetensors, or one of: {SHIPPED}")
    file = getattr(kind, "file", None)
    return file.resolve() if file is not None else None
