"""What each imperfection of a camera costs, one at a time on LeaderFollow: `docs/results/cameras.json`."""

from __future__ import annotations

from fovconn_env.training.evaluation.ablations import sweep, tasks_of
from fovconn_env.training.evaluation.study import Study

SEEDS = range(96)
POLICIES = ("expert", "augmented")
_NAMED = {"camera.identify": 0.3, "camera.coast": 0.3}
_RUNS = {"camera.burst": 0.2, "camera.coast": 0.5}
MEASURES = {  # what a picture each shows: axis label
    "never_disconnected": "teams never disconnected",
    "yaw_rms_one_way": "sin(yaw error / 2), rms, one-way view",
    "lambda2_error_median": "lambda2_hat, median relative error",
}
PANELS = (
    sweep("Frame rate", "frames/s", POLICIES, {float(r): {"camera.frame_rate": float(r)} for r in (4, 8, 15, 30, 60)}),
    sweep("Latency", "s", POLICIES, {at: {"camera.latency": at} for at in (0.0, 0.05, 0.1, 0.2, 0.4, 0.8)}),
    sweep(
        "Misses in runs of 0.2 s",
        "share, kept for 0.5 s",
        POLICIES,
        {at: {"camera.miss": at, **_RUNS} for at in (0.0, 0.1, 0.2, 0.4, 0.6, 0.7)},
    ),
    sweep(
        "Noise of the bearing",
        "rad",
        POLICIES,
        {at: {"noise.bearing_noise": at} for at in (0.0, 0.005, 0.01, 0.02, 0.05, 0.1)},
    ),
    sweep(
        "Noise of the distance",
        "error / distance², 1/m",
        POLICIES,
        {at: {"noise.depth_noise": at} for at in (0.0, 0.005, 0.01, 0.02, 0.04, 0.08)},
    ),
    sweep(
        "Time to a name",
        "s, kept for 0.3 s",
        POLICIES,
        {at: {"camera.identify": at, "camera.coast": 0.3} for at in (0.0, 0.3, 1.0, 2.0, 4.0, 8.0)},
    ),
    sweep(
        "False detections",
        "1/s, a name after 0.3 s",
        POLICIES,
        {at: {"camera.false_rate": at, **_NAMED} for at in (0.0, 0.5, 2.0, 8.0, 32.0, 100.0)},
    ),
    sweep(
        "Gate",
        "m, a name after 1 s, kept for 0.3 s",
        POLICIES,
        {at: {"camera.gate": at, **_NAMED, "camera.identify": 1.0} for at in (0.1, 0.3, 1.0, 2.0, 4.0)},
    ),
)


def study() -> Study:
    """All points of all panels, each task once."""
    return Study("cameras", SEEDS, tasks_of(PANELS, len(SEEDS)))
