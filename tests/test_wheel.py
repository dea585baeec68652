"""The wheel, in a virtual environment away from the clone: what is in it, and that command and README run from it."""

import os
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("fovconn_env", "baselines", "training")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Runs a program of the new environment in an empty folder; what it depends on is taken from this environment."""
    home = tmp_path_factory.mktemp("away")
    venv.create(home / "venv", with_pip=False)
    python = home / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(pip, capture_output=True, check=True)
    (site,) = (home / "venv" / "lib").glob("python*/site-packages")
    # A path in a .pth file: no .pth file in there is read, so the editable install of the clone stays out.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    empty = home / "empty"
    empty.mkdir()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment["NUMBA_CACHE_DIR"] = str(home / "kernels")  # its place is part of a kernel's key: nobody needs it later

    def run(program, *arguments):
        command = [str(python.with_name(program)), *arguments]
        done = subprocess.run(command, cwd=empty, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run.empty, run.site = empty, site
    return run


def test_it_holds_the_packages_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    modules = {str(f.relative_to(ROOT)) for package in PACKAGES for f in (ROOT / package).rglob("*.py")}
    assert modules <= names
    web = ROOT / "fovconn_env" / "render" / "web"
    assert {
        str(file.relative_to(ROOT)) for pattern in ("*.js", "*.html", "*.css") for file in web.glob(pattern)
    } <= names
    assert {f"{package}/py.typed" for package in PACKAGES} <= names
    assert {name.split("/")[0].partition("-")[0] for name in names} == {*PACKAGES}


def test_the_command_and_the_readme_run_from_it(installed):
    where = installed("python", "-c", "import fovconn_env, baselines, training; print(fovconn_env.__file__)")
    assert Path(where.strip()).is_relative_to(installed.site)
    shown = installed("fovconn", "demo", "--no-animation", "--set", "max_cycles=30", "--set", "warmup=0.5")
    assert "never disconnected" in shown
    assert len(list(installed.empty.glob("out/demo/*.png"))) >= 6
    loop = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.DOTALL | re.MULTILINE)[0]
    assert "while env.agents:" in loop
    assert installed("python", "-c", f"{loop}\nprint(infos['uav_0']['success'])") == "1.0\n"
