"""docs/learning_curves.py: each of its trainings in small, and the record that docs/recipes/curves.md shows."""

import json
import sys
from importlib import util

import numpy as np
import pytest

from tests.integrations import ROOT


@pytest.fixture(scope="module")
def script():
    pytest.importorskip("matplotlib")
    path = ROOT / "docs" / "learning_curves.py"
    spec = util.spec_from_file_location("learning_curves", path)
    before = list(sys.path)
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = before


@pytest.fixture(scope="module")
def record():
    return json.loads((ROOT / "docs" / "results" / "curves" / "libraries.json").read_text("utf-8"))


NEEDS = {"Stable-Baselines3": "stable_baselines3", "sb3-contrib": "sb3_contrib", "BenchMARL": "benchmarl"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("method", ["PPO", "RecurrentPPO", "SAC", "TQC", "IPPO", "MAPPO"])
def test_a_method_trains_and_is_scored(method, script, tmp_path, monkeypatch):
    """Before and at the end, which is flown by what was trained."""
    pytest.importorskip(NEEDS[script.METHODS[method][0]])
    monkeypatch.setattr(script, "FLOWN", {"curve": range(2), "end": range(3)})
    found = script.run(method, 0, 6144, 1, tmp_path)
    assert found.keys() == {"minutes", "step_0", "step_1", "absolute_metrics"}
    assert found["step_0"]["step_count"] == 0
    assert found["step_1"]["step_count"] == pytest.approx(6144, rel=0.02)
    assert all(len(found["step_1"][metric]) == 2 for metric in script.METRICS)
    assert all(len(found["absolute_metrics"][metric]) == 3 for metric in script.METRICS)
    assert found["step_0"]["return"] != found["step_1"]["return"]
    assert (tmp_path / f"{method}-0{script.suffix(method)}").is_file()


def test_the_record_is_what_the_page_says(script, record):
    """Equal steps, the same seeds and metrics everywhere: what marl-eval wants, too."""
    ((task, methods),) = record["fovconn"].items()
    assert task == script.BASE
    assert list(methods) == [method for method in script.METHODS if method in methods]
    assert len(methods) >= 2
    for seeds in methods.values():
        assert list(seeds) == [f"seed_{seed}" for seed in script.SEEDS]
        for found in seeds.values():
            assert list(found) == [*(f"step_{k}" for k in range(script.SCORES + 1)), "absolute_metrics"]
            steps = [found[f"step_{k}"].pop("step_count") for k in range(script.SCORES + 1)]
            np.testing.assert_allclose(steps, np.linspace(0, script.STEPS, script.SCORES + 1), atol=7000)
            for name, part in found.items():
                flights = script.FLOWN["end" if name == "absolute_metrics" else "curve"]
                counts = {metric: len(values) for metric, values in part.items()}
                assert counts == dict.fromkeys(script.METRICS, len(flights))


def test_without_all_trainings_nothing_is_published(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(script, "publish", lambda runs: pytest.fail("it was published"))
    assert script.main(["--methods", "--out", str(tmp_path)]) == 0
    assert "nothing is published" in capsys.readouterr().out
