"""Many evaluations at once: the same numbers whatever the processes, nothing flown twice, nothing lost."""

from pathlib import Path

import numpy as np
import pytest

from fovconn_env import HARD, PRESETS, scenario
from fovconn_env.baselines import ORACLES, POLICIES
from fovconn_env.errors import SettingError
from fovconn_env.training.evaluation import campaign, evaluate
from fovconn_env.training.evaluation.campaign import fly_cells, parse_seeds, seeds_of, suite
from fovconn_env.training.evaluation.record import load
from fovconn_env.training.evaluation.shelf import Cell, Shelf, code_hash, fingerprint

ROOT = Path(__file__).parents[2]
TINY = {"n_agents": 3, "max_cycles": 30, "warmup": 0.2}
TASK = scenario("LeaderFollow-v0", **TINY)
pytestmark = pytest.mark.usefixtures("warm")
CELLS = [Cell("expert", TASK), Cell("oracle", TASK), Cell("expert", scenario("Regroup-v0", **TINY))]


def same(a, b):
    assert (a.policy, a.seeds) == (b.policy, b.seeds)
    assert a.scenario == b.scenario
    assert a.episodes.keys() == b.episodes.keys()
    for name, values in a.episodes.items():
        np.testing.assert_array_equal(values, b.episodes[name], err_msg=name)
    np.testing.assert_array_equal(a.histograms, b.histograms)


def kept(folder, cell):
    """Seeds of the episodes that a folder has of a cell."""
    flown, changed = Shelf(folder).load(cell)
    assert changed == []
    return flown.evaluation.seeds


@pytest.fixture
def blocks(monkeypatch):
    """Two episodes a block, so that there is something to hand out."""
    monkeypatch.setattr(campaign, "BLOCK", 2)


def test_same_numbers_on_any_number_of_processes(blocks):
    seeds = [4, 0, 7, 1, 2]
    told = []
    one, two = (fly_cells(CELLS, seeds, processes=k, progress=told.append) for k in (1, 2))
    assert [result.policy for result in two] == ["expert", "oracle", "expert"]
    for a, b, cell in zip(one, two, CELLS, strict=True):
        same(a, b)
        same(a, evaluate(cell.policy, cell.scenario, seeds))
    assert told[0] >= 0
    assert told[-1] == len(CELLS) * len(seeds)


def test_a_scenario_is_told_of_once_when_it_is_complete(blocks, tmp_path):
    def told(seeds, **options):
        groups = []
        results = fly_cells(CELLS, seeds, folder=tmp_path, processes=1, complete=groups.append, **options)
        assert sorted(group[0].scenario.name for group in groups) == ["LeaderFollow-v0", "Regroup-v0"]
        for group in groups:
            there = [result for result in results if result.scenario == group[0].scenario]
            for a, b in zip(group, there, strict=True):
                same(a, b)

    told([4, 0, 7])
    told([0, 4, 5])  # some are on disk
    told([0, 5])  # all are


def test_files_of_a_scenario_with_any_name_stay_in_their_folder(tmp_path):
    out, cell = tmp_path / "a" / "out", Cell("expert", scenario(TASK, name="../../x/y: ü", max_cycles=2))
    fly_cells([cell], [0], folder=out, recordings=out)
    assert sorted(path.suffix for path in out.iterdir()) == ["", ".npz", ".npz"]  # the lock, a flight, its episodes
    assert [path for path in tmp_path.rglob("*") if path.is_file() and path.parent != out] == []
    assert kept(out, cell) == [0]


def test_seeds_of_an_evaluation_may_be_of_any_integer_type():
    wanted = evaluate("expert", TASK, [254, 255])
    for seeds in (np.array([254, 255], np.uint8), (np.uint8(254), np.int16(255)), range(254, 256)):
        found = evaluate("expert", TASK, seeds)
        same(found, wanted)
        assert {type(seed) for seed in found.seeds} == {int}
    for wrong in ([], np.array([])):
        with pytest.raises(ValueError, match="seeds must be one at least"):
            evaluate("expert", TASK, wrong)
    for wrong in ([1.0], [True], [2**63], ["7"], [-1]):
        with pytest.raises(ValueError, match="seed must be"):
            evaluate("expert", TASK, wrong)


