"""The cache of compiled code notices an edit in any file that holds some, and never decides whether or what runs."""

import fcntl
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba.core import event
from numba.core.errors import TypingError

from fovconn_env.kernel import cache
from fovconn_env.kernel.jit import compiled_files, source_hash
from tests.helpers import JIT

PACKAGE = Path(__file__).parents[2] / "fovconn_env"
LAYOUTS = ("clone", "editable", "wheel")
COMPILED = re.compile(r"^@(disjoint|kernel|entry|large_entry|stage|view)$", re.MULTILINE)
ENTRY = re.compile(r"^@(large_)?entry$", re.MULTILINE)
CODE = "from fovconn_env.kernel.jit import entry\n\n\n@entry\ndef double(x):\n    return 2.0 * x\n"


def lay_out(home, layout):
    """A copy of the package as a clone, an editable install or a wheel has it: the folder that is imported."""
    package = home / "fovconn_env"
    sources = shutil.ignore_patterns("__pycache__", "baselines", "training", "weights", "web")
    shutil.copytree(PACKAGE, package, ignore=sources)
    for name in ("baselines", "training"):
        inside = package / name
        shutil.copytree(PACKAGE / name, inside if layout == "wheel" else home / name, ignore=sources)
        if layout != "wheel":
            inside.symlink_to(home / name)
    if layout != "editable":
        return package
    (home / ".editable").mkdir()
    (home / ".editable" / "fovconn_env").symlink_to(package)
    return home / ".editable" / "fovconn_env"


def load_jit(package):
    """`kernel/jit.py` of that copy, freshly imported."""
    spec = importlib.util.spec_from_file_location("jit_of_a_copy", package / "kernel" / "jit.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    event.unregister("numba:compile", module.ANNOUNCEMENT)  # or it tells of what other tests compile
    return module


def files_with(pattern, package):
    """Files of the package in which a pattern is found, as paths relative to it."""
    folders = [package, *(package / name for name in ("baselines", "training"))]  # rglob follows no link by itself
    files = {file for folder in folders for file in folder.rglob("*.py")}
    return sorted(file.relative_to(package) for file in files if pattern.search(file.read_text("utf-8")))


def keys(package, entries):
    """Key of the cache for each file that holds an entry."""
    return {file: key(package, package / file) for file in entries}


def key(package, file):
    jit = load_jit(package)
    return jit.source_hash(jit.compiled_files(file))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_edit_in_any_folder_is_a_miss(layout, tmp_path):
    """An edit of the kernel or the layout changes every key; one above the kernel those of its wing."""
    package = lay_out(tmp_path, layout)
    compiled, entries = files_with(COMPILED, package), files_with(ENTRY, package)
    edited = {file.parent: file for file in compiled} | {Path("layout.py"): Path("layout.py")}
    assert {str(folder) for folder in edited} >= {"kernel", "kernel/world", "baselines/laws", "baselines/learned"}
    assert {entry.parts[0] for entry in entries} >= {"kernel", "baselines", "flights"}
    for file in edited.values():
        before = keys(package, entries)
        with (package / file).open("a") as source:
            source.write("# edited\n")
        after = keys(package, entries)
        changed = {entry for entry in entries if before[entry] != after[entry]}
        wing = file.parts[0]
        everywhere = wing in ("kernel", "layout.py")
        assert changed == {entry for entry in entries if everywhere or entry.parts[0] == wing}, file


def test_a_file_from_elsewhere_may_call_any_wing(tmp_path):
    package = lay_out(tmp_path, "clone")
    yours = tmp_path / "yours" / "law.py"
    yours.parent.mkdir()
    yours.write_text(CODE)
    seen = {key(package, yours)}
    for file in (yours, package / "baselines" / "laws" / "expert.py", package / "kernel" / "step.py"):
        file.write_text(file.read_text("utf-8") + "# edited\n", "utf-8")
        seen.add(key(package, yours))
    assert len(seen) == 4


def test_no_wing_calls_compiled_code_of_another():
    """Or an edit there would not be noticed."""
    compiled = {file.with_suffix("").as_posix().replace("/", ".") for file in files_with(COMPILED, PACKAGE)}
    for file in files_with(COMPILED, PACKAGE):
        imported = re.findall(r"^from fovconn_env\.([\w.]+) import", (PACKAGE / file).read_text("utf-8"), re.MULTILINE)
        others = {module for module in imported if module in compiled} - {"kernel.jit"}
        assert {module.partition(".")[0] for module in others} <= {"kernel", file.parts[0]}, file


# ------------------------------------------------------------------------------------------------ what is on disk
@pytest.fixture
def law(tmp_path, monkeypatch):
    """Loads a compiled function anew, as another process would; it gives the value, and whether it was in the cache."""
    monkeypatch.setattr(cache.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    monkeypatch.setattr(cache, "_warned", False)
    for folder in ("real", "temporary"):
        (tmp_path / folder).mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "real" / "law.py").write_text(CODE)

    def load(x=1.0, folder="real"):
        namespace = {"__name__": "law"}
        exec(compile(CODE, str(tmp_path / folder / "law.py"), "exec"), namespace)
        return namespace["double"](x), bool(namespace["double"].stats.cache_hits)

    return load


def files(folder):
    """Without Python's own, which any process may write at any time."""
    return sorted(file for file in folder.rglob("*") if file.is_file() and ".pyc" not in file.name)


pytestmark = pytest.mark.skipif(not JIT, reason="nothing is compiled")


def test_a_link_and_what_it_leads_to_share_the_cache(law):
    """A run in the clone and one of its editable install compile once between them."""
    assert [law(), law(folder="link"), law()] == [(2.0, False), (2.0, True), (2.0, True)]


def test_types_have_files_of_their_own(law, tmp_path):
    assert [law(1.0), law(1), law(2.0), law(2)] == [(2.0, False), (2.0, False), (4.0, True), (4.0, True)]
    assert len(files(tmp_path / "cache")) == 2


def damages(data):
    middle = len(data) // 2
    yield b""
    yield data[:middle]
    yield data + b"0"
    yield b"0" * len(data)
    for place in (0, 20, 40, middle, len(data) - 1):
        yield data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :]


