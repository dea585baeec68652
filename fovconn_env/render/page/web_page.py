"""A flight as one web page that plays it back: 3-D view, plots, no network and nothing to install.

The page is web/page.html with its style, its scripts and the libraries of web/libraries.js (three.js for the 3-D view,
uPlot for the curves) written into it, and the flight as compressed arrays.
"""

from __future__ import annotations

import base64
import html
import json
import re
import zlib
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env.files import write_text
from fovconn_env.flights.flight import Flight
from fovconn_env.render import palette, sight
from fovconn_env.render.levels import Levels, levels_of
from fovconn_env.render.obstacles import outlines
from fovconn_env.text import label

INTERVAL = 0.1  # s between the instants in the page
SCRIPTS = ("data.js", "shapes.js", "view.js", "plots.js", "page.js")
_WEB = Path(__file__).parent / "web"
_MARGIN = 4.0  # m of ground around the flight
_GRID = 5.0  # m
_ENDINGS = {"disconnected": "team split", "time": "time is up"}  # clearer words for outcomes


def write_page(flight: Flight, path: Path, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Write a flight as one HTML file that any browser from 2023 on plays back offline.

    progress: called with the number of finished parts and of all parts.
    """
    parts = {}
    for done, (name, make) in enumerate(_PARTS.items(), start=1):
        parts[name] = make(flight)
        if progress is not None:
            progress(done, len(_PARTS))
    page = re.sub(r"\{\{(\w+)\}\}", lambda mark: parts[mark[1]], _read_asset("page.html"))
    write_text(path, page)
    return path


def instants(flight: Flight) -> np.ndarray:
    """Indices of the instants in the page: one every `INTERVAL` or every step, and the last."""
    every = max(1, round(INTERVAL / flight.scenario.step_time))
    return np.unique(np.append(np.arange(0, len(flight.time), every), len(flight.time) - 1))


def arrays(flight: Flight) -> dict[str, np.ndarray]:
    """Arrays of the page over its T instants, by name; little-endian, units as in `Flight` unless noted."""
    k = instants(flight)
    error = flight.yaw[k] - flight.yaw_hat[k]
    off = np.nan_to_num(1000.0 * np.arctan2(np.sin(error), np.cos(error)))
    return {
        "time": flight.time[k].astype("<f8"),
        "poses": flight.poses[k].astype("<f4"),
        "tilt": flight.tilt[k].astype("<f4"),
        "leader": flight.leader[np.maximum(k - 1, 0)].astype("<i2"),  # in the step that ends then, as the stick
        "stick": flight.stick[k].astype("<f4"),
        "lambda2": flight.lambda2[k].astype("<f4"),
        "lambda2_hat": flight.lambda2_hat[k].astype("<f4"),
        "weights": np.ceil(255.0 * flight.weights[k]).astype("u1"),  # 0 only where there is no link
        "sees": (flight.watch[k] > 0).astype("u1"),
        "yaw_error": np.round(off).astype("<i2"),  # mrad, wrapped
        "yaw_valid": flight.yaw_valid[k].astype("u1"),
        "alive": flight.alive[k].astype("u1"),
    }


def settings(flight: Flight) -> dict[str, Any]:
    """The page's settings: everything besides its arrays."""
    scenario, camera = flight.scenario, flight.scenario.camera
    places = np.concatenate([flight.poses[..., :3].reshape(-1, 3), flight.waypoints])
    low, high = places.min(0), places.max(0)
    levels = levels_of(scenario, places[:, 2])
    led = palette.leader_of(scenario) is not None
    course = [flight.poses[0, flight.leader[0], :3], *flight.waypoints] if led else []
    classes = sight.sight_class(flight.watch, flight.watch.swapaxes(1, 2))
    around = flight.poses[..., :3] - flight.poses[..., :3].mean(1, keepdims=True)
    return {
        "n": scenario.n_agents,
        "led": led,
        "fails": not flight.alive.all(),
        "interval": max(INTERVAL, scenario.step_time),
        "bound": scenario.lambda2_min,
        "ending": _ending(flight),
        "observer": sight.observer(classes),
        "camera": {"axis": camera.unit_axis, "a_min": camera.a_min, "d_max": camera.d_max},
        "course": [_round_point(place) for place in course],
        "obstacles": _prisms(flight, levels),
        "low": _round_point(low[:2] - _MARGIN),
        "high": _round_point(high[:2] + _MARGIN),
        "floor": levels.ground,
        "ceiling": levels.ceiling,
        "grid": _GRID,
        "spread": round(float(np.quantile(np.linalg.norm(around, axis=-1).max(1), 0.9)), 2),  # m about the middle
    }


def _prisms(flight: Flight, levels: Levels) -> list[dict[str, Any]]:
    """Obstacles as plans with heights, cut to those of the picture."""
    prisms = []
    for piece, plan in zip(flight.pieces, outlines(flight.pieces, flight.vertices), strict=True):
        low, high = max(float(piece["low"]), levels.ground), min(float(piece["high"]), levels.top)
        plan = plan[::4].round(3)
        plan = plan[(plan != np.roll(plan, -1, axis=0)).any(1)]
        if low < high:
            prisms.append({"plan": plan.tolist(), "low": low, "high": high})
    return prisms


def _round_point(place: np.ndarray) -> list[float]:
    return np.round(place, 3).tolist()


def _read_asset(name: str) -> str:
    return (_WEB / name).read_text(encoding="utf-8")


def _version() -> str:
    try:
        return version("fovconn-env")
    except PackageNotFoundError:  # a clone that is not installed
        return "from a clone"


def _ending(flight: Flight) -> str:
    """How it ended, in a few words."""
    return _ENDINGS.get(flight.outcome, label(flight.outcome))


def _title(flight: Flight) -> str:
    return html.escape(f"{label(flight.scenario.name)}, seed {flight.seed}")


def _summary(flight: Flight) -> str:
    """One line about the flight, HTML."""
    heights = {"floor": flight.scenario.floor, "ceiling": flight.scenario.ceiling}
    return (
        f"seed {flight.seed} · {flight.scenario.n_agents} robots · "
        f"<b>{html.escape(_ending(flight))}</b> after {flight.time[-1]:.1f} s"
        + "".join(f" · {name} {height:g} m" for name, height in heights.items() if height is not None)
    )


def _colors(flight: Flight) -> str:
    """Both themes as CSS variables: --truth, --one-way, ..., and --robot-0 and on."""

    def block(theme: palette.Theme) -> str:
        named = {name.replace("_", "-"): value for name, value in vars(theme).items() if isinstance(value, str)}
        named |= {f"robot-{i}": value for i, value in enumerate(palette.colors_of(flight.scenario, theme))}
        return "".join(f"--{name}:{value};" for name, value in named.items())

    light, dark = block(palette.LIGHT), block(palette.DARK)
    return f":root{{{light}}}\n@media (prefers-color-scheme: dark){{:root{{{dark}}}}}"


def _embedded(flight: Flight) -> str:
    """Settings and arrays as JSON that is safe in a script element."""
    packed = {
        name: {"type": array.dtype.str[1:], "data": base64.b64encode(zlib.compress(array.tobytes(), 9)).decode()}
        for name, array in arrays(flight).items()
    }
    return json.dumps({**settings(flight), "arrays": packed}, allow_nan=False).replace("<", "\\u003c")


# Replacements of each {{mark}} of page.html.
_PARTS: dict[str, Callable[[Flight], str]] = {
    "version": lambda _: _version(),
    "title": _title,
    "name": lambda flight: html.escape(label(flight.scenario.name)),
    "summary": _summary,
    "grid": lambda _: f"{_GRID:g}",
    "colors": _colors,
    "style": lambda _: _read_asset("uplot.css") + "\n" + _read_asset("page.css"),
    "flight": _embedded,
    "scripts": lambda _: "\n".join(_read_asset(name) for name in SCRIPTS).replace('"use strict";\n', ""),
    "libraries": lambda _: _read_asset("libraries.js"),
}