def test_what_is_there_is_not_flown_again(tmp_path, monkeypatch, blocks):
    first = fly_cells(CELLS[:1], range(4), folder=tmp_path)
    (file,) = tmp_path.glob("*.npz")
    more = fly_cells(CELLS[:1], [5, 3, 0], folder=tmp_path)  # two of them are there
    assert kept(tmp_path, CELLS[0]) == [0, 1, 2, 3, 5]
    same(more[0], evaluate("expert", TASK, [5, 3, 0]))
    monkeypatch.setattr(campaign, "run_orders", None)  # nothing flies any more
    same(fly_cells(CELLS[:1], range(4), folder=tmp_path)[0], first[0])
    with pytest.raises(TypeError):
        fly_cells(CELLS[:1], range(4), folder=tmp_path, fresh=True)
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(ValueError, match=r"is damaged .*; delete it"):
        fly_cells(CELLS[:1], range(4), folder=tmp_path)


def test_another_setting_or_other_code_is_another_file(tmp_path):
    mine = tmp_path / "mine.py"
    text = "from fovconn_env.baselines import Expert\nclass Mine(Expert):\n    '''Mine.'''\n"
    mine.write_text(text)
    cells = [*CELLS, Cell("expert", scenario(TASK, stick_speed=0.9)), Cell(f"{mine}:Mine", TASK)]
    prints = [fingerprint(cell) for cell in cells]
    assert len(set(prints)) == len(cells)
    mine.write_text(text + "    overrides = {}\n")
    assert fingerprint(cells[-1]) != prints[-1]
    mine.write_text(text)
    assert [fingerprint(cell) for cell in cells] == prints


def test_the_fingerprint_is_of_the_code_that_flies(tmp_path):
    """Each file once, through links, too."""
    root, away = tmp_path / "fovconn_env", tmp_path / "baselines"
    for folder in (root / "render" / "live", root / "training", root / "kernel", away):
        folder.mkdir(parents=True)
        (folder / "a.py").write_text("1")
    (root / "baselines").symlink_to(away)
    before = code_hash.__wrapped__(root)
    for file, changes in (
        (root / "render" / "live" / "a.py", False),
        (root / "training" / "a.py", False),
        (root / "kernel" / "a.txt", False),
        (root / "kernel" / "a.py", True),
        (away / "a.py", True),
    ):
        file.write_text("2")
        after = code_hash.__wrapped__(root)
        assert (after != before) == changes, file
        before = after
    (root / "kernel" / "a.py").rename(root / "kernel" / "b.py")
    assert code_hash.__wrapped__(root) != before


BROKEN = """
import numpy as np
from fovconn_env.baselines import Policy
class Broken(Policy):
    '''Breaks.'''
    def decide(self, flat):
        actions = np.zeros((len(flat), 4))
        if self.rows(flat).own["vx"].any() or CASE == "shape" or CASE == "error":
            if CASE == "nan":
                actions[7, 2] = np.nan
            if CASE == "shape":
                return actions[:, :3]
            if CASE == "error":
                return 1 / 0
        return actions
"""
COMPLAINTS = {
    "nan": r"policy Broken must return finite actions, got .*nan.* for uav_1 on LeaderFollow-v0, seed 2, step \d+",
    "shape": r"policy Broken failed on LeaderFollow-v0 in step 0: Broken.decide must return the shape \(12, 4\)",
    "error": r"policy Broken failed on LeaderFollow-v0 in step 0: ZeroDivisionError: division by zero",
}


