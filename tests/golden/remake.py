"""Short recorded runs, so that a change of results is noticed: `python tests/golden/remake.py` makes them anew.

It says by how much each run differs from the one that was there. `tests/sim/test_golden.py` compares at 1e-9.
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))  # a checkout need not be installed

from fovconn_env import Airframe, Camera, Noise, Radio, Scenario, Simulator, scenario

FILE = Path(__file__).with_name("runs.npz")
N_STEPS, EVERY, SEED = 60, 10, 7
GENTLE = {"warmup": 0.5, "patience": 1e3}  # cheap without the JIT, and never over early
RUNS: dict[str, Scenario] = {
    "LeaderFollow": scenario("LeaderFollow-v0", **GENTLE),
    "Regroup": scenario("Regroup-v0", **GENTLE),
    "LeaderObstacles": scenario("LeaderObstacles-v0", **GENTLE),
    "TiltDynamics": scenario("TiltDynamics-v0", **GENTLE),
    "Everything": scenario(
        "LeaderObstacles-v0",
        **GENTLE,
        n_agents=4,
        dynamics="quadrotor",
        link="radio",
        leader_index=1,
        max_neighbors=2,
        max_ranges=3,
        camera=Camera(occlusion=True, miss=0.1, coast=0.05),
        radio=Radio(loss=0.1, delay=1),
        noise=Noise(
            **{name: 0.02 for name in Noise.__dataclass_fields__ if name not in ("bearing_noise", "depth_noise")}
        ),
        airframe=Airframe(rotor_noise=0.02, force_noise=0.3),
    ),
    "RealCamera": scenario("RealCamera-v0", **GENTLE),
}


def record(name: str) -> dict[str, np.ndarray]:
    """Values every ten steps of a run on recorded actions, (7, ...), and the hash of all its observations."""
    settings = RUNS[name]
    rng, simulator, rows = np.random.default_rng(SEED), Simulator(settings), []
    digest = hashlib.sha256(simulator.reset(SEED).tobytes())
    rows.append(_values(simulator))
    for k in range(N_STEPS):
        if k % EVERY == 0:
            actions = rng.uniform(-0.4, 0.4, (1, settings.n_agents, 4))
        digest.update(simulator.step(actions).tobytes())
        if (k + 1) % EVERY == 0:
            rows.append(_values(simulator))
    if simulator.over[0]:
        raise RuntimeError(f"golden run {name} ended early: choose another seed or gentler actions")
    arrays = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return arrays | {"digest": np.frombuffer(digest.digest(), np.uint8)}


def _values(simulator: Simulator) -> dict[str, np.ndarray]:
    state = simulator.state
    body, track, belief, episode = state.body[0], state.track[0], state.belief[0], state.episode[0]
    numbers = [column for column in state.info.dtype.names if column not in ("yaw_error", "name_swaps", "alive")]
    return {
        "poses": simulator.poses()[0],
        "motion": np.stack([body[name] for name in ("vx", "vy", "vz", "yaw_rate", "roll", "pitch")], axis=-1),
        "weights": simulator.adjacency()[0],
        "tracks": np.stack([track[name] for name in ("x", "y", "z", "weight", "cos_used", "sin_used")], axis=-1),
        "beliefs": np.stack([belief[name] for name in ("x", "y1", "y2", "y3", "lambda2_hat", "v2_hat")], axis=-1),
        "stick": np.array([episode[f"stick_{axis}"] for axis in "xyz"]),
        "infos": np.stack([state.info[0][name] for name in numbers], axis=-1),
        "rewards": state.reward[0].copy(),
        "observations": simulator.observations[0].copy(),
    }


def load() -> dict[str, np.ndarray]:
    """The recorded runs: "run/array" to array."""
    with np.load(FILE) as kept:
        return dict(kept)


def difference(kept: np.ndarray, now: np.ndarray) -> float:
    """Largest difference, relative where numbers are above 1; inf for another shape."""
    if kept.shape != now.shape:
        return np.inf
    kept, now = kept.astype(float), now.astype(float)
    return float(np.max(np.abs(now - kept) / np.maximum(np.abs(kept), 1.0), initial=0.0))


def main() -> None:
    """Record all runs, tell what changed, and write the file."""
    before, after = load() if FILE.exists() else {}, {}
    for name in RUNS:
        arrays = record(name)
        after |= {f"{name}/{key}": value for key, value in arrays.items()}
        if f"{name}/digest" not in before:
            print(f"{name}: new")
            continue
        bits = "same bits" if (before[f"{name}/digest"] == arrays.pop("digest")).all() else "other bits"
        worst = {
            key: difference(before[f"{name}/{key}"], value)
            for key, value in arrays.items()
            if f"{name}/{key}" in before
        }
        worst = {key: value for key, value in worst.items() if value > 0}
        print(f"{name}: {bits}", *(f"{key} {value:.1e}" for key, value in worst.items()))
    np.savez_compressed(FILE, **after)
    print(f"wrote {FILE}, {FILE.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
