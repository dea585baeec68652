"""Options that several commands share, and how what they are given is checked."""

from __future__ import annotations

import ast
import glob
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from fovconn_env import HARD, PRESETS, Recording, Scenario, scenario
from fovconn_env.baselines import ORACLES, POLICIES
from fovconn_env.errors import SettingError, rule
from fovconn_env.files import read_file
from fovconn_env.fleet.ros.foxglove_server import ADDRESS
from fovconn_env.flights.recording import load

OUT = Path("out")
MOST_BYTES = 1 << 20  # of a list of scenarios


def completing(*words: str) -> Callable[[str], list[str]]:
    """What a shell shows for the beginning of a value: these words, and where none fits, files."""

    def complete(begun: str) -> list[str]:
        fit = [word for word in words if word.startswith(begun)]
        return fit or sorted(glob.glob(f"{glob.escape(begun)}*"))

    return complete


ScenarioName = Annotated[
    str,
    typer.Option("--scenario", help="Scenario id: " + ", ".join(PRESETS), autocompletion=completing(*PRESETS, *HARD)),
]
PolicyName = Annotated[
    str,
    typer.Option(
        "--policy",
        help=f"Policy: {', '.join(POLICIES)}; or file.py:Class, model.zip",
        autocompletion=completing(*POLICIES),
    ),
]
PilotName = Annotated[
    str,
    typer.Option(
        "--policy",
        help=f"Policy: {', '.join([*POLICIES, *ORACLES])}; or file.py:Class, model.zip",
        autocompletion=completing(*POLICIES, *ORACLES),
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a scenario setting, e.g. --set n_agents=4; repeatable."),
]
Processes = Annotated[int | None, typer.Option(help="Processes; one a core by default.", min=1)]
RayAddress = Annotated[
    str | None,
    typer.Option(
        "--ray",
        metavar="[ADDRESS]",
        help="Fly on a Ray cluster: auto, HOST:PORT or ray://HOST:PORT; local, or none, starts a Ray on this machine.",
    ),
]
Fresh = Annotated[bool, typer.Option("--fresh", help="Fly all anew, also what the folder has; replace recordings.")]
Replace = Annotated[bool, typer.Option("--fresh", help="Replace the file if there is one.")]
RecordFile = Annotated[Path | None, typer.Option("--record", metavar="FILE", help="Record the flight here, as .npz.")]
Force = Annotated[bool, typer.Option("--force", help="Go on where a recorded flight does not come out as it did.")]
Foxglove = Annotated[bool, typer.Option("--foxglove", help=f"Show it live in Foxglove, which connects to {ADDRESS}.")]
FoxgloveAt = Annotated[
    str | None, typer.Option("--foxglove-at", metavar="HOST:PORT", help="The same at another address.")
]
JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Write what the documentation shows of it here, too, as JSON.")
]


def parse(settings: list[str] | None) -> dict[str, Any]:
    """NAME=VALUE strings as keywords; values are Python literals, anything else a word."""
    changes = {}
    for item in settings or []:
        name, equals, text = item.partition("=")
        if not equals:
            raise SettingError(f"--set must be NAME=VALUE, got {item!r}: for example --set n_agents=4")
        try:
            changes[name] = ast.literal_eval(text)
        except (ValueError, SyntaxError):  # a word, such as quadrotor
            changes[name] = text
    return changes


def check_folder(folder: Path | None, option: str = "--out") -> None:
    """`ValueError` where a folder is asked for and there is a file."""
    if folder is not None and folder.exists() and not folder.is_dir():
        raise SettingError(f"{option} must name a folder, got {str(folder)!r}: it is a file")


def check_writable(files: dict[str, Path | None]) -> None:
    """Files by their option, None if it was not used."""
    given = {option: file for option, file in files.items() if file is not None}
    for option, file in given.items():
        if file.is_dir() or not file.parent.is_dir():
            raise SettingError(
                f"{option} must name a file in an existing folder, got {str(file)!r}: make the folder first"
            )
    for file in given.values():  # fails now rather than after the flights
        existed = file.exists()
        file.touch()
        if not existed:
            file.unlink()


def check_recording(file: Path | None, fresh: bool) -> None:
    """`ValueError` for a recording that cannot be written, or would replace one, before it is flown."""
    if file is not None and file.suffix != ".npz":
        raise SettingError(f"--record must name a file in .npz, got {str(file)!r}: recordings have that ending")
    check_new("--record", [file] if file is not None else [], fresh)
    check_writable({"--record": file})


def check_new(option: str, files: Sequence[Path], fresh: bool) -> None:
    """`ValueError` where flights would be replaced without a word: some cannot be had again."""
    there = [file for file in files if file.exists()]
    if there and not fresh:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        got = f"{option} must not replace flights, got {str(there[0])!r}{more}"
        raise SettingError(f"{got}: name another one, or add --fresh to replace them")


def read_recording(file: Path) -> Recording:
    """A recording with at least one step; raises as `load`."""
    recording = load(file)
    if not len(recording.actions):
        raise SettingError(f"{file} holds no step: nothing was flown")
    return recording


class Task(NamedTuple):
    """A scenario in a training."""

    scenario: Scenario
    weight: float | None = None  # how probable it is that a world flies it; None: not given
    teacher: str | None = None  # the policy that is imitated there


def read_tasks(words: list[str], changes: list[str] | None) -> list[Task]:
    """As `read_scenarios`, where weight=NUMBER and teacher=POLICY may stand behind an id; "@FILE" has one a line.

    In a file, what follows a # is a remark.
    """
    lines: list[str] = []
    for word in words:
        text = (
            read_file(Path(word[1:]), "list of scenarios", MOST_BYTES).decode("utf-8", "replace")
            if word.startswith("@")
            else word
        )
        parts = [part.partition("#")[0].strip() for part in text.split("\n")]
        lines += [part for part in parts if part] or [""]
    return [_read_task(line, parse(changes)) for line in lines]


def _read_task(line: str, common: dict[str, Any]) -> Task:
    name, *own = line.split() or [""]
    settings = parse(own)
    weight, teacher = settings.pop("weight", None), settings.pop("teacher", None)
    number = isinstance(weight, (int, float)) and not isinstance(weight, bool)
    rule(weight is None or number, "weight", f"a number behind {name}", weight, "weight=2")
    rule(
        teacher is None or isinstance(teacher, str),
        "teacher",
        f"a policy's name behind {name}",
        teacher,
        "teacher=follow",
    )
    return Task(scenario(name, **{**common, **settings}), weight, teacher)


def read_scenarios(names: list[str], changes: list[str] | None) -> list[Scenario]:
    """Scenarios from ids, each with settings of its own behind it, and settings for all."""
    common = parse(changes)
    return [scenario(word, **{**common, **parse(own)}) for word, *own in (name.split() or [""] for name in names)]