@pytest.mark.parametrize("case", COMPLAINTS)
def test_a_policy_that_breaks_is_named_and_the_others_are_kept(tmp_path, case):
    moving = scenario(TASK, **{"course.settle": 0.0})
    (tmp_path / "broken.py").write_text(f"CASE = {case!r}\n{BROKEN}")
    cells = [Cell("expert", moving), Cell(f"{tmp_path}/broken.py:Broken", moving)]
    with pytest.raises(ValueError, match=COMPLAINTS[case]):
        fly_cells(cells, range(4), folder=tmp_path / "kept", processes=1)
    assert kept(tmp_path / "kept", cells[0]) == [0, 1, 2, 3]
    assert len(list((tmp_path / "kept").glob("*.npz"))) == 1


@pytest.mark.parametrize("second", ["Mine", "MINE"])
def test_two_policies_of_one_name_are_told_apart_by_nobody(tmp_path, second):
    """Names that differ in case only are one to marl-eval and to some file systems: refused before anything flies."""
    for file, name in {"a": "Mine", "b": second}.items():
        text = f"from fovconn_env.baselines import Expert\nclass {name}(Expert):\n    'Mine.'\n"
        (tmp_path / f"{file}.py").write_text(text)
    with pytest.raises(ValueError, match=r"policies must have different names, got .*a.py. and .*b.py.: rename"):
        fly_cells([Cell(str(tmp_path / f"{file}.py"), TASK) for file in "ab"], [0])


def test_a_name_with_a_comma_is_refused_before_anything_flies(tmp_path):
    (tmp_path / "a,b.py").write_text("def act(flat):\n    raise AssertionError\n")
    with pytest.raises(ValueError, match=r"the name of policy '.*a,b\.py' must be without a comma, got 'a,b'"):
        fly_cells([Cell(str(tmp_path / "a,b.py"), TASK)], [0])


def test_seeds_from_words():
    assert parse_seeds("0-3") == [0, 1, 2, 3]
    assert parse_seeds("7") == [7]
    assert parse_seeds("5-6, 1,6-7") == [5, 6, 1, 7]
    for bad in ("", "3-1", "-4", "1..3", "a", "1,,2", "1-"):
        with pytest.raises(ValueError, match=r"seeds must be like 0-319, 7 or 0-31,100-131, got"):
            parse_seeds(bad)
    assert parse_seeds(f"{2**63 - 1}") == [2**63 - 1]
    for big in (f"{2**63}", "0-9223372036854775808", "9" * 5000, f"7,{10**19}-{10**19 + 1}"):
        with pytest.raises(ValueError, match=r"seeds must be at most 2\*\*63 - 1, got"):
            parse_seeds(big)
    for many in ("0-1000000", "0-999999,1000000", "0-4000000000000000000"):
        with pytest.raises(ValueError, match="seeds must be at most 1000000, got"):
            parse_seeds(many)


def test_suites():
    policies, scenarios, seeds = suite("quick")
    assert policies == list(POLICIES)
    assert "LeaderFollow-v0" in scenarios
    assert len(set(scenarios)) == 4
    assert suite("full")[1] == list(PRESETS)
    assert seeds == suite("full")[2][:32]
    assert suite("full")[2] == list(range(320))
    assert suite("hard") == suite("hard-v1") == ([*POLICIES, *ORACLES], list(HARD), list(range(320)))
    assert suite("hard", ["mine.py"], ["oracle-planner"])[0] == ["oracle-planner", "mine.py"]
    with pytest.raises(SettingError, match="--only must be a policy or a scenario of the suite quick"):
        suite("quick", [], ["oracle-planner"])
    assert seeds_of(scenario("ScaleUp-v0", level=4), range(320)) == list(range(64))
    assert seeds_of(scenario("ScaleUp-v0", level=3), range(320)) == list(range(320))
    with pytest.raises(SettingError, match="suite must be one of quick, full, hard-v1, hard, got 'fast'"):
        suite("fast")


