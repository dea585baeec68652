"""A stored result belongs to what ran: code, what it imports, and the files that it reads, when it reads them."""

import glob
import os
import shutil
import sqlite3
import zipfile
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from fovconn_env import scenario
from fovconn_env.baselines import find_policy
from fovconn_env.errors import SettingError
from fovconn_env.files import Archive, Damaged, read_archive, write_archive
from fovconn_env.training.evaluation import provenance
from fovconn_env.training.evaluation.campaign import fly_cells
from fovconn_env.training.evaluation.flights import Reused, reuse_line
from fovconn_env.training.evaluation.provenance import Reads, changed, merge, packages, sources, torn
from fovconn_env.training.evaluation.shelf import EVALUATION, Cell, Flown, Shelf, fingerprint
from fovconn_env.training.evaluation.study import Study, record

TASK = scenario("LeaderFollow-v0", n_agents=3, max_cycles=20, warmup=0.1)
pytestmark = pytest.mark.usefixtures("warm")
POLICY = """
import numpy as np
from fovconn_env.baselines import Policy
{head}
class Mine(Policy):
    '''Mine.'''
    def __init__(self, scenario):
        super().__init__(scenario)
        {made}
    def decide(self, flat):
        {flown}
        return np.full((len(flat), 4), {gain}, np.float32)
"""


@pytest.fixture(scope="module")
def reads():
    """The hook; it cannot be taken off, but does nothing while no policy flies."""
    return Reads()


@pytest.fixture
def noticed(reads, tmp_path, monkeypatch):
    """Names of the files that count for a policy, written as code; and its class."""
    monkeypatch.chdir(tmp_path)

    def fly(head="", made="pass", flown="pass", gain="0.0", name="mine"):
        (tmp_path / f"{name}.py").write_text(POLICY.format(head=head, made=made, flown=flown, gain=gain))
        reads.policy = f"{tmp_path}/{name}.py:Mine"  # another one in each test
        try:
            kind = find_policy(reads.policy)
            kind(TASK).act(np.zeros((2, TASK.observation_size), np.float32))
            files = reads.of(reads.policy, kind)
        finally:
            reads.policy = ""
        names = {os.path.relpath(path, tmp_path): was for path, was in files.items()}
        assert names.pop(f"{name}.py")
        return names

    return fly


READ = {
    "text": "open('w').close()",
    "bytes": "__import__('pathlib').Path('w').read_bytes()",
    "descriptor": "__import__('os').close(__import__('os').open(b'w', 0))",
    "array": "np.fromfile('w', np.uint8)",
    "mapped": "np.memmap('w', np.uint8)",  # opened for writing as well
    "zip": "__import__('zipfile').ZipFile('w').namelist()",
    "absolute": "open(__import__('os').path.abspath('w')).close()",
    "a package's": "__import__('tokenize').open('w').close()",
    "in C": "__import__('safetensors.numpy').numpy.load_file('w')",
    "in a thread": "(t := __import__('threading').Thread(target=np.fromfile, args=('w', 'u1'))).start(); t.join()",
}


@pytest.mark.parametrize("when", ["head", "made", "flown"])
@pytest.mark.parametrize("how", READ)
def test_a_file_that_is_read_counts(noticed, tmp_path, how, when):
    """While the module is run, when a policy is made, or as it flies."""
    place = tmp_path / "w"
    with zipfile.ZipFile(place, "w") as members:
        members.writestr("a", "1")
    if how == "a package's":
        place.write_text("1")
    if how == "in C":
        save_file({"a": np.ones(3)}, place)
    names = noticed(**{when: READ[how]})
    assert set(names) == {"w"}
    assert names["w"] == provenance.digest(str(place))
    place.write_bytes(b"2" + place.read_bytes()[1:])
    assert names["w"] != provenance.digest(str(place))


