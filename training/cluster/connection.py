"""A Ray cluster: one that is joined, or one of this machine alone that ends with the process that started it."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator
from typing import Any

from fovconn_env.errors import MachineError, missing_package, rule
from fovconn_env.sim.simulator import available_cores
from fovconn_env.training.evaluation.interruption import Interrupted

LOCAL, RUNNING, CLIENT = "local", "auto", "ray://"
_REACH = 5.0  # s that an address has to answer
_LONGEST = 300  # letters of what ray says
_ROOM = "/tmp"  # for Ray's sockets, whose paths have 107 bytes: the folder that TMPDIR names may use them up
# Read by ray and by what it starts: no reports to its makers, no warning of a change that does not concern us.
_VARIABLES = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


@contextlib.contextmanager
def connect(
    address: str,
    *,
    processes: int | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Iterator[Any]:
    """The module `ray`, connected to a cluster. At the end the connection is closed, and a local Ray ended.

    address: `LOCAL` starts a Ray on this machine, with `processes` CPUs, one a core by default; `RUNNING` joins the one
    that this machine is a node of; HOST:PORT the same by its address; ray://HOST:PORT joins one from outside.
    processes: CPUs that are needed; say: is told that a Ray is started.

    Raises `MissingPackage` without ray, `SettingError` for an address of another form and for fewer CPUs than needed,
    and `MachineError` where no cluster answers.
    """
    ray = _import()
    wanted: dict[str, Any] = {"address": address, "log_to_driver": False, "logging_level": "error"}
    with contextlib.ExitStack() as stack:
        if address == LOCAL:
            count = processes or available_cores()
            room = tempfile.TemporaryDirectory(prefix="ray-", dir=_ROOM, ignore_cleanup_errors=True)
            wanted |= {"num_cpus": count, "include_dashboard": False, "_temp_dir": stack.enter_context(room)}
            say(f"starting Ray on this machine, with {count} CPUs")
        else:
            _check_answers(address)
        stack.callback(_close, ray, wait=address == LOCAL)  # also after an interruption half-way
        with _handlers_kept():
            try:
                ray.init(**wanted)
            except Exception as problem:  # of any class: ray has none for this
                hint = "if it asks for a token, RAY_AUTH_MODE=token takes that of ~/.ray/auth_token"
                raise MachineError(f"{_refused(address)}: {_one_line(problem)}; {hint}") from problem
        count = int(ray.cluster_resources().get("CPU", 0))
        enough = processes is None or processes <= count
        rule(enough, "--processes", f"at most the cluster's {count} CPUs", processes, "start more nodes")
        yield ray


def _close(ray: Any, *, wait: bool) -> None:
    """Close the connection. Meanwhile no other thread, one that draws for example, may come upon what is left of ray.

    Where one collects a reference to an object of a cluster just then, ray ends Python with status 1 and no word.
    """
    collects = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        ray.shutdown(wait_for_processes=wait)
    finally:
        if collects:
            gc.enable()


def _import() -> Any:
    for name, value in _VARIABLES.items():
        os.environ.setdefault(name, value)
    try:
        import ray
    except ModuleNotFoundError as problem:
        raise missing_package("a cluster", problem) or problem from None
    return ray


def _check_answers(address: str) -> None:
    """`SettingError` for what is no address, `MachineError` if nothing listens there: ray itself tries for minutes."""
    if address == RUNNING:
        return
    host, _, port = address.removeprefix(CLIENT).rpartition(":")
    is_address = bool(host) and "/" not in host and port.isdecimal() and 0 < int(port) < 2**16
    rule(is_address, "--ray", "local, auto, HOST:PORT or ray://HOST:PORT", address, "the head node says which")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _REACH).close()
    except OSError as problem:
        raise MachineError(f"{_refused(address)}: {problem.strerror or problem}") from None


def _refused(address: str) -> str:
    return f"--ray must name a cluster that can be joined, got {address!r}"


def _one_line(problem: BaseException) -> str:
    return " ".join(str(problem).split())[:_LONGEST] or type(problem).__name__


@contextlib.contextmanager
def _handlers_kept() -> Iterator[None]:
    """`ray.init` puts a handler of its own for SIGTERM in the place of ours, which ends Python with this status."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    except SystemExit:
        raise Interrupted(number=signal.SIGTERM) from None
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)