def test_a_damaged_file_is_a_miss_and_written_anew(law, tmp_path):
    law()
    [file] = files(tmp_path / "cache")
    whole = file.read_bytes()
    for data in damages(whole):
        file.write_bytes(data)
        assert law() == (2.0, False)
        assert law() == (2.0, True)
    assert files(tmp_path) == sorted([file, tmp_path / "real" / "law.py"]), "nothing else is left"


def test_a_file_of_another_function_is_a_miss(law, tmp_path):
    """A whole file under a wrong name: its own identity is compared."""
    law(1.0)
    law(1)
    first, second = files(tmp_path / "cache")
    first.write_bytes(second.read_bytes())
    assert sorted([law(1.0), law(1)]) == [(2.0, False), (2.0, True)]


def test_without_a_folder_to_write_to_there_is_a_temporary_one_of_ones_own(law, tmp_path, monkeypatch):
    monkeypatch.setattr(cache.config, "CACHE_DIR", "/dev/null/cache")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [law(), law()] == [(2.0, False), (2.0, True)]
    [folder] = (tmp_path / "temporary").iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)  # whoever can write to it could let us run anything
    with pytest.warns(RuntimeWarning, match="compiled code cannot be kept"):
        assert law() == (2.0, False)


@pytest.mark.parametrize("temporary", ["of another user", "a link", "a file", "none"])
def test_without_any_folder_it_runs_with_one_warning(temporary, law, tmp_path, monkeypatch):
    monkeypatch.setattr(cache.config, "CACHE_DIR", "")
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", raising(RuntimeError("no home")))
    user = os.getuid()
    folder = tmp_path / "temporary" / f"fovconn_env-{user + (temporary == 'of another user')}"
    folder.touch() if temporary == "a file" else folder.mkdir(mode=0o700)
    if temporary == "of another user":
        monkeypatch.setattr(os, "getuid", lambda: user + 1)
    if temporary == "a link":
        folder.rmdir()
        folder.symlink_to(tmp_path / "real")
    if temporary == "none":
        monkeypatch.setattr(cache.tempfile, "gettempdir", raising(FileNotFoundError("no usable temporary directory")))
    with pytest.warns(RuntimeWarning, match="set NUMBA_CACHE_DIR to a folder that can be written") as told:
        assert [law(), law()] == [(2.0, False), (2.0, False)]
    assert len(told) == 1


def raising(problem):
    def fail(*_, **__):
        raise problem

    return fail