def test_what_does_not_count(noticed, tmp_path):
    """What it writes, devices, pipes, descriptors, the package, the standard library, what is installed."""
    head = """
import os, fovconn_env, numba, json, typer
open("log", "w").close(); open("log").close()
open("log2", "a").close(); open("log2").close()
open(os.devnull).close(); open("/proc/self/status").close(); os.urandom(1)
read, write = os.pipe(); open(read).close(); os.close(write)
for module in (fovconn_env, json, typer): open(module.__file__).close()
try: open(chr(0))
except ValueError: pass
"""
    assert noticed(head) == {}


def test_a_file_that_is_named_in_parts_counts(noticed, tmp_path):
    """Read in C, from a folder beside the policy."""
    (tmp_path / "weights").mkdir()
    save_file({"a": np.ones(3)}, tmp_path / "weights" / "w")
    head = "from pathlib import Path\nfrom safetensors.numpy import load_file"
    assert set(noticed(head, "load_file(Path(__file__).parent / 'weights' / 'w')")) == {"weights/w"}


def test_weights_of_ones_own_count(reads, tmp_path):
    """With their card, and nothing that a byte of them could name."""
    for shipped in find_policy("dagger").file, find_policy("dagger").file.with_suffix(".json"):
        shutil.copy(shipped, tmp_path)
    name = str(tmp_path / "dagger.safetensors")
    files = {Path(path).name: was for path, was in reads.of(name, find_policy(name)).items()}
    assert set(files) == {"dagger.safetensors", "dagger.json"}
    assert all(files.values())


def test_a_file_that_is_not_there_counts(noticed, tmp_path):
    """A policy that falls back to something else is another one when the file appears."""
    head = "try: open('w.txt')\nexcept OSError: pass"
    assert noticed(head) == {"w.txt": ""}


def test_a_folder_that_is_listed_counts(noticed, tmp_path):
    """The latest checkpoint, found by a pattern; folders in it, such as the command's own, change nothing."""
    (tmp_path / "runs").mkdir()
    first = noticed(made="import glob; self.file = max(glob.glob('runs/*.pt'), default='')")
    assert set(first) == {"runs"}
    (tmp_path / "runs" / "out").mkdir()
    path = str(tmp_path / "runs")
    assert provenance.digest(path) == first["runs"]
    (tmp_path / "runs" / "1.pt").touch()
    assert provenance.digest(path) != first["runs"]
    assert glob.glob(f"{path}/*.pt")


def test_a_database_counts(noticed, tmp_path):
    sqlite3.connect(tmp_path / "w.db").close()
    (tmp_path / "w.db").write_bytes(b"")
    assert set(noticed(made="import sqlite3; sqlite3.connect('w.db').close()")) == {"w.db"}


def test_modules_and_what_they_read_count_for_all_who_use_them(noticed, tmp_path):
    """A helper in the folder is run once, and reads once: both policies depend on it. Another one does not."""
    (tmp_path / "w.txt").write_text("1")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "__init__.py").write_text("")
    (tmp_path / "deep" / "gains.py").write_text("from pathlib import Path; GAIN = float(Path('w.txt').read_text())")
    (tmp_path / "helper.py").write_text("from deep.gains import GAIN")
    expected = {"w.txt", "helper.py", "deep/gains.py", "deep/__init__.py"}
    assert set(noticed("from helper import GAIN", name="one")) == expected
    assert set(noticed("from helper import GAIN", name="two")) == expected
    assert noticed(name="three") == {}
    assert set(noticed(flown="from helper import GAIN", name="four")) == expected  # only when it flies


def test_a_file_that_changes_between_two_reads_is_torn(noticed, tmp_path):
    (tmp_path / "w.txt").write_text("1")
    names = noticed(made="open('w.txt').close(); np.savetxt('other', [1]); __import__('pathlib').Path('w.txt')")
    assert set(names) == {"w.txt"}
    once = {str(tmp_path / "w.txt"): names["w.txt"]}
    (tmp_path / "w.txt").write_text("22")
    assert changed(once) == ["w.txt"]
    again = {str(tmp_path / "w.txt"): provenance.digest(str(tmp_path / "w.txt"))}
    assert torn(merge(once, again)) == changed(merge(once, again)) == ["w.txt"]
    assert torn(merge(once, once)) == []


