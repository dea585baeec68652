"""Models in ONNX, whatever library made them, run by onnxruntime. `learned.graph` writes those of this package.

To open one runs no code of the file. Needs onnxruntime.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import onnxruntime

from fovconn_env.baselines.adapters.model import ROWS, Model, Observed, check_size, in_blocks, opened
from fovconn_env.baselines.learned.cards import BASES
from fovconn_env.baselines.learned.inputs import ACTION, ACTIONS, BASE, MEMORY, NEXT, SPEEDS, STEP, fingerprint
from fovconn_env.errors import rule
from fovconn_env.files import read_file
from fovconn_env.scenarios.scenario import Scenario

MAX_BYTES = 1 << 28  # of a file; one of ours has 130 kB


class OnnxPolicy(Model):
    """A model with one input, observations (R, D) float32, and an output of actions (R, 4), shares in [-1, 1].

    D are the scenario's columns, own ones included. One with a memory has an input `memory` (R, K) more, zeros as a
    flight begins, and an output `next_memory`. What `fovconn export` wrote reads the built-in columns, and says for
    which speeds it is made, and of a correction the law, which flies with it.
    """

    has_memory = False  # unless the model has

    def __init__(self, scenario: Scenario) -> None:
        """Raises `SettingError` for what is no such model, and for one that is made for another scenario."""
        super().__init__(scenario)
        self._session = Session(self.file)
        told = self._session.metadata
        for name in (*SPEEDS, STEP):
            stated, mine = told.get(name), repr(float(getattr(scenario, name)))
            hint = "fovconn export makes it for the scenario that --scenario and --set say"
            rule(stated in (None, mine), f"{name} of {self.file}", f"{mine} as the scenario's", stated, hint)
        meaning, mine = told.get("inputs"), fingerprint()
        hint = "columns, units or scales are others since; export it anew"
        rule(meaning in (None, mine), f"inputs of {self.file}", f"{mine}, as this version has them", meaning, hint)
        law = told.get("base") if BASE in self._session.inputs else None
        rule(law is None or law in BASES, f"base of {self.file}", f"one of {', '.join(BASES)}", law, "written by hand?")
        self._law = BASES[law](scenario) if law else None
        self._observed = Observed(scenario, built_in=meaning is not None)
        self.has_memory = MEMORY in self._session.inputs
        self._rows = self._check_inputs()
        self._outputs = [self._session.output(ACTIONS, alone=not self.has_memory)]
        if self.has_memory:
            self._outputs.append(self._session.output(NEXT, alone=False))
        self._memory = self._blank(0)
        sizes = [self._observed.size] + ([] if self._law is None else [ACTION])
        blank = [np.zeros((self._rows, size), np.float32) for size in sizes]
        actions, *memory = opened(self.file, lambda: self._run(*blank, *self._remembered(self._rows)))
        shape = np.shape(actions)
        rule(shape == (self._rows, ACTION), f"output of {self.file}", "(robots, 4)", shape, "vx, vy, vz, yaw rate")
        for each in memory:
            shape, hint = np.shape(self._blank(self._rows)), "what comes out goes in again"
            rule(each.shape == shape, f"{NEXT} of {self.file}", f"{shape} as {MEMORY}", each.shape, hint)

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        base = [] if self._law is None else [self._law.decide(flat)]
        remembered = self._remembered(len(flat))
        actions, *memory = in_blocks(self._run, self._rows, self._observed(flat), *base, *remembered)
        if memory:
            self._memory = memory[0]
        return np.clip(actions, -1.0, 1.0)

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Clear the memory of all robots, or of those in `mask`, one bool a robot."""
        if mask is None:
            self._memory = self._blank(0)
        elif len(self._memory):
            self._memory = np.where(np.reshape(mask, (-1, 1)), np.float32(0.0), self._memory)

    def _run(self, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(self._session.run(self._outputs, arrays))

    def _remembered(self, count: int) -> list[np.ndarray]:
        """What so many robots remember, (R, K), if they do."""
        if self.has_memory and len(self._memory) != count:
            self._memory = self._blank(count)
        return [self._memory] if self.has_memory else []

    def _blank(self, count: int) -> np.ndarray:
        """The memory of so many robots as a flight begins."""
        _, (_, size) = self._session.inputs.get(MEMORY, ("", (0, 0)))
        return np.zeros((count, size), np.float32)

    def _check_inputs(self) -> int:
        """The rows that go in at a time. `SettingError` for other inputs than observations and what goes with them."""
        inputs = self._session.inputs
        more = [*([] if self._law is None else [BASE]), *([MEMORY] if self.has_memory else [])]
        fine = len(inputs) == 1 + len(more) and [*inputs][1:] == more
        fine = fine and all(kind == "tensor(float)" and len(shape) == 2 for kind, shape in inputs.values())
        fine = fine and (not self.has_memory or isinstance(inputs[MEMORY][1][1], int))
        got = {name: f"{kind} {shape}" for name, (kind, shape) in inputs.items()}
        hint = f"one of float32, and of a fixed number of columns one called {MEMORY!r}, where it has one"
        rule(fine, f"inputs of {self.file}", "observations (robots, columns)", got, hint)
        rows, size = next(iter(inputs.values()))[1]
        if isinstance(size, int):  # else a name: any
            check_size(self.file, (size,), self._observed.size)
        return rows if isinstance(rows, int) else ROWS


class Session:
    """A model that onnxruntime has opened, on one thread. Copies share it, and one that is pickled is opened again."""

    def __init__(self, file: Path, data: bytes | None = None) -> None:
        """data: what the file holds, read if not given."""
        self._made_of = file, data or read_file(file, "ONNX model", MAX_BYTES)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # what is wrong is raised
        words = self._made_of[1], options, ["CPUExecutionProvider"]
        self._session = session = opened(file, lambda: onnxruntime.InferenceSession(*words))
        self.inputs = {each.name: (each.type, each.shape) for each in session.get_inputs()}
        self.metadata: Mapping[str, str] = session.get_modelmeta().custom_metadata_map

    def output(self, name: str, *, alone: bool) -> str:
        """The name of an output: this one, or the only one, if it may be `alone`."""
        names = [each.name for each in self._session.get_outputs()]
        wanted, fine = f"one called {name!r}", name in names or (alone and len(names) == 1)
        wanted = f"one, or {wanted}" if alone else wanted
        rule(fine, f"outputs of {self._made_of[0]}", wanted, names, "which one is it?")
        return name if name in names else names[0]

    def run(self, outputs: list[str], arrays: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        """Outputs for arrays in the order of the inputs."""
        return self._session.run(outputs, dict(zip(self.inputs, arrays, strict=True)))

    def __reduce__(self) -> Any:
        return Session, self._made_of

    def __deepcopy__(self, memo: Any) -> Self:
        return self
