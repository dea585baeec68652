"""Robot processes of one machine: started, looked after, and ended."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Mapping, Sequence
from typing import Any

ENDING = 0.6  # s, in which a process ends by itself, and again when it is asked to


class Crew:
    """A process for each robot. As a context manager it leaves none behind."""

    def __init__(self, commands: Mapping[str, Sequence[str]], **options: Any) -> None:
        """commands: of each robot, by name; options: of `subprocess.Popen`."""
        self._commands, self._options = dict(commands), options
        self.processes: dict[str, subprocess.Popen] = {}

    def __enter__(self) -> Crew:
        for name in self._commands:
            self.start(name)
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(self, name: str) -> None:
        """Start a robot, or start it again."""
        # a session of its own: Ctrl-C reaches the world alone, which tells the robots
        self.processes[name] = subprocess.Popen(self._commands[name], start_new_session=True, **self._options)

    def ended(self) -> dict[str, int]:
        """The status of those that have ended, by name."""
        return {name: each.returncode for name, each in self.processes.items() if each.poll() is not None}

    def end(self) -> None:
        """Wait a little for all to end, then make them; also one that is frozen."""
        for make in (lambda each: None, subprocess.Popen.terminate, subprocess.Popen.kill):
            for each in self.processes.values():
                if each.poll() is None:
                    make(each)
            until = time.monotonic() + ENDING
            for each in self.processes.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    each.wait(max(until - time.monotonic(), 0.0))
            if len(self.ended()) == len(self.processes):
                return
