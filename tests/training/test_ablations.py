"""Studies of what each part is worth: every point can fly, and table, record and picture say what was flown."""

import json
from pathlib import Path

import pytest
from PIL import Image

from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.training.evaluation import ablation_picture, ablations, evaluate
from fovconn_env.training.evaluation.ablations import STUDIES, Point, Study, cells

TINY = {"n_agents": 3, "max_cycles": 30, "warmup": 0.2}


def test_every_point_can_fly():
    """Equipment and settings fit together, no point is flown twice, and every line has a look of its own."""
    found = cells()
    assert len(set(found)) == len(found)
    for cell in found:
        assert cell.policy in POLICIES
        find_policy(cell.policy).equip(cell.scenario)
    points = [point for study in STUDIES for point in study.points]
    assert len(found) < len(points)  # the defaults are part of several studies
    lines = {point.policy for study in STUDIES if study.axis for point in study.points}
    assert lines == set(ablation_picture._STYLE)


def test_message_rates_are_what_the_axis_says():
    (study,) = [study for study in STUDIES if study.title == "Message rate"]
    for point in study.points:
        clock = ablations._cell(point).scenario.clock
        assert point.at == pytest.approx(clock.rounds / clock.tick)
        assert clock.tick * clock.ticks == pytest.approx(0.05)


def test_figures_command(fovconn, monkeypatch):
    """Two studies that share a point; the command draws, writes and prints them."""
    sweep = [Point(policy, policy, float(n), {**TINY, "n_agents": n}) for policy in ("expert", "omni") for n in (2, 3)]
    studies = (Study("Switch", "", [Point("expert", "as it is", None, TINY)]), Study("Sweep", "N", sweep))
    monkeypatch.setattr(ablations, "STUDIES", studies)
    monkeypatch.setattr(ablation_picture, "STUDIES", studies)
    monkeypatch.setitem(ablation_picture._STYLE, "omni", ("#000000", "v:"))
    assert len(cells()) == 4
    shown = fovconn("figures", "--ablations", "--seeds", "0-2", "--out", "drawn", "--json", "record.json")
    assert shown.status == 0
    assert "Sweep, N" in shown.out
    with Image.open("drawn/ablations.png") as picture:
        assert picture.width > 1000
    record = json.loads(Path("record.json").read_text())
    assert record == json.loads(Path("drawn/ablations.json").read_text())
    assert record["seeds"] == [0, 1, 2]
    assert [row[:3] for row in record["rows"]] == [
        ["Switch", "as it is", "expert"],
        *(["Sweep, N", f"{n}", policy] for policy in ("expert", "omni") for n in (2, 3)),
    ]
    for row, cell in zip(record["rows"][:3:2], (cells()[0],) * 2, strict=True):
        episodes = evaluate(cell.policy, cell.scenario, range(3)).episodes
        assert row[3].startswith(f"{100 * episodes['never_disconnected'].mean():.0f} [")
        assert row[5] == f"{episodes['progress'].mean():.2f}"
