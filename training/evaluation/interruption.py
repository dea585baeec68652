"""Signals that ask a program to end: Ctrl-C, and what timeout, systemd and batch systems send."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_REPEATED = 1.0  # s; `timeout` sends its signal to the program and to its group at once, a person needs longer


class Interrupted(BaseException):
    """Somebody broke off; the message tells what was finished and where it is.

    Like `KeyboardInterrupt` no `Exception`: code that handles a policy's errors does not take it for one.
    """

    def __init__(self, message: str = "interrupted", number: int = signal.SIGINT) -> None:
        super().__init__(message)
        self.number = number  # of the signal


class Interruption:
    """Whether a signal came, and which."""

    def __init__(self, raises: bool) -> None:
        self.number, self._raises, self._at = 0, raises, 0.0
        self.outer: Interruption | None = None  # whose place it takes for a while

    def __bool__(self) -> bool:
        return self.number != 0

    def __call__(self, number: int, frame: object) -> None:
        """The signal handler; a second Ctrl-C ends the program where it is, even if the first was only noted."""
        first, again = not self, number == signal.SIGINT and time.monotonic() - self._at > _REPEATED
        self._note(number)
        if (first and self._raises) or (not first and again):
            raise Interrupted(number=number)

    def _note(self, number: int) -> None:
        self.number, self._at = number, time.monotonic()
        if self.outer is not None:
            self.outer._note(number)


def noted_interruption() -> contextlib.AbstractContextManager[Interruption]:
    """Signals are noted instead of striking anywhere, so that what is finished can be kept."""
    return _handling(Interruption(raises=False))


def raised_interruption() -> contextlib.AbstractContextManager[Interruption]:
    """Signals raise `Interrupted` where the program is."""
    return _handling(Interruption(raises=True))


@contextlib.contextmanager
def _handling(interruption: Interruption) -> Iterator[Interruption]:
    if threading.current_thread() is not threading.main_thread():  # only there handlers can be set
        yield interruption
        return
    before: dict[int, Callable[..., Any] | int | None] = {}
    for number in SIGNALS:
        if (handler := signal.getsignal(number)) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            before[number] = signal.signal(number, interruption)
            interruption.outer = handler if isinstance(handler, Interruption) else None
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
