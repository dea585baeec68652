"""A wheel of this clone, installed and flown with each Python: `make test-pythons`.

Takes interpreters, or looks for python3.11 and newer. Each gets a virtual environment with the wheel, its extra `cli`
and the versions of constraints.txt, as wheels alone, and runs smoke.py. Prints a line for each; fails if one does not
fly.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSIONS = [f"python3.{minor}" for minor in range(11, 15)]


def run(*command, cwd=ROOT):
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}  # no path to the clone
    return subprocess.run([*map(str, command)], cwd=cwd, env=clean, capture_output=True, text=True)


def build(folder):
    """The wheel."""
    done = run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder)
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    return wheel


def try_out(python, wheel, folder):
    """What came of it with one interpreter, in words, and whether it flew."""
    began = time.monotonic()
    if not shutil.which(python) or run(python, "-V").returncode:  # a shim may stand for what is not there
        return "not found", None
    done = run(python, "-m", "venv", folder)
    own = folder / "bin" / "python"
    if done.returncode == 0:
        pip = "-q --disable-pip-version-check --no-compile --only-binary :all: -c constraints.txt".split()
        done = run(own, "-m", "pip", "install", *pip, f"{wheel}[cli]")
    if done.returncode:
        return f"not installed: {(done.stderr or done.stdout).strip().splitlines()[-1]}", False
    done = run(own, "-P", ROOT / "tests" / "smoke.py", cwd=folder)
    print(done.stderr, end="", file=sys.stderr)
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()[-1]
    return f"{run(own, '-V').stdout.strip()}, {time.monotonic() - began:.0f} s: {said}", done.returncode == 0


def main(pythons):
    folder = ROOT / ".venvs" / "pythons"
    shutil.rmtree(folder, ignore_errors=True)
    wheel, results = build(folder), {}
    for k, python in enumerate(pythons or VERSIONS):
        words, results[python] = try_out(python, wheel, folder / str(k))
        print(f"{python}: {words}", flush=True)
    shutil.rmtree(folder)
    return 0 if any(results.values()) and False not in results.values() else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
