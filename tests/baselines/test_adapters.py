"""Models of other libraries where the library is missing; with it: tests/integrations."""

import sys
from pathlib import Path

import pytest

from fovconn_env.baselines import adapters, find_policy
from fovconn_env.errors import EXTRAS, MissingPackage, SettingError
from fovconn_env.training.cluster.flights import _parts

LIBRARIES = {".zip": ("torch", "stable_baselines3"), ".onnx": ("onnxruntime",)}


def test_every_kind_of_file_is_looked_at():
    assert LIBRARIES.keys() == adapters.KINDS.keys()


@pytest.mark.parametrize("suffix", LIBRARIES)
def test_a_missing_library_is_told_with_its_extra(suffix, tmp_path, monkeypatch):
    """Before anything flies, and whatever the file holds."""
    file = tmp_path / f"mine{suffix}"
    with pytest.raises(SettingError, match="must name a file that exists"):
        find_policy(file)
    file.touch()
    for name in list(sys.modules):
        if name.startswith("fovconn_env.baselines.adapters.") and name.endswith(adapters.KINDS[suffix][0]):
            monkeypatch.delitem(sys.modules, name)
    for name in LIBRARIES[suffix]:
        monkeypatch.setitem(sys.modules, name, None)
    needed = f"({'|'.join(LIBRARIES[suffix])})"
    for policy in (str(file), file, f"lambda2-cbf:{file}"):
        with pytest.raises(MissingPackage, match=rf"policy '.*mine{suffix}' needs {needed}: pip install .fovconn-env"):
            find_policy(policy)
    assert set(LIBRARIES[suffix]) <= EXTRAS.keys()


def test_a_model_of_an_unknown_suffix_is_no_policy(tmp_path):
    (tmp_path / "mine.h5").touch()
    with pytest.raises(SettingError, match=r"policy must be one of .*model\.zip"):
        find_policy(tmp_path / "mine.h5")


@pytest.mark.parametrize("suffix", LIBRARIES)
def test_a_model_travels_to_a_cluster_by_its_whole_path(suffix):
    file = Path(f"nets/mine{suffix}").resolve()
    assert _parts(f"nets/mine{suffix}") == ("", str(file), "")
    assert _parts(f"safe:nets/mine{suffix}") == ("lambda2-cbf:", str(file), "")
