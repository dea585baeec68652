"""What was flown and what came of it, as one JSON-ready record."""

from __future__ import annotations

import dataclasses
import math
import os
import platform
import time
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np

import fovconn_env
from baselines import find_policy
from fovconn_env import Map
from fovconn_env.metrics import ERRORS, bin_edges
from training.evaluation import Evaluation, label, summary

FORMAT = 1  # of the record; a change of its structure counts it up


def to_json(evaluations: Sequence[Evaluation], policies: Sequence[str], seconds: float) -> dict[str, Any]:
    """The record of a campaign; `run` is the only part that differs between two runs of the same code.

    policies: as `find_policy` takes them, of these evaluations.
    """
    seeds = evaluations[0].seeds
    return {
        "format": FORMAT,
        "fovconn_env": fovconn_env.__version__,
        "seeds": seeds,
        "policies": {label(policy): about(policy) for policy in policies},
        "scenarios": {item.scenario.name: plain(item.scenario) for item in evaluations},
        "histogram_bins": bin_edges().tolist(),
        "evaluations": [
            {
                "policy": item.policy,
                "scenario": item.scenario.name,
                "summary": {name: _clean(value) for name, value in summary(item).items()},
                "episodes": {name: [_clean(x) for x in values.tolist()] for name, values in item.episodes.items()},
                "histograms": dict(zip(ERRORS, item.histograms.sum(0).tolist(), strict=True)),
            }
            for item in evaluations
        ],
        "run": run_block(seconds),
    }


def run_block(seconds: float) -> dict[str, Any]:
    """When and where something was flown."""
    return {
        "seconds": round(seconds, 2),
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
    }


def about(policy: str) -> dict[str, Any]:
    """What a policy is: its purpose, what its team is equipped with, and whether it is an oracle."""
    kind = find_policy(policy)
    purpose = (kind.__doc__ or "").partition("\n")[0]
    return {"purpose": purpose, "overrides": dict(kind.overrides), "oracle": kind.oracle}


def plain(settings: Any) -> Any:
    """Settings as JSON-ready values; a map of the user's own as its pieces."""
    if isinstance(settings, Map):
        pieces, vertices = settings.flatten()
        return {"pieces": pieces.tolist(), "vertices": vertices.tolist()}
    if dataclasses.is_dataclass(settings):
        return {item.name: plain(getattr(settings, item.name)) for item in dataclasses.fields(settings)}
    return _clean(settings.item() if isinstance(settings, np.generic) else settings)


def _clean(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