def test_versions_of_packages_that_a_policy_uses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(POLICY.format(head="from typer import Typer", made="pass", flown="pass", gain=0))
    kind = find_policy("mine.py:Mine")
    found = packages(sources(kind))
    assert set(found) >= {"numpy", "typer"}
    before = fingerprint(Cell("mine.py:Mine", TASK))
    monkeypatch.setattr("typer.__version__", "0.0.0")
    assert fingerprint(Cell("mine.py:Mine", TASK)) != before
    assert fingerprint(Cell("expert", TASK)) == fingerprint(Cell("expert", TASK))


@pytest.mark.parametrize("name", ["mine.py:Mine", "safe:mine.py:Mine", "pk.mine:Mine"])
def test_the_fingerprint_is_of_all_code(tmp_path, monkeypatch, name):
    """Of a file, a package in the current folder, and one under the safety filter; also of what lies beside it."""
    monkeypatch.chdir(tmp_path)
    Path("pk").mkdir()
    text = POLICY.format(head="from {helper} import GAIN", made="pass", flown="pass", gain="GAIN")
    for file, helper in (("mine.py", "helper"), ("pk/mine.py", "pk.helper")):
        Path(file).write_text(text.format(helper=helper))
    for file in ("helper.py", "pk/helper.py"):
        Path(file).write_text("GAIN = 0.1")
    Path("pk/__init__.py").touch()
    cell = Cell(name, TASK)
    before = fingerprint(cell)
    assert fingerprint(cell) == before
    for file in ("helper.py", "mine.py"):
        place = Path("pk" if name.startswith("pk") else ".", file)
        kept = place.read_text()
        place.write_text(kept + "\n")
        assert fingerprint(cell) != before
        place.write_text(kept)
        assert fingerprint(cell) == before


def test_numbers_depend_on_versions(monkeypatch):
    before = fingerprint(Cell("expert", TASK))
    monkeypatch.setattr("numba.__version__", "0.0")
    assert fingerprint(Cell("expert", TASK)) != before


# --------------------------------------------------------------------------------------------------------- campaigns
def test_results_belong_to_what_ran(tmp_path, monkeypatch):
    """The weights change: the same command flies anew, says why, and tells before that from when its numbers are."""
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        POLICY.format(head="", made="self.gain = np.load('w.npy')", flown="pass", gain="self.gain")
    )
    cells, said = [Cell("mine.py:Mine", TASK)], []
    np.save("w.npy", 0.1)
    (first,) = fly_cells(cells, [0, 1], folder=Path("kept"), processes=1, say=said.append)
    assert (first.reused, first.changed, said) == (None, (), [])
    monkeypatch.setattr("fovconn_env.training.evaluation.campaign.run_orders", None)  # nothing flies
    (again,) = fly_cells(cells, [0, 1], folder=Path("kept"), say=said.append)
    assert again.reused.count == 2
    assert said == [reuse_line([again.reused])]
    study = Study("learned", range(2), [])
    assert [record(study, {cells[0]: each}, 1.0).run.get("reused") for each in (first, again)] == [None, said[0]]
    np.testing.assert_array_equal(again.episodes["mean_speed"], first.episodes["mean_speed"])
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    np.save("w.npy", 0.2)
    (other,) = fly_cells(cells, [0, 1], folder=Path("kept"), processes=1, say=said.append)
    assert said[1:] == ["2 episodes of Mine on LeaderFollow-v0 are not reused: w.npy has changed since"]
    assert other.reused is None
    assert (other.episodes["mean_speed"] > 1.5 * first.episodes["mean_speed"]).all()


