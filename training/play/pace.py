"""Number of steps that are due, and a check that the computer is fast enough."""

from __future__ import annotations

import math

MOST = 0.2  # s of the flight between two pictures at most; further steps are dropped, and reported
_MEMORY = 1.0  # s over which the pace is measured
_SLOW = 0.95  # share of the wanted pace below which it is reported


class Pace:
    """Turns the time between pictures into steps of `step_time`, s."""

    def __init__(self, step_time: float) -> None:
        self._step_time, self._most = step_time, max(1, round(MOST / step_time))
        self._pending = 0.0  # s of the flight
        self._wanted = self._flown = self._passed = self._pictures = 0.0  # s, s, s and pictures, decaying sums

    def due(self, elapsed: float, speed: float = 1.0) -> int:
        """Number of steps to fly, `elapsed`, s, after the previous call; speed 0.5 is slow motion, 0 a pause."""
        self._pending += elapsed * speed
        due = math.floor(self._pending / self._step_time + 1e-9)
        self._pending -= due * self._step_time
        steps = min(due, self._most)
        fade = math.exp(-elapsed / _MEMORY)
        new = elapsed * speed, steps * self._step_time, elapsed, 1.0
        old = self._wanted, self._flown, self._passed, self._pictures
        self._wanted, self._flown, self._passed, self._pictures = (fade * a + b for a, b in zip(old, new, strict=True))
        return steps

    @property
    def begun(self) -> float:
        """Share of the next step that has passed, in [0, 1]."""
        return self._pending / self._step_time

    @property
    def share(self) -> float:
        """Flown share of the wanted time, over about the last second."""
        return self._flown / self._wanted if self._wanted > 0.2 * _MEMORY else 1.0

    @property
    def rate(self) -> float:
        """Pictures per second, over about the last second."""
        return self._pictures / self._passed if self._passed > 0.0 else 0.0

    @property
    def warning(self) -> str:
        """A sentence for the person if the computer is too slow, else ""."""
        if self.share >= _SLOW:
            return ""
        return f"too slow a computer: {self.share:.2f} of real time, {self.rate:.0f} pictures/s"
