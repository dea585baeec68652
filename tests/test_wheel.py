"""What is installed, from the wheel and as an editable install, in a virtual environment away from the clone."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from fovconn_env import PRESETS, __version__

ROOT = Path(__file__).parents[1]
PACKAGES = ("fovconn_env", "fovconn_env/baselines", "fovconn_env/training")
GENERIC = ("baselines", "training", "tests", "docs")  # folders of the clone whose names are anybody's
LIMIT = 1_800_000  # bytes; 0.6 MB of it are weights

pytestmark = pytest.mark.slow


def build(kind, source, folder):
    """Path of what hatchling makes of a source tree: a wheel or an sdist."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(command, cwd=source, capture_output=True, check=True)
    (built,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return built


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build("wheel", ROOT, tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module", params=["wheel", "editable"])
def installed(request, wheel, tmp_path_factory):
    """Runs a program of the new environment in an empty folder; what it depends on is taken from this environment."""
    home = tmp_path_factory.mktemp("away")
    venv.create(home / "venv", with_pip=False)
    python = home / "venv" / "bin" / "python"
    (site,) = (home / "venv" / "lib").glob("python*/site-packages")
    # A path in a .pth file: no .pth file in there is read, so the editable install of the clone stays out.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    source = [str(wheel)] if request.param == "wheel" else ["--no-build-isolation", "-e", str(ROOT)]
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps", "--no-index", *source]
    subprocess.run(pip, capture_output=True, check=True)
    empty = home / "empty"
    empty.mkdir()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}

    def run(program, *arguments, cwd=empty, **variables):
        command = [str(python.with_name(program)), *arguments]
        done = subprocess.run(command, cwd=cwd, env=environment | variables, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run.empty, run.kind, run.root = empty, request.param, site if request.param == "wheel" else ROOT / ".editable"
    return run


# ------------------------------------------------------------------------------------------------------ what is in it
def test_the_wheel_holds_one_package(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    modules = {str(f.relative_to(ROOT)) for package in PACKAGES for f in (ROOT / package).rglob("*.py")}
    assert modules <= names
    page = ROOT / "fovconn_env" / "render" / "page" / "web"
    web = {str(file.relative_to(ROOT)) for suffix in ("js", "html", "css") for file in page.glob(f"*.{suffix}")}
    assert len(web) >= 8
    assert web <= names
    messages = ROOT / "fovconn_env" / "fleet" / "ros" / "fovconn_msgs"
    sources = {str(file.relative_to(ROOT)) for file in messages.rglob("*") if file.is_file()}
    assert len(sources) >= 8  # for colcon
    assert sources <= names
    tasks = ROOT / "fovconn_env" / "training" / "benchmarl" / "conf"
    settings = {str(file.relative_to(ROOT)) for file in tasks.rglob("*.yaml")}
    assert len(settings) == len(PRESETS)  # of BenchMARL's tasks
    assert settings <= names
    assert {f"{package}/py.typed" for package in PACKAGES} <= names
    assert {name.split("/")[0] for name in names} == {"fovconn_env", f"fovconn_env-{__version__}.dist-info"}
    assert wheel.stat().st_size < LIMIT


def test_a_wheel_of_the_sdist_is_the_same(wheel, tmp_path):
    with tarfile.open(build("sdist", ROOT, tmp_path)) as archive:
        assert all(member.isfile() for member in archive.getmembers())  # folders where the clone has links
        archive.extractall(tmp_path, filter="data")
    again = build("wheel", tmp_path / f"fovconn_env-{__version__}", tmp_path / "again")
    assert again.read_bytes() == wheel.read_bytes()


@pytest.mark.parametrize("module", ["fovconn_env", "fovconn_env.baselines", "fovconn_env.training.cli"])
def test_the_wheel_as_it_is_says_that_it_must_be_installed(module, wheel, tmp_path):
    variables = os.environ | {"PYTHONPATH": str(wheel)}
    command = [sys.executable, "-c", f"import {module}"]
    done = subprocess.run(command, cwd=tmp_path, env=variables, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ImportError: fovconn_env must be installed, and cannot be imported")


# -------------------------------------------------------------------------------------------------------- what it does
def test_nothing_else_becomes_importable(installed):
    program = f"import importlib.util as u, fovconn_env as f; print(f.__file__, *map(u.find_spec, {GENERIC}))"
    package, *others = installed("python", "-c", program).split()
    assert Path(package) == installed.root / "fovconn_env" / "__init__.py"
    assert set(others) == {"None"}


@pytest.mark.parametrize("regular", [True, False], ids=["packages", "namespaces"])
def test_a_project_with_folders_of_the_same_names(installed, tmp_path, regular):
    """The user's folders are found, ours are reached as parts of fovconn_env."""
    shutil.copytree(Path(__file__).with_name("user_project"), tmp_path, dirs_exist_ok=True)
    if regular:
        assert installed("python", "main.py", cwd=tmp_path).split()[0] == "Expert"
    else:
        for folder in GENERIC[:3]:
            (tmp_path / folder / "__init__.py").rename(tmp_path / folder / "mine.py")
        program = "import baselines.mine, tests.mine, training.mine, fovconn_env.training; print(training.mine.OWNER)"
        assert installed("python", "-c", program, cwd=tmp_path) == "user\n"
    assert installed("fovconn", "--version", cwd=tmp_path, PYTHONPATH=".") == f"{__version__}\n"


def test_the_command_and_the_readme_run_from_it(installed):
    shown = installed("fovconn", "demo", "--no-animation", "--set", "max_cycles=30", "--set", "warmup=0.5")
    assert "never disconnected" in shown
    assert len(list(installed.empty.glob("out/demo/*.png"))) >= 6
    loop = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.DOTALL | re.MULTILINE)[0]
    assert "while env.agents:" in loop
    assert installed("python", "-c", f"{loop}\nprint(infos['uav_0']['success'])") == "1.0\n"


# ------------------------------------------------------------------------------------------------------ in the clone
@pytest.mark.parametrize("package", ["baselines", "training"])
def test_a_bare_import_in_the_clone_says_what_to_write(package):
    done = subprocess.run([sys.executable, "-c", f"import {package}"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert f"ImportError: write `from fovconn_env import {package}`, not `import {package}`" in done.stderr
