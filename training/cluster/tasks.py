"""Orders as tasks of a cluster: what is lost with a process or a node is run again, what fails is not."""

from __future__ import annotations

import contextlib
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from fovconn_env.errors import MachineError
from fovconn_env.training.cluster.nodes import Node, Nodes, about, gone, placed
from fovconn_env.training.evaluation.interruption import Interrupted, noted_interruption
from fovconn_env.training.evaluation.workers import Died, exception, failure

_POLL = 0.1  # s between two looks
_TRIES, _TIMES = 4, "four times"  # of an order: that a node is taken away, say by a batch system, is not its fault
_PATIENCE = 60.0  # s without any node


def run_on_cluster(
    ray: Any,
    work: Callable[..., Any],
    orders: Sequence[tuple],
    processes: int | None,
    *,
    keep: Callable[[int, Any], None],
    progress: Callable[[float], None],
    died: Callable[[int, str], None],
    begin: Callable[[], None] = lambda: None,
    say: Callable[[str], None] = lambda line: None,
    show: Callable[[str], None] = lambda text: None,
    alone: bool = False,
) -> None:
    """As `workers.run_orders` on the nodes of a cluster, each order with one CPU and one thread.

    ray: see `connection.connect`; processes: orders that are run at once, one a CPU by default. `progress` is told of
    whole orders, and those that are running at an interruption are lost. An order is run up to four times. `say` gets a
    line of a node that joins late, is lost, or differs; `show` what the cluster does, whenever that changes. alone: the
    cluster is a Ray of this process, whose nodes stay as they are.

    Raises as `run_orders`; `SettingError` for a node that computes otherwise, and `MachineError` where none is left.
    """
    nodes = Nodes(ray, say, alone)
    tasks = _Tasks(ray, work, orders, processes, nodes)
    show(state := tasks.state())
    begin()
    here = about()
    with contextlib.ExitStack() as stack:
        stack.callback(tasks.cancel)
        interruption = stack.enter_context(noted_interruption())
        while tasks.left:
            lost, problems = nodes.look(), list[BaseException]()
            nodes.settle(here)
            tasks.hand_out()
            ended = list(tasks.ended())
            tasks.hand_out()  # no node waits while results are kept
            for number, kind, value in ended:
                if kind == "done":
                    keep(number, value)
                elif kind == "failed":
                    problems.append(exception(*value))
                elif kind == "lost":
                    lost.append(value)
                else:
                    died(number, value)
            for node in dict.fromkeys(lost):
                say(f"node {node.name} is lost; {_count(tasks.give_up(node), 'task')} of it run again")
            progress(tasks.told)
            if interruption:
                problems.append(Interrupted(number=interruption.number))
            for problem in problems:
                raise problem
            if tasks.state() != state:
                show(state := tasks.state())


class _Tasks:
    """Orders that wait, and tasks on the nodes; each order is in one of them, or done."""

    def __init__(
        self, ray: Any, work: Callable[..., Any], orders: Sequence[tuple], processes: int | None, nodes: Nodes
    ) -> None:
        self.told = 0.0  # of what is done, by `watch`
        self._ray, self._orders, self._most, self._nodes = ray, orders, processes, nodes
        self._task, self._work = ray.remote(num_cpus=1, max_retries=0)(_run), ray.put(work)
        self._waiting, self._flying = deque(range(len(orders))), dict[Any, tuple[int, Node]]()
        self._deaths = Counter[int]()
        self._idle = time.monotonic()  # since when there is no node

    @property
    def left(self) -> bool:
        """Whether there is anything to do."""
        return bool(self._waiting or self._flying)

    def hand_out(self) -> None:
        """Give each node a task for each of its CPUs, and one to go on with, as long as many are waiting."""
        ready = list(self._nodes.ready.values())
        cpus, counts = sum(node.cpus for node in ready), Counter(node.id for _, node in self._flying.values())
        most = len(self._orders) if self._most is None else self._most
        while self._waiting and ready and len(self._flying) < most:
            spare = self._most is None and len(self._waiting) > cpus
            node = min(ready, key=lambda node: counts[node.id] / node.cpus)
            if counts[node.id] >= node.cpus + spare:
                return
            number = self._waiting.popleft()
            counts[node.id] += 1
            self._flying[placed(self._task, node).remote(self._work, self._orders[number])] = number, node

    def ended(self) -> Iterator[tuple[int, str, Any]]:
        """Wait a moment for (number, kind, value): done, its result; failed, see `failure`; died, how; lost, a node."""
        if not self._nodes.ready and not self._nodes.checks:
            if time.monotonic() > self._idle + _PATIENCE:
                raise MachineError("no node of the cluster is left: start one, then the same command goes on")
            time.sleep(_POLL)
            return
        self._idle = time.monotonic()
        self._ray.wait([*self._flying, *self._nodes.checks], timeout=_POLL)
        over = self._ray.wait(list(self._flying), num_returns=len(self._flying), timeout=0)[0] if self._flying else []
        for task in over:
            number, node = self._flying[task]
            kind, value = self._result(task, node)
            if kind != "lost":  # `give_up` takes all of the node
                del self._flying[task]
            if kind == "died":
                self._again(number, value)
            yield number, kind, value

    def _result(self, task: Any, node: Node) -> tuple[str, Any]:
        errors = self._ray.exceptions
        try:
            told, kind, value = self._ray.get(task)
        except errors.RayTaskError:
            raise
        except gone(self._ray):
            return "lost", node
        except errors.OutOfMemoryError:
            return "died", f"no memory left on node {node.name}"
        except errors.RayError:
            return "died", f"a crash on node {node.name}"
        self.told += told if kind == "done" else 0.0
        return kind, value

    def give_up(self, node: Node) -> int:
        """Put what a node had back among what is waiting; returns how many."""
        self._nodes.drop(node)
        lost = [(task, number) for task, (number, at) in self._flying.items() if at is node]
        for task, number in lost:
            del self._flying[task]
            self._again(number, f"the loss of node {node.name}")
        return len(lost)

    def _again(self, number: int, how: str) -> None:
        self._deaths[number] += 1
        if self._deaths[number] == _TRIES:
            raise Died(number, how, _TIMES)
        self._waiting.appendleft(number)

    def state(self) -> str:
        """What the cluster does, for people."""
        ready, checks, again = self._nodes.ready.values(), len(self._nodes.checks), self._deaths.total()
        parts = [f"{_count(len(ready), 'node')}, {_count(sum(node.cpus for node in ready), 'CPU')}"] if ready else []
        parts += [f"checking {_count(checks, 'node')}, kernels compile once on each"] if checks else []
        parts += [f"{_count(again, 'task')} run again"] if again else []
        return ", ".join(parts) or "no node"

    def cancel(self) -> None:
        """End what is running."""
        for task in self._flying:
            self._ray.cancel(task, force=True)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + "s" * (number != 1)


def _run(work: Callable[..., Any], order: tuple) -> tuple[float, str, Any]:
    """In a process of a node: what `watch` was told last, and the result, or what went wrong."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # as ray sets it, it raises SystemExit: as if the policy had done so
    told = 0.0

    def watch(done: float) -> bool:
        nonlocal told
        told = done
        return True

    try:
        result = work(watch, *order)
    except BaseException as problem:  # of a policy, which may even call sys.exit
        return told, "failed", failure(problem)
    return told, "done", result
