"""Studies of what each part is worth: every point can fly, and table, record and picture say what was flown."""

import dataclasses
from pathlib import Path

import pytest
from PIL import Image

from fovconn_env import scenario
from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.training.evaluation import ablation_picture, ablations, cameras, evaluate, tables
from fovconn_env.training.evaluation.ablations import PANELS, Panel, Point, study
from fovconn_env.training.evaluation.record import load
from fovconn_env.training.evaluation.study import fly, record

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


# --------------------------------------------------------------------------------------------------------- cameras
def test_every_camera_can_fly():
    """Each sweep changes one setting of the camera, and its points are all cameras that are allowed."""
    tasks = cameras.study().tasks
    assert len({task.cell() for task in tasks}) <= len(tasks)
    for panel in cameras.PANELS:
        settings = [scenario(ablations.BASE, **point.changes) for point in panel.points]
        changed = {
            (group, field.name)
            for group in ("camera", "noise")
            for field in dataclasses.fields(getattr(settings[0], group))
            if len({getattr(getattr(each, group), field.name) for each in settings}) > 1
        }
        assert len(changed) == 1, panel.title
        ((group, name),) = changed
        assert [getattr(getattr(each, group), name) for each in settings] == [point.at for point in panel.points]


def test_the_study_of_cameras(tmp_path, monkeypatch):
    """Flown, drawn and tabled: what stands there is what the flights were worth."""
    settings = {at: {**TINY, "camera.latency": at} for at in (0.0, 0.1)}
    panels = tuple(ablations.sweep(title, "s", ("expert", "augmented"), settings) for title in ("One", "Two"))
    monkeypatch.setattr(cameras, "PANELS", panels)
    monkeypatch.setattr(cameras, "SEEDS", range(2))
    made = record(cameras.study(), fly(cameras.study(), tmp_path / "flights", lambda *_: None), 1.0)
    assert len(made.results) == 4
    for measure, label in cameras.MEASURES.items():
        path = ablation_picture.draw_sweeps(made, panels, measure, label, tmp_path / f"{measure}.png", "about")
        with Image.open(path) as picture:
            assert picture.width > 1000
    head, rows = tables.camera_table(made)
    assert len(rows) == 8
    for row, point in zip(rows, [point for panel in panels for point in panel.points], strict=True):
        episodes = evaluate(point.policy, scenario(ablations.BASE, **point.changes), range(2)).episodes
        assert len(row) == len(head)
        assert row[head.index("named share")] == f"{episodes['named_share'].mean():.3f}"
        assert row[head.index("point")] == f"{point.at:g}"
