"""Fly the quadrotor beside rotorpy's, and draw docs/images/fidelity.png of settings.md.

`python docs/fidelity.py` draws docs/fidelity.json; then run `python docs/shrink.py`. With `--fly` it first flies and
writes that file (about three minutes); then run `python docs/tables.py` too. Flying needs scipy, which the extra `cli`
brings, and rotorpy without what it depends on: `pip install --no-deps rotorpy==3.0.0`.
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

import matplotlib
import numpy as np
from fidelity_flights import SCENES, TICK, TRACK, Scene, fly_ours, wind_force
from fidelity_rotorpy import OurPilot, Plant, Se3Pilot, bare, fly_on_rotorpy, open_loop, shaped
from matplotlib.axes import Axes

from fovconn_env import Airframe
from fovconn_env.files import write_text
from fovconn_env.render.figures import style

RECORD, PICTURE = Path(__file__).with_name("fidelity.json"), Path(__file__).parent / "images" / "fidelity.png"
# Flights, all from rest: label, colour, line.
LINES = {
    "ours": ("fovconn_env", style.FOLLOWERS[0], {"lw": 2.6}),
    "plant": ("its controller, rotorpy's body, no drag", style.DARK, {"lw": 1.1, "ls": (0, (4, 3))}),
    "drag": ("its controller, rotorpy's body, drag", style.FOLLOWERS[2], {"lw": 1.3}),
    "se3": ("rotorpy's SE3Control and body, drag", style.FOLLOWERS[1], {"lw": 1.6}),
    "shaped": ("", "", {}),  # the same, given our reference: not drawn
    "fed": ("SE3Control on our reference and body rate, drag", style.FOLLOWERS[1], {"lw": 1.3, "ls": (0, (1.5, 1.2))}),
}
SHOWN = {"velocity": 2.0, "yaw": 2.0}  # s, where it is less than what was flown
KEPT = {"velocity": 2, "yaw": 2, "gust": 4, "hover": 10}  # curves, one row of so many ticks


# ------------------------------------------------------------------------------------------------------- measures
def response(values: np.ndarray) -> dict[str, float]:
    """Of a unit step (T,) from rest: rise from 10 to 90 %, overshoot, and when it comes within 5 % to stay."""
    time, values = TICK * np.arange(len(values) + 1), np.concatenate([[0.0], values])
    tenth, ninety = (crossing(time, values, level) for level in (0.1, 0.9))
    outside = np.flatnonzero(np.abs(values - 1.0) > 0.05)
    return {
        "rise": ninety - tenth,
        "overshoot": max(float(values.max()) - 1.0, 0.0),
        "settle": float(time[outside[-1]] + TICK),
    }


def crossing(time: np.ndarray, values: np.ndarray, level: float) -> float:
    """When the values first reach a level, between samples on a straight line; s."""
    k = int(np.argmax(values >= level))
    return float(np.interp(level, values[k - 1 : k + 1], time[k - 1 : k + 1]))


def tilt(track: np.ndarray) -> np.ndarray:
    """Angle of the thrust from the vertical, (T,), deg."""
    roll, pitch = track[:, TRACK.index("roll")], track[:, TRACK.index("pitch")]
    return np.degrees(np.arccos(np.cos(roll) * np.cos(pitch)))


def measures(name: str, track: np.ndarray) -> dict[str, float]:
    """What a scene is flown for: s, shares, °, cm."""
    place, peak = track[:, :3], float(tilt(track).max())
    if name == "velocity":
        return response(track[:, 3]) | {"tilt": peak, "held": float(tilt(track)[-1])}
    if name == "yaw":
        return response(track[:, TRACK.index("yaw_rate")]) | {"climb": 100.0 * float(np.abs(place[:, 2]).max())}
    if name == "gust":
        return {"displacement": 100.0 * float(np.abs(place[:, 0]).max()), "tilt": peak}
    return {"rms": 100.0 * float(np.sqrt((place[:, :2] ** 2).sum(axis=1).mean())), "tilt": peak}


def fly() -> dict[str, Any]:
    """The record: measures and curves of all flights, and how far the plants are apart in open loop."""
    record: dict[str, Any] = {"rotorpy": version("rotorpy"), "force": round(wind_force(), 4)}
    record["open loop"] = {name: [float(f"{value:.3g}") for value in values] for name, values in open_loop().items()}
    record |= {"measures": {}, "curves": {}}
    for name, scene in SCENES.items():
        tracks = {"ours": fly_ours(scene)[0]}
        for kind, aero in (("plant", False), ("drag", True)):
            tracks[kind] = fly_on_rotorpy(scene, OurPilot(scene.params(), scene.commands()), Plant(aero))
        tracks["se3"] = fly_on_rotorpy(scene, Se3Pilot(bare(scene)), Plant(True))
        if name == "velocity":
            for kind, feed in (("shaped", False), ("fed", True)):
                tracks[kind] = fly_on_rotorpy(scene, Se3Pilot(shaped(scene, feed)), Plant(True))
        record["measures"][name] = {kind: rounded(measures(name, each)) for kind, each in tracks.items()}
        record["curves"][name] = {kind: curves(name, each) for kind, each in tracks.items()}
        print(name, json.dumps(record["measures"][name], indent=1), flush=True)
    return record | {"causes": rounded(causes())}


def causes() -> dict[str, float]:
    """Flights that take one cause of a difference away: overshoots, and the displacement by the gust, cm."""
    step, gust, small = SCENES["velocity"], SCENES["gust"], Scene(2.0, command=(0.0, 0.0, 0.0, 0.1))
    unfed = fly_on_rotorpy(step, OurPilot(step.params(), step.commands(), feed=False), Plant(False))
    turns = {}
    for name, changes in (("small yaw", {}), ("quick rotors", {"tau_m": 0.005})):  # s, the Hummingbird's
        track = fly_on_rotorpy(small, Se3Pilot(bare(small)), Plant(True, **changes))
        turns[name] = response(10.0 * track[:, TRACK.index("yaw_rate")])["overshoot"]
    ours = Airframe()
    soft = fly_on_rotorpy(gust, Se3Pilot(bare(gust), ours.kp, ours.kv), Plant(True))
    return {
        "unfed": measures("velocity", unfed)["overshoot"],
        **turns,
        "our gains": measures("gust", soft)["displacement"],
    }


def rounded(values: dict[str, float]) -> dict[str, float]:
    """With five digits."""
    return {name: float(f"{value:.5g}") for name, value in values.items()}


def curves(name: str, track: np.ndarray) -> dict[str, list[float]]:
    """What is drawn of a scene."""
    shown = {
        "velocity": {"speed": track[:, TRACK.index("vx")], "tilt": tilt(track)},
        "yaw": {"rate": track[:, TRACK.index("yaw_rate")]},
    }.get(name) or {"x": 100.0 * track[:, 0]}
    step = KEPT[name]
    return {key: np.round(values[step - 1 :: step], 3).tolist() for key, values in shown.items()}


# --------------------------------------------------------------------------------------------------------- figure
@matplotlib.rc_context(style.RC)
def draw(record: dict[str, Any]) -> Path:
    """Write the picture."""
    figure = style.sheet(9.0, 5.0)
    panels = figure.subplot_mosaic([["velocity", "tilt", "yaw"], ["gust", "hover", "hover"]])
    _plot(panels["velocity"], record, "velocity", "speed", "Step of 1 m/s forward", "forward speed, m/s")
    _plot(panels["tilt"], record, "velocity", "tilt", "Its tilt", "tilt, °")
    _plot(panels["yaw"], record, "yaw", "rate", "Step of 1 rad/s in yaw rate", "yaw rate, rad/s")
    _plot(panels["gust"], record, "gust", "x", f"Gust of 4 m/s ({record['force']:.2f} N)", "forward displacement, cm")
    _plot(panels["hover"], record, "hover", "x", "Hover under a random force of 0.2 N", "forward displacement, cm")
    panels["gust"].axvspan(*SCENES["gust"].gust, color=style.BAND, lw=0, zorder=0)
    for name in ("velocity", "yaw"):
        panels[name].axhline(1.0, color=style.FAINT, lw=0.8, zorder=1)
    figure.legend(*panels["velocity"].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return style.save(figure, PICTURE)


def _plot(axes: Axes, record: dict[str, Any], scene: str, curve: str, title: str, label: str) -> None:
    step = TICK * KEPT[scene]
    for kind, each in record["curves"][scene].items():
        name, color, line = LINES[kind]
        values = [0.0, *each[curve]]
        if name:
            axes.plot(step * np.arange(len(values)), values, color=color, label=name, **line)
    axes.set(title=title, ylabel=label, xlabel="time, s", xlim=(0.0, SHOWN.get(scene, SCENES[scene].seconds)))


if __name__ == "__main__":
    if "--fly" in sys.argv:
        write_text(RECORD, json.dumps(fly()) + "\n")
    print(draw(json.loads(RECORD.read_text("utf-8"))))