def test_a_full_disk_leaves_nothing(law, tmp_path, monkeypatch):
    write = Path.write_bytes

    def write_half(file, data):
        write(file, data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", write_half)
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        assert law() == (2.0, False)
    assert files(tmp_path) == [tmp_path / "real" / "law.py"]


def test_what_is_in_a_folder_that_cannot_be_written_is_used(law, tmp_path, monkeypatch):
    law()
    monkeypatch.setattr(cache, "_write", raising(OSError(30, "Read-only file system")))
    assert law() == (2.0, True)


def test_many_at_once_write_whole_files(law, tmp_path):
    """Readers never see half of what writers replace."""
    law()
    [file] = files(tmp_path / "cache")
    data, torn = file.read_bytes(), set()
    writers = [threading.Thread(target=lambda: [cache._write(file, data) for _ in range(100)]) for _ in range(4)]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        torn.add(cache._read(file) is None)  # what it read is not kept: a slow disk would fill the memory with it
        time.sleep(1e-3)  # else writers wait for the interpreter most of the time
    assert torn == {False}
    assert files(tmp_path / "cache") == [file]


# ----------------------------------------------------------------------------------------------- several processes
@pytest.fixture
def other(law, tmp_path):
    """Another process that compiles the same code: its lock, what it then writes, and where."""
    law()
    [file] = files(tmp_path / "cache")
    data = file.read_bytes()
    file.unlink()
    with file.with_suffix(".lock").open("ab") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield SimpleNamespace(lock=lock, file=file, data=data)


def test_one_process_compiles_and_the_others_load_it(law, other, tmp_path, monkeypatch):
    monkeypatch.setattr(cache.time, "sleep", lambda _: cache._write(other.file, other.data))
    assert law() == (2.0, True)
    assert files(tmp_path / "cache") == [other.file]


def test_after_a_process_that_was_killed_another_compiles(law, other, tmp_path, monkeypatch):
    monkeypatch.setattr(cache.time, "sleep", lambda _: other.lock.close())  # as the system does for it
    assert [law(), law()] == [(2.0, False), (2.0, True)]
    assert files(tmp_path / "cache") == [other.file]


def test_a_process_that_is_stopped_keeps_the_others_for_a_while_only(law, other, monkeypatch):
    now = iter(range(0, 10**6, 40))
    monkeypatch.setattr(cache.time, "monotonic", lambda: next(now))
    monkeypatch.setattr(cache.time, "sleep", lambda _: None)
    assert law() == (2.0, False)
    assert 120 < next(now) < 240


@pytest.mark.parametrize("problem", ["no such function", "no such lock"])
def test_where_nothing_can_be_locked_each_compiles(problem, law, other, monkeypatch):
    system = None
    if problem == "no such lock":
        system = SimpleNamespace(LOCK_EX=2, LOCK_NB=4, flock=raising(OSError(37, "No locks available")))
    monkeypatch.setattr(cache, "fcntl", system)
    assert law() == (2.0, False)


def test_code_that_does_not_compile_gives_the_lock_back(law, tmp_path):
    namespace, code = {"__name__": "law"}, CODE.replace("2.0 * x", "missing * x")
    exec(compile(code, str(tmp_path / "real" / "law.py"), "exec"), namespace)
    with pytest.raises(TypingError, match="missing"):
        namespace["double"](1.0)
    assert files(tmp_path / "cache") == []
    assert law() == (2.0, False)


def test_the_package_imports_and_runs_without_a_home(tmp_path):
    """Nor does it write into its own folder, which numba would do, and not notice an edit elsewhere."""
    program = """if True:
        import numpy as np
        from fovconn_env.baselines.laws.simple import hash_actions
        actions = np.full((1, 4), np.nan, np.float32)
        hash_actions(np.ones((1, 3), np.uint32), np.zeros(1, np.uint64), actions)
        print(np.isfinite(actions).all(), hash_actions._cache.cache_path)
    """
    variables = {name: value for name, value in os.environ.items() if name not in ("HOME", "NUMBA_CACHE_DIR")}
    variables |= {"HOME": "/dev/null", "XDG_CACHE_HOME": "", "TMPDIR": str(tmp_path), "PYTHONPATH": str(PACKAGE.parent)}
    before = files(PACKAGE / "baselines")
    shown = subprocess.run([sys.executable, "-Bc", program], env=variables, capture_output=True, text=True, check=True)
    key = source_hash(compiled_files(PACKAGE / "baselines" / "laws" / "simple.py"))
    assert shown.stdout == f"True /dev/null/.cache/fovconn_env/{key}\n"
    assert "Warning" not in shown.stderr
    assert [file.parent.name for file in files(tmp_path)] == [key]
    assert files(PACKAGE / "baselines") == before
