"""What a file of finished episodes must hold, whoever wrote it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_array, check_keys, check_texts
from fovconn_env.files import Damaged, one_line
from fovconn_env.flights.metrics import ENDED, ERRORS, N_BINS
from fovconn_env.training.evaluation.flights import MEANS, SHARES
from fovconn_env.training.evaluation.record import UNITS

_NEEDED = ("seeds", "histograms", *SHARES, *MEANS, "least_separation", "yaw_rms_mutual", "yaw_rms_one_way")
_OTHERS = tuple(name for names in UNITS for name in names.split())


def check_file(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray], path: str) -> None:
    """`Damaged` for what is no file of finished episodes; path: its name in errors."""
    try:
        check_keys("header", header, ("policy", "scenario", "files"))
        check_texts("policy and scenario", [header["policy"], header["scenario"]])
        files = header["files"]
        hashes = isinstance(files, dict) and all(isinstance(was, str) and was.isprintable() for was in files.values())
        rule(hashes, "files", "hashes by name", type(files).__name__, "what the policy has read")
        check_episodes(arrays, others=("times",))
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem


def check_episodes(arrays: Mapping[str, np.ndarray], *, others: tuple[str, ...] = ()) -> None:
    """Seeds, each once, histograms, and a number for each measure and seed; others: further (E,) int64 arrays.

    Raises `SettingError`.
    """
    own = [name for name in arrays if name.startswith(ENDED)]
    check_texts("names of measures", own)
    check_keys("arrays", arrays, (*_NEEDED, *others), (*_OTHERS, *own))
    check_array("seeds", arrays["seeds"], "i8", (-1,))
    seeds = arrays["seeds"]
    once = bool((seeds >= 0).all()) and len(np.unique(seeds)) == len(seeds)
    rule(once, "seeds", "at least 0, each once", seeds[:3].tolist(), "one an episode")
    for name, array in arrays.items():
        if name == "histograms":
            check_array(name, array, "u4", (len(seeds), len(ERRORS), N_BINS))
            continue
        check_array(name, array, "i8" if name in ("seeds", *others) else "f8", (len(seeds),), finite=False)
        rule(not np.isinf(array).any(), name, "numbers or NaN", "infinity", "a measure without a value is NaN")
    for name in (*SHARES, *own):
        known = bool(np.isin(arrays[name], (0.0, 1.0)).all())
        rule(known, name, "0 or 1", arrays[name][:3].tolist(), "yes or no")
