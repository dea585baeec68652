"""How many steps are due, and whether the computer keeps up."""

from __future__ import annotations

import math

MOST = 4  # steps made up for between two pictures; what is due beyond them is dropped, and told
_MEMORY = 1.0  # s over which the pace is measured
_SLOW = 0.95  # share of the wished pace below which it is told


class Pace:
    """Turns the time between pictures into steps of `step_time`, s."""

    def __init__(self, step_time: float) -> None:
        self._step_time = step_time
        self._owed = 0.0  # s of the flight
        self._wished = self._flown = self._passed = self._pictures = 0.0  # s, s, s and pictures of late

    def due(self, elapsed: float, speed: float = 1.0) -> int:
        """Steps to fly `elapsed`, s, after the call before; speed 0.5 is slow motion, 0 a pause."""
        self._owed += elapsed * speed
        due = math.floor(self._owed / self._step_time + 1e-9)
        self._owed -= due * self._step_time
        steps = min(due, MOST)
        fade = math.exp(-elapsed / _MEMORY)
        new = elapsed * speed, steps * self._step_time, elapsed, 1.0
        old = self._wished, self._flown, self._passed, self._pictures
        self._wished, self._flown, self._passed, self._pictures = (fade * a + b for a, b in zip(old, new, strict=True))
        return steps

    @property
    def begun(self) -> float:
        """Share of the next step that has gone by, from 0 to 1."""
        return self._owed / self._step_time

    @property
    def share(self) -> float:
        """Time flown of the time wished, about the last second."""
        return self._flown / self._wished if self._wished > 0.2 * _MEMORY else 1.0

    @property
    def rate(self) -> float:
        """Pictures a second, about the last second."""
        return self._pictures / self._passed if self._passed > 0.0 else 0.0

    @property
    def complaint(self) -> str:
        """What to tell a person in front of a computer that is too slow, or nothing."""
        if self.share >= _SLOW:
            return ""
        return f"too slow a computer: {self.share:.2f} of real time, {self.rate:.0f} pictures/s"
