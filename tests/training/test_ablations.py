"""Studies of what each part is worth: every point can fly, and table, record and picture say what was flown."""

from pathlib import Path

import pytest
from PIL import Image

from fovconn_env import scenario
from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.training.evaluation import ablation_picture, ablations, evaluate, tables
from fovconn_env.training.evaluation.ablations import PANELS, Panel, Point, study
from fovconn_env.training.evaluation.record import load

TINY = {"n_agents": 3, "max_cycles": 30, "warmup": 0.2}


def test_every_point_can_fly():
    """Equipment and settings fit, points with equal settings share a cell, and every line has a style."""
    cells = {task.cell() for task in study(range(3)).tasks}
    for cell in cells:
        assert cell.policy in POLICIES
        find_policy(cell.policy).equip(cell.scenario)
    assert len(cells) < len({(*point.task[:2], str(point.changes)) for panel in PANELS for point in panel.points})
    lines = {point.policy for panel in PANELS if panel.axis for point in panel.points}
    assert lines == set(ablation_picture._STYLE)


def test_message_rates_are_what_the_axis_says():
    (panel,) = [panel for panel in PANELS if panel.title == "Message rate"]
    for point in panel.points:
        clock = scenario(ablations.BASE, **point.changes).clock
        assert point.at == pytest.approx(clock.rounds / clock.tick)
        assert clock.tick * clock.ticks == pytest.approx(0.05)


def test_figures_command(fovconn, monkeypatch):
    """Two studies that share a point; the command draws, writes and prints them."""
    sweep = [Point(policy, policy, float(n), {**TINY, "n_agents": n}) for policy in ("expert", "omni") for n in (2, 3)]
    panels = (Panel("Switch", "", [Point("expert", "as it is", None, TINY)]), Panel("Sweep", "N", sweep))
    for module in (ablations, ablation_picture, tables):
        monkeypatch.setattr(module, "PANELS", panels)
    monkeypatch.setitem(ablation_picture._STYLE, "omni", ("#000000", "v:"))
    assert len({task.cell() for task in study(range(3)).tasks}) == 4
    shown = fovconn("figures", "--ablations", "--seeds", "0-2", "--out", "drawn", "--json", "record.json")
    assert shown.status == 0
    assert "Sweep, N" in shown.out
    with Image.open("drawn/ablations.png") as picture:
        assert picture.width > 1000
    record = load(Path("record.json"))
    assert record == load(Path("drawn/ablations.json"))
    assert record.seeds == [0, 1, 2]
    for row, point in zip(tables.ablation_table(record)[1], [panels[0].points[0], *sweep], strict=True):
        result = record.find(*point.task)
        episodes = evaluate(point.policy, scenario(ablations.BASE, **point.changes), range(3)).episodes
        assert result.measures["never_disconnected"].value == episodes["never_disconnected"].mean()
        assert row[2] == point.policy
        assert row[5] == f"{episodes['progress'].mean():.2f}"
