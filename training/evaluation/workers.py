"""Processes that work on orders: none outlives its parent, and none that dies takes the others along."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from fovconn_env.errors import FovconnError
from fovconn_env.sim.simulator import available_cores
from fovconn_env.training.evaluation.interruption import SIGNALS, Interrupted, noted_interruption

Watch = Callable[[float], bool]  # told how much of an order is done; False from it breaks off
_POLL, _TELL, _GRACE = 0.1, 0.1, 10.0  # s: between two looks, between two reports, for a step that is being flown
START = "spawn"  # a fork would copy threads that do not run in the child
# One thread a process: several processes that each start one a core wait for each other.
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class Died(Exception):
    """Processes died on the same order again and again; `order` is its number, `how` the exit status or signal."""

    def __init__(self, order: int, how: str, times: str = "twice") -> None:
        super().__init__(order, how, times)
        self.order, self.how, self.times = order, how, times


def run_orders(
    work: Callable[..., Any],
    orders: Sequence[tuple],
    processes: int | None,
    *,
    keep: Callable[[int, Any], None],
    progress: Callable[[float], None],
    died: Callable[[int, str], None],
    begin: Callable[[], None] = lambda: None,
) -> None:
    """Run `work(watch, *order)` for every order in processes, one a core by default.

    `keep` gets the number of each order and its result, also of those that an interruption or a failure breaks off;
    `progress` the sum of what `watch` was told. `begin` runs while the processes start. An order whose
    process dies is run once more, after `died` was told. Raises what `work` and `begin` raise, `Died`, and, after a
    signal, `Interrupted`.
    """
    waiting, deaths, counts = deque(range(len(orders))), Counter[int](), [0.0] * len(orders)
    problem: BaseException | None = None
    with contextlib.ExitStack() as stack:
        pool = stack.enter_context(_Pool(work, min(processes or available_cores(), len(orders))))
        with noted_interruption() as early:  # which does not strike between a process and its place in the pool
            pool.fill()
        if early:
            raise Interrupted(number=early.number)
        begin()
        interruption = stack.enter_context(noted_interruption())
        while pool.busy or (waiting and problem is None):
            for number, kind, value in pool.messages(orders, waiting if problem is None else deque()):
                if kind == "progress":
                    counts[number] = value
                elif kind == "done":
                    keep(number, value)
                elif kind == "failed":
                    problem = problem or value
                elif deaths[number] or problem is not None:
                    problem = problem or Died(number, value)
                else:
                    deaths[number] += 1
                    counts[number] = 0.0
                    waiting.appendleft(number)
                    died(number, value)
            progress(sum(counts))
            if interruption:
                problem = problem or Interrupted(number=interruption.number)
            if problem is not None:
                pool.stop()
    if problem is not None:
        raise problem


class _Worker:
    """A process and the order that it works on, None without one."""

    def __init__(self, work: Callable[..., Any]) -> None:
        context = multiprocessing.get_context(START)
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, work))
        with _inherited():
            self.process.start()
        other.close()
        self.order: int | None = None

    def receive(self) -> Iterator[tuple[str, Any]]:
        """What it said since; at last its death, if it died."""
        gone = self.process.exitcode is not None  # asked first: what it sent before is still to be read
        with contextlib.suppress(EOFError, OSError):  # a process that dies may do so in a message
            while self.connection.poll():
                kind, value = self.connection.recv()
                yield kind, exception(*value) if kind == "failed" else value
            if not gone:
                return
        self.process.join()
        code = self.process.exitcode or 0
        yield "died", signal.Signals(-code).name if code < 0 else f"exit status {code}"


class _Pool:
    """Workers, as many as there are orders for; all have ended when the context ends."""

    def __init__(self, work: Callable[..., Any], size: int) -> None:
        self._work, self._size, self._workers = work, size, list[_Worker]()
        self._kill = threading.Event()
        self._timer: threading.Timer | None = None

    def __enter__(self) -> _Pool:
        return self

    def __exit__(self, *problem: object) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for worker in self._workers:
            worker.connection.close()  # an idle one ends by itself
            if worker.order is not None:
                worker.process.kill()
        for worker in self._workers:
            worker.process.join(_GRACE)
            worker.process.kill()
            worker.process.join()

    @property
    def busy(self) -> bool:
        """Whether a worker has an order."""
        return any(worker.order is not None for worker in self._workers)

    def messages(self, orders: Sequence[tuple], waiting: deque[int]) -> Iterator[tuple[int, str, Any]]:
        """Hand out what is waiting, and wait a moment for (number, kind, value) from the workers."""
        if waiting:
            self.fill()
        for worker in self._workers:
            if worker.order is None and waiting:
                self._hand_out(worker, orders, waiting)
        wait([end for worker in self._workers for end in (worker.connection, worker.process.sentinel)], _POLL)
        for worker in list(self._workers):
            for kind, value in worker.receive():
                number = worker.order
                if kind != "progress":
                    worker.order = None
                if kind == "died":
                    worker.connection.close()
                    self._workers.remove(worker)
                elif kind == "done" and waiting:  # it does not wait while the result is kept
                    self._hand_out(worker, orders, waiting)
                if number is not None:
                    yield number, kind, value
        if self._kill.is_set():
            for worker in self._workers:
                worker.process.kill()

    def fill(self) -> None:
        """Start processes in the place of those that have died, at first all."""
        while len(self._workers) < self._size:
            self._workers.append(_Worker(self._work))

    @staticmethod
    def _hand_out(worker: _Worker, orders: Sequence[tuple], waiting: deque[int]) -> None:
        worker.order = waiting.popleft()
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # it has died: `receive` says so
            worker.connection.send(orders[worker.order])

    def stop(self) -> None:
        """Break off what runs; what goes on for longer than a step should take is killed."""
        if self._timer is None:
            self._timer = threading.Timer(_GRACE, self._kill.set)
            self._timer.daemon = True
            self._timer.start()
            for worker in self._workers:
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    worker.connection.send(None)


@contextlib.contextmanager
def _inherited() -> Iterator[None]:
    """What a process gets at its start: one thread for its libraries, and no signal before it can ignore them."""
    added = [name for name in _THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    mask = None
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # whose own start would take the mask off
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name in added:
            del os.environ[name]


def failure(problem: BaseException) -> tuple[bytes, str]:
    """An exception as it goes to another process, see `exception`; of a policy, it may even be that of sys.exit."""
    text = "".join(traceback.format_exception(problem))
    if not isinstance(problem, Exception):
        problem = RuntimeError(f"{type(problem).__name__}: {problem}")
    if not isinstance(problem, FovconnError):
        problem.add_note(f"In another process:\n{text}")
    try:
        return pickle.dumps(problem), text
    except Exception:  # it holds something that cannot be pickled
        return b"", text


def exception(data: bytes, text: str) -> BaseException:
    """An exception of another process; one that does not come through a pipe is told in words."""
    try:
        return pickle.loads(data)
    except Exception:
        return RuntimeError(text)


# ------------------------------------------------------------------------------------------------- in the process
def _serve(connection: Connection, work: Callable[..., Any]) -> None:
    """Work on the orders that come, until there are no more or the parent is gone."""
    for number in SIGNALS:  # they reach the parent as well, which says when to stop
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    orders, stop = queue.SimpleQueue(), threading.Event()
    threading.Thread(target=_listen, args=(connection, orders, stop), daemon=True).start()
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the parent is gone
        while (order := orders.get()) is not None:
            connection.send(_run(connection, work, order, stop))


def _listen(connection: Connection, orders: queue.SimpleQueue, stop: threading.Event) -> None:
    """Take orders from the parent. If it is gone, the process ends, whatever it is at."""
    with contextlib.suppress(EOFError, OSError):
        while (order := connection.recv()) is not None:
            orders.put(order)
        stop.set()
        orders.put(None)
        connection.poll(None)  # the parent's end
    stop.set()
    orders.put(None)
    threading.Event().wait(_GRACE)
    os._exit(1)  # a policy that does not return


def _run(connection: Connection, work: Callable[..., Any], order: tuple, stop: threading.Event) -> tuple[str, Any]:
    last, latest = -_TELL, 0.0

    def watch(done: float) -> bool:
        nonlocal last, latest
        latest = done
        if time.monotonic() - last >= _TELL:
            last = time.monotonic()
            tell()
        return not stop.is_set()

    def tell() -> None:
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the parent is gone, `_listen` says stop
            connection.send(("progress", latest))

    try:
        result = work(watch, *order)
        tell()
        return "done", result
    except BaseException as problem:  # of a policy, which may even call sys.exit
        return "failed", failure(problem)