def test_cells_fly_seeds_of_their_own(blocks, tmp_path):
    """Each its own, in their order; what is kept counts for the cells that want it."""
    seeds = {CELLS[0]: [3, 0, 1], CELLS[1]: [2], CELLS[2]: [5, 4]}
    told, said = [], []
    fly_cells(CELLS[:1], [0, 7], folder=tmp_path, processes=1)
    results = fly_cells(CELLS, seeds, folder=tmp_path, processes=1, progress=told.append, say=said.append)
    assert [result.seeds for result in results] == list(seeds.values())
    assert [result.reused and result.reused.count for result in results] == [1, None, None]
    assert said == [line for line in said if line.startswith("1 episode reused")] != []
    assert (min(told) >= 1, told[-1]) == (True, 6)
    for result, cell in zip(results, CELLS, strict=True):
        same(result._replace(reused=None), evaluate(cell.policy, cell.scenario, seeds[cell]))


def test_large_teams_of_a_suite_fly_fewer_seeds(fovconn, undrawn, monkeypatch):
    """The record has the longest list of seeds, of which each result has the first; given seeds are for all."""
    tasks = "LeaderFollow-v0", "ScaleUp-v0"
    monkeypatch.setitem(campaign.SUITES, "hard-v1", campaign.Suite(tasks, range(3)))
    monkeypatch.setattr(campaign, "LARGE", 3)
    monkeypatch.setattr(campaign, "FEW", 2)
    tiny = ("--only", "expert", "--set", "max_cycles=3", "--set", "warmup=0.1", "--processes", "1")
    assert fovconn("eval", "--suite", "hard", *tiny, "--out", "all").status == 0
    monkeypatch.setattr(campaign, "LARGE", 6)
    shown = fovconn("eval", "--suite", "hard", *tiny, "--out", "some")
    assert shown.status == 0
    assert "LeaderFollow-v0, 2 seeds" in shown.out
    assert "ScaleUp-v0, 3 seeds" in shown.out
    assert fovconn("eval", "--suite", "hard", *tiny, "--seeds", "0-3", "--out", "given").status == 0
    found = {name: load(Path(name) / "results.json") for name in ("all", "some", "given")}
    assert {name: [result.count for result in record.results] for name, record in found.items()} == {
        "all": [2, 2],
        "some": [2, 3],
        "given": [4, 4],
    }
    assert [record.seeds for record in found.values()] == [[0, 1], [0, 1, 2], [0, 1, 2, 3]]


def test_a_suite_can_be_restricted():
    """Of policies or scenarios all are flown unless one of their kind is named; a user's own always."""
    own = ["mine.py:Mine", "expert"]
    every, four, _ = suite("quick")
    assert suite("quick", own)[:2] == ([*every, "mine.py:Mine"], four)
    assert suite("quick", own, ["oracle"])[:2] == (["oracle", *own], four)
    assert suite("quick", own, ["mine.py:Mine"])[:2] == (own, four)
    assert suite("quick", own, ["Blackout-v0"])[:2] == ([*every, "mine.py:Mine"], ["Blackout-v0"])
    only = ["fovconn/Blackout-v0", "springs", "LeaderFollow-v0"]
    assert suite("quick", [], only)[:2] == (["springs"], ["LeaderFollow-v0", "Blackout-v0"])
    for bad, hint in (
        ("exprt", "did you mean 'expert'"),
        ("Mix-v0", "there are zero, random"),
        ("", "there are zero, random"),
    ):
        with pytest.raises(SettingError, match=rf"--only must be a policy or a scenario of the suite quick, .*{hint}"):
            suite("quick", own, [bad])


def test_files_of_a_policy_with_any_name_stay_in_their_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = "from fovconn_env.baselines import Expert\nMine = type('x' * 300 + '/../y', (Expert,), {})\n"
    Path("mine.py").write_text(own)
    out, cell = tmp_path / "a" / "out", Cell("mine.py:Mine", scenario(TASK, max_cycles=2))
    fly_cells([cell], [0], folder=out, recordings=out)
    assert [path.parent for path in tmp_path.rglob("*.npz")] == [out, out]
