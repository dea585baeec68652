"""`fovconn export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fovconn_env import scenario
from fovconn_env.baselines import find_policy
from fovconn_env.baselines.learned.policy import Learned
from fovconn_env.errors import missing_package, rule
from fovconn_env.files import write_files
from fovconn_env.training.commands.options import ScenarioName, Settings, check_writable, parse
from fovconn_env.training.commands.screen import out, say_written


def command(
    policy: Annotated[str, typer.Argument(metavar="POLICY", help="A learned policy: its name, or file.safetensors.")],
    file: Annotated[Path, typer.Option("--onnx", metavar="FILE", help="Write it here, in ONNX.")],
    scenario_name: ScenarioName = "LeaderFollow-v0",
    settings: Settings = None,
) -> None:
    """Write a learned policy as an ONNX file, which a robot's computer runs with onnxruntime alone.

    It is made for the observations and speeds of a scenario: flat observations go in, a row a robot; shares come out.
    """
    kind, task = find_policy(policy), scenario(scenario_name, **parse(settings))
    hint = "a name, or file.safetensors; a law has no network"
    rule(issubclass(kind, Learned), "policy", "a learned one of this package", policy, hint)
    rule(file.suffix == ".onnx", "--onnx", "a file in .onnx", str(file), "--policy knows it by that ending")
    check_writable({"--onnx": file})
    try:
        from fovconn_env.baselines.learned.graph import to_onnx
    except ModuleNotFoundError as problem:
        raise missing_package("fovconn export", problem) or problem from problem
    made = kind(task)
    assert isinstance(made, Learned)
    model = to_onnx(made)
    write_files({file: model.SerializeToString()})
    for word, values in (("input", model.graph.input), ("output", model.graph.output)):
        for value in values:
            sizes = [part.dim_param or str(part.dim_value) for part in value.type.tensor_type.shape.dim]
            out.print(f"{word} {value.name} ({', '.join(sizes)})")
    if made.card.base:
        out.print(f"base_actions are those of {made.card.base}, which the file does not hold")
    say_written([file])
