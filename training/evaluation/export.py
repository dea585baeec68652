"""A flight as a file for other programs. A new format is a function here and a line in WRITERS."""

from __future__ import annotations

import csv
import importlib.util
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np

from fovconn_env import Flight
from fovconn_env.errors import MissingPackage, SettingError
from fovconn_env.files import replacing
from fovconn_env.flights.rollout import Observer

Watch = Callable[[int, int], None]  # told how much is done, and of how much
MP4_FPS, MP4_SPEEDUP = 20, 2.0
_STREAMED = {"movflags": "faststart"}  # the index at the start, so that a page shows the film before it has all of it


def table(flight: Flight) -> dict[str, np.ndarray]:
    """A flight as columns, (T N,) each: a row for each robot at each instant; SI units, radians, world frame.

    leads, stick: whether the robot led in the step that ends then, and the operator's velocity in it, 0 for the others;
    lambda2_hat: its own estimate; n_edges: links of the team; neighbors: its own; seen_by: how many see it.
    """
    t, n = flight.poses.shape[:2]
    leads = np.arange(n) == np.insert(flight.leader[:-1], 0, flight.leader[0])[:, None]  # in the step that ends then
    columns = {"time": np.repeat(flight.time, n), "robot": np.tile(np.arange(n), t)}
    columns |= {name: flight.poses[..., k].ravel() for k, name in enumerate(("x", "y", "z", "yaw"))}
    columns |= {name: flight.tilt[..., k].ravel() for k, name in enumerate(("roll", "pitch"))}
    columns |= {"leads": leads.ravel().astype(int)}
    columns |= {f"stick_{axis}": np.where(leads, flight.stick[:, [k]], 0.0).ravel() for k, axis in enumerate("xyz")}
    columns |= {"lambda2": np.repeat(flight.lambda2, n), "lambda2_hat": flight.lambda2_hat.ravel()}
    columns |= {"n_edges": np.repeat(flight.n_edges, n), "neighbors": (flight.weights > 0).sum(2).ravel()}
    return columns | {"seen_by": (flight.watch > 0).sum(1).ravel()}


def write_csv(flight: Flight, path: Path, watch: Watch) -> None:
    """Text, a line a robot and instant; numbers with all their digits."""
    columns = table(flight)
    with path.open("w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(columns)
        lines.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def write_parquet(flight: Flight, path: Path, watch: Watch) -> None:
    """The same table for pandas, polars and their kind."""
    import pyarrow
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(table(flight)), path)


def write_gif(flight: Flight, path: Path, watch: Watch) -> None:
    """The team from above, lambda2 below, four times as fast as it was."""
    from fovconn_env.render.figures.animation import animate

    animate(flight, path, progress=watch)


def write_mp4(flight: Flight, path: Path, watch: Watch) -> None:
    """The same picture as a film, H.264, twice as fast as it was."""
    import av

    from fovconn_env.render.figures.animation import Movie, frame_indices

    movie, chosen = Movie(flight), frame_indices(flight.time, MP4_SPEEDUP / MP4_FPS)
    with av.open(str(path), "w", format="mp4", options=_STREAMED) as container:
        stream = container.add_stream("libx264", rate=MP4_FPS, options={"crf": "20"})
        stream.height, stream.width = movie.frame(0).shape[:2]
        stream.pix_fmt = "yuv420p"
        for done, k in enumerate(chosen, start=1):
            image = np.ascontiguousarray(movie.frame(int(k)))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            watch(done, len(chosen))
        container.mux(stream.encode())


def write_html(flight: Flight, path: Path, watch: Watch) -> None:
    """A web page that plays the flight back, without network and without an install."""
    from fovconn_env.render.page.web_page import write_page

    write_page(flight, path, progress=watch)


def write_rerun(flight: Flight, path: Path, watch: Watch) -> None:
    """A recording for the viewer rerun."""
    from fovconn_env.render.page.rerun_log import write_rrd

    write_rrd(flight, path)


def write_ros(flight: Flight, path: Path, watch: Watch) -> None:
    """ROS 2 messages for Foxglove, rosbag2 and their kind."""
    from fovconn_env.fleet.ros.mcap_file import write_mcap

    write_mcap(flight, path)


def log_ros(path: Path) -> AbstractContextManager[Observer]:
    """The same, and what each robot knows."""
    from fovconn_env.fleet.ros.mcap_file import mcap_log

    return mcap_log(path)


# By suffix: the writer, the packages it needs, and the extra of this project that has them.
WRITERS: dict[str, tuple[Callable[[Flight, Path, Watch], None], tuple[str, ...], str]] = {
    ".gif": (write_gif, ("matplotlib", "PIL"), "render"),
    ".mp4": (write_mp4, ("matplotlib", "PIL", "av"), "render,export"),
    ".csv": (write_csv, (), ""),
    ".parquet": (write_parquet, ("pyarrow",), "export"),
    ".html": (write_html, (), ""),
    ".rrd": (write_rerun, ("rerun",), "rerun"),
    ".mcap": (write_ros, ("mcap", "rosbags"), "mcap"),
}
# Of formats that hold more than a `Flight`: what makes an observer that writes the file while the flight is computed.
LOGS: dict[str, Callable[[Path], AbstractContextManager[Observer]]] = {".mcap": log_ros}


def check_out(path: Path) -> None:
    """`SettingError` where no writer knows the suffix, `MissingPackage` where what it needs is not installed."""
    if path.suffix not in WRITERS:
        raise SettingError(
            f"--out must end in one of {', '.join(WRITERS)}, got {str(path)!r}: the ending is the format"
        )
    check_installed(path.suffix, *WRITERS[path.suffix][1:])


def check_installed(what: str, packages: tuple[str, ...] = ("matplotlib", "PIL"), extra: str = "render") -> None:
    """`MissingPackage` where something needs packages that are missing: which, and the extra that has them."""
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    if missing:
        raise MissingPackage(f'{what} needs {" and ".join(missing)}: pip install "fovconn-env[{extra}]"')


@contextmanager
def flight_log(path: Path | None) -> Iterator[list[Observer]]:
    """Observers that write a flight to a file while it is computed: one if its format is in LOGS, else none.

    A file that is there stays until the new one is whole.
    """
    if path is None or path.suffix not in LOGS:
        yield []
        return
    with replacing(path) as (part,), LOGS[path.suffix](part) as observer:
        yield [observer]


def write_flight(flight: Flight, path: Path, watch: Watch) -> Path:
    """Write a flight in the format of the path's suffix; a file that is there stays until the new one is whole."""
    check_out(path)
    with replacing(path) as (part,):
        WRITERS[path.suffix][0](flight, part, watch)
    return path