def test_a_change_while_it_flies_is_noticed(tmp_path, monkeypatch):
    """By one process: the results are of the file that ran, and say that it is another one by now."""
    monkeypatch.chdir(tmp_path)
    spoil = "np.savetxt(w + '2', [2.0]); __import__('os').replace(w + '2', w)"
    made = f"w = {str(tmp_path / 'w.txt')!r}; self.gain = float(np.loadtxt(w)); {spoil}"
    Path("mine.py").write_text(POLICY.format(head="", made=made, flown="pass", gain="self.gain"))
    Path("w.txt").write_text("0.1")
    cell = Cell("mine.py:Mine", TASK)
    (result,) = fly_cells([cell], [0], folder=Path("kept"), processes=1)
    assert result.changed == ("w.txt",)
    flown, now = Shelf(Path("kept")).load(cell)
    assert now == ["w.txt"]
    monkeypatch.setattr("fovconn_env.training.evaluation.campaign.BLOCK", 1)
    Path("w.txt").write_text("0.1")
    with pytest.raises(SettingError, match=r"policy Mine must stay as it is while it flies, got another w\.txt: "):
        fly_cells([cell], [0, 1], folder=Path("kept"), processes=1, fresh=True)
    assert flown.evaluation.seeds == [0]


def test_parts_of_other_files_are_not_joined(tmp_path):
    from fovconn_env.training.evaluation import evaluate

    part = evaluate("zero", TASK, [0])
    one = Flown.of(part, {"/a": "1"})
    assert one.joined(part._replace(seeds=[1]), {"/a": "1", "/b": "2"}).files == {"/a": "1", "/b": "2"}
    with pytest.raises(SettingError, match="got another /a"):
        one.joined(part._replace(seeds=[1]), {"/a": "2"})


def test_paths_that_are_no_text_are_kept(tmp_path):
    from fovconn_env.training.evaluation import evaluate

    cell, odd = Cell("zero", TASK), os.fsdecode(b"/tmp/\xff \xc3\xa9")
    shelf = Shelf(tmp_path)
    shelf.save(cell, Flown.of(evaluate("zero", TASK, [0]), {odd: ""}))
    assert shelf.load(cell)[0].files == {odd: ""}


@pytest.mark.parametrize("what", ["files", "hash", "times", "seeds", "length"])
def test_a_file_that_is_well_formed_and_wrong_is_damaged(tmp_path, what):
    from fovconn_env.training.evaluation import evaluate

    cell, shelf = Cell("zero", TASK), Shelf(tmp_path)
    shelf.save(cell, Flown.of(evaluate("zero", TASK, [0, 1]), {"/a": ""}))
    (file,) = tmp_path.glob("*.npz")
    header, arrays = read_archive(file, EVALUATION)
    if what == "files":
        header["files"] = ["/a"]
    elif what == "hash":
        header["files"] = {"/a": 1}
    elif what == "times":
        del arrays["times"]
    elif what == "seeds":
        arrays["seeds"] = arrays["seeds"] * 0.5
    else:
        arrays["sct"] = arrays["sct"][:1]
    write_archive(file, EVALUATION, Archive(header, arrays))
    with pytest.raises(Damaged, match=r"is damaged: .*; delete it"):
        shelf.load(cell)


def test_the_report_says_what_was_reused(tmp_path):
    """In the texts and in the numbers; and which files are others by now."""
    from fovconn_env.training.evaluation import evaluate
    from fovconn_env.training.evaluation.results import publish

    times = Reused(2, 1_764_417_660, 1_764_417_660)
    result = evaluate("expert", TASK, [0, 1])._replace(reused=times, changed=("w.npy",))
    line = reuse_line([times])
    assert line.startswith("2 episodes reused from 2025-11-")
    assert reuse_line([times, None, Reused(1, 0, 7)]).startswith("3 episodes reused from 19")
    assert reuse_line([None]) == ""
    published = publish([result], ["expert"], {}, tmp_path, 0.1)
    assert published.record.run["reused"] == line
    for name in ("report.md", "report.html", "results.json"):
        text = (tmp_path / name).read_text("utf-8")
        assert line in text, name
        assert "w.npy, of expert" in text, name
