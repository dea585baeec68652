"""A flight as an animated GIF: the team from above, and lambda2 with its estimates below."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.path import Path as MarkerPath
from PIL import Image

from fovconn_env.files import replacing
from fovconn_env.flights.flight import Flight
from fovconn_env.render.figures import style
from fovconn_env.render.figures.gif import write_gif
from fovconn_env.render.figures.scene import Scene, arrow_shape, body_shapes, draw_ground, rotate_quarter
from fovconn_env.render.figures.timelines import plot_lambda2
from fovconn_env.text import in_figure

WIDTH, HEIGHT = 8.0, 7.0  # inches; 800 x 700 pixels in the animation
_SCENE, _STRIP = (0.012, 0.335, 0.976, 0.61), (0.075, 0.075, 0.905, 0.185)  # left, bottom, width, height: shares
_MARGIN = 1.3  # m around the flight
_TRAIL = 10.0  # s of the past that a trail shows
_HOLD = 2.0  # s the last frame stays


class Movie:
    """Frames of a flight. The static background is drawn once and copied."""

    def __init__(self, flight: Flight, dpi: float = 100.0) -> None:
        self._flight, self._edges = flight, flight.n_edges
        with matplotlib.rc_context(style.RC):
            self._figure = Figure(figsize=(WIDTH, HEIGHT), dpi=dpi, facecolor="white")
            self._canvas = FigureCanvasAgg(self._figure)
            above = self._figure.add_axes(_SCENE)
            shown, points_per_metre = _fit_axes(above, flight)
            start = shown.poses[0, [shown.scenario.leader_index], :2]
            draw_ground(above, shown.pieces, shown.vertices, np.vstack([start, shown.waypoints[:, :2]]))
            self._shown, self._scene = shown, Scene(above, shown.scenario, points_per_metre)
            self._moving = [(above, artist) for artist in self._scene.artists]
            strip = self._figure.add_axes(_STRIP)
            self._draw_lambda2(strip)
            self._draw_legend()
            for _, artist in self._moving:
                artist.set_animated(True)
            self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)

    def frame(self, k: int) -> np.ndarray:
        """Instant k as an image, (height, width, 3) uint8."""
        flight, shown = self._flight, self._shown
        self._scene.show(shown.poses[k], shown.tilt[k], shown.stick[k], shown.weights[k], shown.watch[k])
        self._scene.show_trails(shown.poses[max(0, k - round(_TRAIL / shown.scenario.step_time)) : k + 1, :, :2])
        self._cursor.set_xdata([flight.time[k]] * 2)
        self._point.set_data([flight.time[k]], [flight.lambda2[k]])
        ending = f"   {in_figure(flight.outcome)}" if k == len(flight.time) - 1 else ""
        self._clock.set_text(
            f"{flight.time[k]:5.1f} s     {self._edges[k]} links     λ₂ = {flight.lambda2[k]:.2f}{ending}"
        )
        self._canvas.restore_region(self._still)
        for axes, artist in self._moving:
            axes.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba())[..., :3]

    def _draw_lambda2(self, strip: Axes) -> None:
        flight = self._flight
        plot_lambda2(strip, flight)
        strip.set(xlabel="time (s)", ylabel=r"$\lambda_2$", xlim=(0, flight.time[-1]))
        handles = [handle for handle in strip.get_lines() if "\\tilde" not in str(handle.get_label())]
        handles.insert(0, Line2D([], [], color=style.FAINT, lw=1.0, label="estimates"))
        strip.legend(handles=handles[:3], loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, borderaxespad=0.0)
        (self._cursor,) = strip.plot([0, 0], [0, 1], color=style.DARK, lw=1.0, transform=strip.get_xaxis_transform())
        (self._point,) = strip.plot([], [], "o", color=style.TRUTH, mec="white", ms=7, zorder=9)
        self._clock = self._figure.text(0.985, 0.962, "", ha="right", fontsize=11, color=style.DARK)
        self._moving += [(strip, self._cursor), (strip, self._point), (strip, self._clock)]

    def _draw_legend(self) -> None:
        scenario = self._flight.scenario
        title = f"{in_figure(scenario.name)}, seed {self._flight.seed}"
        self._figure.text(0.015, 0.962, title, fontsize=12, weight="bold")
        wedge, drop = MarkerPath.wedge(-65, 65), MarkerPath(body_shapes(np.zeros((1, 4)), 1.0)[0])
        handles = [
            Line2D([], [], color=style.MUTUAL, lw=3.0, label="see each other"),
            Line2D([], [], color=style.ONE_WAY, lw=3.0, marker=">", ms=7, mec="white", label="one sees the other"),
            Line2D([], [], color="#B8B8B8", marker=wedge, ls="", ms=17, mew=0, label="camera"),
            Line2D([], [], color=style.FAINT, marker=drop, ls="", ms=12, mew=0, label="heading"),
        ]
        if len(self._flight.waypoints):
            arrow = MarkerPath(arrow_shape(np.array([-1.0, 0.0]), np.array([1.0, 0.0]), 0.45))
            handles.append(
                Line2D([], [], color=style.LEADER, marker=arrow, ls="", ms=18, mew=0, label="operator's stick")
            )
            handles.append(Line2D([], [], color=style.OPERATOR, marker="*", ls="", ms=11, label="way point"))
        layout = {"loc": "lower left", "bbox_to_anchor": (0.003, 0.288), "columnspacing": 1.6, "handletextpad": 0.6}
        self._figure.legend(handles=handles, ncols=len(handles), **layout)


def animate(
    flight: Flight,
    path: Path,
    *,
    fps: int = 10,
    speedup: float = 4.0,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a flight as a GIF of `fps` frames a second at `speedup` times real time; the last frame stays 2 s.

    progress: called with the number of drawn frames and of all frames.
    """
    indices = frame_indices(flight.time, speedup / fps)
    movie = Movie(flight)
    samples = [movie.frame(int(k)) for k in indices[:: max(1, len(indices) // 6)]]

    def frames() -> Iterator[np.ndarray]:
        for done, k in enumerate(indices, start=1):
            yield movie.frame(int(k))
            if progress is not None:
                progress(done, len(indices))

    durations = [round(1000 / fps)] * (len(indices) - 1) + [round(1000 * _HOLD)]
    with replacing(path) as (part,):
        write_gif(part, frames(), samples, durations)
    return path


def snapshot(flight: Flight, path: Path, *, time: float | None = None, dpi: float = 200.0) -> Path:
    """Write one frame as a PNG: the instant nearest to `time` (s), or a third of the flight."""
    at = flight.time[-1] / 3 if time is None else time
    image = Movie(flight, dpi).frame(int(np.abs(flight.time - at).argmin()))
    with replacing(path) as (part,):
        Image.fromarray(image).save(part, optimize=True)
    return path


def frame_indices(time: np.ndarray, interval: float) -> np.ndarray:
    """Indices of the instants 0, interval, 2 interval, ... (s) and of the last one."""
    times = np.arange(0.0, time[-1] - 1e-9, interval)
    return np.append(np.searchsorted(time, times - 1e-9), len(time) - 1)


def _fit_axes(axes: Axes, flight: Flight) -> tuple[Flight, float]:
    """Fit the axes to the flight, rotated by a quarter turn if it is larger then; return it and points per metre."""
    width, height = 72 * WIDTH * _SCENE[2], 72 * HEIGHT * _SCENE[3]  # points

    def extent(shown: Flight) -> tuple[np.ndarray, np.ndarray]:
        points = np.concatenate([shown.poses[..., :2].reshape(-1, 2), shown.waypoints[:, :2]])
        return points.min(0) - _MARGIN, points.max(0) + _MARGIN

    def scale(shown: Flight) -> float:
        low, high = extent(shown)
        return min(width / (high - low)[0], height / (high - low)[1])

    shown = max(flight, rotate_quarter(flight), key=scale)
    points_per_metre, (low, high) = scale(shown), extent(shown)
    (x, y), half = (low + high) / 2, np.array([width, height]) / points_per_metre / 2
    axes.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
    axes.set_xticks(np.arange(np.ceil((x - half[0]) / 5) * 5, x + half[0], 5.0))
    axes.set_yticks(np.arange(np.ceil((y - half[1]) / 5) * 5, y + half[1], 5.0))
    axes.tick_params(length=0, labelbottom=False, labelleft=False)
    axes.spines[["top", "right"]].set_visible(True)
    axes.text(0.992, 0.015, "grid 5 m", transform=axes.transAxes, ha="right", fontsize=8, color=style.FAINT)
    return shown, points_per_metre
