"""`campaign.fly_cells` on a cluster: policies of one's own travel with all that they read, and flights come back."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fovconn_env.baselines.adapters import is_model
from fovconn_env.baselines.laws.filters import split_name
from fovconn_env.baselines.learned.cards import SUFFIX
from fovconn_env.errors import PolicyError
from fovconn_env.files import write_files
from fovconn_env.training.cluster.connection import LOCAL, connect
from fovconn_env.training.cluster.tasks import run_on_cluster
from fovconn_env.training.evaluation.campaign import Order, Runner
from fovconn_env.training.evaluation.flights import Evaluation
from fovconn_env.training.evaluation.provenance import Files
from fovconn_env.training.evaluation.submission import is_shipped
from fovconn_env.training.evaluation.workers import Watch, run_orders

_STEPS = 2  # of the flights that show what a policy reads

Result = tuple[Evaluation, Files, dict[str, bytes]]  # with the recordings, by their names


def runner(address: str, say: Callable[[str], None], show: Callable[[str], None]) -> Runner:
    """What `fly_cells` takes to fly on the cluster at an address, see `connect`; say, show: as of `run_on_cluster`.

    A policy of one's own flies two steps on this machine first, which shows what it reads. These files, those that its
    code names, and its modules are copied to the nodes, with their paths below a folder there.
    """

    def run(
        work: Callable[..., Any],
        orders: Sequence[tuple],
        processes: int | None,
        *,
        keep: Callable[[int, Any], None],
        progress: Callable[[float], None],
        died: Callable[[int, str], None],
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        own = {order.cell.policy: order for order in map(Order._make, orders) if not is_shipped(order.cell.policy)}
        home = os.path.realpath(".") if own else ""

        def keep_all(number: int, result: Result) -> None:
            part, files, recordings = result
            folder = Order._make(orders[number]).recordings
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
                write_files({folder / name: data for name, data in recordings.items()})
            keep(number, (part, files))

        with connect(address, processes=processes, say=say) as ray:
            files = {}
            if own:
                show("looking at what own policies read")
                files = _contents([home, *_read_by(work, own.values(), died)])
            copies, names = ray.put(files), {policy: _parts(policy) for policy in own}
            there = functools.partial(fly_there, work, copies, home, names)
            told = {"progress": progress, "died": died, "begin": begin, "say": say, "show": show}
            run_on_cluster(ray, there, orders, processes, keep=keep_all, alone=address == LOCAL, **told)

    return run


def _read_by(work: Callable[..., Any], orders: Iterable[Order], died: Callable[[int, str], None]) -> list[str]:
    """What the policies of these orders consist of and read, see `provenance`: each is flown a little."""
    found = dict[str, None]()

    def keep(number: int, result: tuple[Evaluation, Files]) -> None:
        found.update(dict.fromkeys(result[1]))

    short = [
        order._replace(
            cell=order.cell._replace(scenario=dataclasses.replace(order.cell.scenario, max_cycles=_STEPS)),
            seeds=order.seeds[:1],
            recordings=None,
        )
        for order in orders
    ]
    run_orders(work, [tuple(order) for order in short], None, keep=keep, progress=lambda done: None, died=died)
    return list(found)


def _contents(paths: Iterable[str]) -> dict[str, bytes | None]:
    """What files hold; None of folders, and nothing of what is neither."""
    there = (path for path in map(Path, paths) if path.exists())
    return {str(path): path.read_bytes() if path.is_file() else None for path in there}


def _parts(policy: str) -> tuple[str, str, str]:
    """A policy's name as what stands before its file, the file's whole path, "" without one, and what follows."""
    filter, inner = split_name(policy)
    before = f"{filter}:" if filter is not None else ""
    whole = inner.endswith((".py", SUFFIX)) or is_model(Path(inner))
    file, colon, name = (inner, "", "") if whole else inner.rpartition(":")
    if not whole and not file.endswith(".py"):
        return policy, "", ""  # a module by its dotted name, looked for in the current folder
    return before, os.path.realpath(file), colon + name


# ------------------------------------------------------------------------------------------------------- on a node
def fly_there(
    work: Callable[..., Any],
    copies: Any,
    home: str,
    names: Mapping[str, tuple[str, str, str]],
    watch: Watch,
    *order: Any,
) -> Result:
    """`fly_order` where the files of one's own policies are copies; what is said of them is said of the originals.

    copies: refers to these files; home: the current folder of the process that asked, "" without such policies; names:
    theirs, in parts.
    """
    k, cell, seeds, recordings = Order._make(order)
    root = str(_unpacked(copies)) if home else ""
    if home:
        os.chdir(root + home)
    if cell.policy in names:
        before, file, after = names[cell.policy]
        cell = cell._replace(policy=f"{before}{root}{file}{after}" if file else before)
    with contextlib.ExitStack() as stack:
        room = None
        if recordings is not None:
            room = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=_session())))
        try:
            part, files = work(watch, k, cell, seeds, room)
        except PolicyError as problem:  # says where in the copies
            problem.args = tuple(str(arg).replace(root, "") for arg in problem.args)
            problem.place = problem.place.replace(root, "")
            raise
        flown = {file.name: file.read_bytes() for file in room.iterdir()} if room is not None else {}
    session = os.path.join(_session(), "")
    originals = {path.removeprefix(root): was for path, was in files.items()}  # the copies are in that folder, too
    return part, {path: was for path, was in originals.items() if not path.startswith(session)}, flown


@functools.cache
def _unpacked(copies: Any) -> Path:
    """The folder with the copies, which the processes of a node share; it stays as long as what ray itself logs."""
    import ray

    folder = Path(_session(), f"fovconn-{ray.get_runtime_context().get_job_id()}")
    if folder.exists():
        return folder
    part = Path(tempfile.mkdtemp(dir=_session()))
    for path, data in ray.get(copies).items():
        place = part / Path(path).relative_to("/")
        (place if data is None else place.parent).mkdir(parents=True, exist_ok=True)
        if data is not None:
            place.write_bytes(data)
    try:
        part.rename(folder)
    except OSError:  # another process has been faster
        shutil.rmtree(part)
    return folder


@functools.cache
def _session() -> str:
    """The folder where ray keeps what it reads and writes."""
    import ray

    return os.path.realpath(ray.get_runtime_context().worker.node.get_session_dir_path())
