"""The cache of compiled code notices an edit in any file that holds some: in a clone, through a link, in a wheel."""

import importlib.util
import re
import shutil
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "fovconn_env"
LAYOUTS = ("clone", "editable", "wheel")
COMPILED = re.compile(r"^@(kernel|entry|stage|view)$", re.MULTILINE)
ENTRY = re.compile(r"^@entry$", re.MULTILINE)
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
    return module


def files_with(pattern, package):
    """Files of the package in which a pattern is found, as paths relative to it."""
    folders = [package, *(package / name for name in ("baselines", "training"))]  # rglob follows no link by itself
    files = {file for folder in folders for file in folder.rglob("*.py")}
    return sorted(file.relative_to(package) for file in files if pattern.search(file.read_text("utf-8")))


def keys(package, entries):
    """Folder of the cache for each file that holds an entry."""
    jit = load_jit(package)
    return {entry: jit._cache_folder(package / entry) for entry in entries}


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
    seen = {load_jit(package)._cache_folder(yours)}
    for file in (yours, package / "baselines" / "laws" / "expert.py", package / "kernel" / "step.py"):
        file.write_text(file.read_text("utf-8") + "# edited\n", "utf-8")
        seen.add(load_jit(package)._cache_folder(yours))
    assert len(seen) == 4


def test_no_wing_calls_compiled_code_of_another():
    """Or an edit there would not be noticed."""
    compiled = {file.with_suffix("").as_posix().replace("/", ".") for file in files_with(COMPILED, PACKAGE)}
    for file in files_with(COMPILED, PACKAGE):
        imported = re.findall(r"^from fovconn_env\.([\w.]+) import", (PACKAGE / file).read_text("utf-8"), re.MULTILINE)
        others = {module for module in imported if module in compiled} - {"kernel.jit"}
        assert {module.partition(".")[0] for module in others} <= {"kernel", file.parts[0]}, file


def test_a_link_and_what_it_leads_to_share_the_cache(tmp_path, monkeypatch):
    """numba keys by path as well: a run in the clone and one of its editable install compile once between them."""
    from fovconn_env.kernel import jit

    monkeypatch.setattr(jit.config, "CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "real" / "law.py").write_text(CODE)
    places = []
    for folder in ("real", "link"):
        namespace = {"__name__": "law"}
        exec(compile(CODE, str(tmp_path / folder / "law.py"), "exec"), namespace)
        places.append(namespace["double"]._cache.cache_path)
    assert places[0] == places[1]
