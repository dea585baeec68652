"""Finished episodes with right checksums that no campaign leaves: refused in one line."""

import numpy as np
import pytest

from fovconn_env import scenario
from fovconn_env.errors import SettingError
from fovconn_env.files import Damaged
from fovconn_env.training.evaluation import evaluate
from fovconn_env.training.evaluation.episode_checks import check_episodes, check_file


@pytest.fixture(scope="module")
def arrays():
    flown = evaluate("expert", scenario(n_agents=2, max_cycles=3, warmup=0.1), [0, 1])
    return {"seeds": np.array(flown.seeds), "histograms": flown.histograms, **flown.episodes}


HOSTILE = {
    "gone": ({"success": None}, "with 'success'"),
    "seeds gone": ({"seeds": None}, "with 'seeds'"),
    "more": ({"code": np.zeros(2)}, "got 'code'"),
    "seeds twice": ({"seeds": np.array([1, 1])}, "seeds must be at least 0, each once"),
    "seeds below": ({"seeds": np.array([-1, 1])}, "seeds must be at least 0, each once"),
    "seeds as floats": ({"seeds": np.array([0.0, 1.0])}, "seeds must be of the type int64"),
    "texts": ({"sct": np.array(["a", "b"])}, "sct must be of the type float64"),
    "fewer": ({"sct": np.zeros(1)}, r"sct must be of the shape \(2\)"),
    "deeper": ({"sct": np.zeros((2, 1))}, r"sct must be of the shape \(2\)"),
    "infinite": ({"sct": np.array([np.inf, 0])}, "sct must be numbers or NaN"),
    "shares": ({"success": np.array([0.5, 0])}, "success must be 0 or 1"),
    "bins": ({"histograms": np.zeros((2, 3, 5), "u4")}, "histograms must be of the shape"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_arrays_of_no_campaign_are_refused(case, arrays):
    changes, message = HOSTILE[case]
    check_episodes(arrays)
    wrong = {name: array for name, array in {**arrays, **changes}.items() if array is not None}
    with pytest.raises(SettingError, match=message):
        check_episodes(wrong)


@pytest.mark.parametrize("files", [None, [], {"a.py": 1}, {"a.py": "\x1b[2J"}])
def test_headers_of_no_campaign_are_refused(files, arrays):
    times = {"times": np.array([1, 2])}
    header = {"policy": "expert", "scenario": "LeaderFollow-v0", "files": {"a.py": "0f"}}
    check_file(header, {**arrays, **times}, "e.npz")
    with pytest.raises(Damaged, match=r"^e\.npz is damaged: files must be hashes by name"):
        check_file(header | {"files": files}, {**arrays, **times}, "e.npz")
    with pytest.raises(Damaged, match="with 'times'"):
        check_file(header, arrays, "e.npz")
