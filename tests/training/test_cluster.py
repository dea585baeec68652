"""What of flights on a cluster needs no ray; tests/integrations/test_cluster.py has the rest."""

import os
import sys
from pathlib import Path

import pytest

from fovconn_env.training.cluster.flights import _contents, _parts
from fovconn_env.training.cluster.nodes import about, differences


@pytest.mark.parametrize("words", [("eval",), ("figures", "--ablations"), ("submit", "expert")])
def test_without_ray_it_says_what_to_install(fovconn, monkeypatch, words):
    monkeypatch.setitem(sys.modules, "ray", None)
    shown = fovconn(*words, "--seeds", 0, "--ray", "local")
    assert shown.status == 2
    assert shown.err.splitlines()[-1] == 'fovconn: a cluster needs ray: pip install "fovconn-env[cluster]"'
    assert "Traceback" not in shown.err


@pytest.mark.parametrize("words, address", [
    (["--ray", "auto"], "auto"),
    (["--ray"], "local"),
    (["--ray", "--out", "out"], "local"),
])  # fmt: skip
def test_what_flies_nothing_takes_no_cluster(fovconn, words, address):
    """An address may be left out, at the end and before another option."""
    shown = fovconn("figures", "flight.npz", *words)
    assert shown.status == 2
    assert f"--ray must come with --ablations, got '{address}': nothing else is flown here" in shown.err


def test_a_machine_is_itself_and_what_differs_is_named():
    here = about()
    assert differences(here, about()) == ""
    there = here | {"numpy": "1.0", "canary flight": "0123"}
    says = f"numpy 1.0 instead of {here['numpy']}, canary flight 0123 instead of {here['canary flight']}"
    assert differences(here, there) == says
    assert differences(here, {"fovconn_env": "not installed"}).startswith("fovconn_env not installed instead of")


@pytest.mark.parametrize(
    "policy, parts",
    [
        ("mine.py:Mine", ("", "HERE/mine.py", ":Mine")),
        ("mine.py", ("", "HERE/mine.py", "")),
        ("/a/b.py:Mine", ("", "/a/b.py", ":Mine")),
        ("link/mine.py:Mine", ("", "HERE/real/mine.py", ":Mine")),
        ("lambda2-cbf:out/ppo/ppo.safetensors", ("lambda2-cbf:", "HERE/out/ppo/ppo.safetensors", "")),
        ("safe:mine.py:Mine", ("lambda2-cbf:", "HERE/mine.py", ":Mine")),
        ("package.module:Mine", ("package.module:Mine", "", "")),
    ],
)
def test_a_policy_s_name_is_its_file_with_what_stands_around_it(tmp_path, monkeypatch, policy, parts):
    monkeypatch.chdir(tmp_path)
    Path("real").mkdir()
    os.symlink("real", "link")
    assert _parts(policy) == tuple(part.replace("HERE", os.path.realpath(tmp_path)) for part in parts)


def test_files_travel_with_what_they_hold_and_folders_alone(tmp_path):
    (tmp_path / "a").write_bytes(b"1")
    paths = [str(tmp_path), str(tmp_path / "a"), str(tmp_path / "missing")]
    assert _contents(paths) == {str(tmp_path): None, str(tmp_path / "a"): b"1"}
