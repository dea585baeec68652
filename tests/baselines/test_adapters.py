"""Models of other libraries where the library is missing; with it: tests/integrations."""

import re
import sys
from pathlib import Path

import pytest

from fovconn_env.baselines import adapters, find_policy
from fovconn_env.errors import MissingPackage, SettingError
from fovconn_env.training.cluster.flights import _parts

LIBRARIES = {".zip": ("torch", "stable_baselines3"), ".onnx": ("onnxruntime",), ".pt": ("torch",)}
LIBRARIES[".pth"] = LIBRARIES[".pt"]


def test_every_kind_of_file_is_looked_at():
    assert LIBRARIES.keys() == adapters.KINDS.keys()


@pytest.mark.parametrize("suffix", [*LIBRARIES, ""])
def test_a_missing_library_is_told_with_what_brings_it(suffix, tmp_path, monkeypatch):
    """Before anything flies, and whatever is in the file, or in the folder of RLlib's."""
    place = tmp_path / f"mine{suffix}"
    kind, libraries = (adapters.KINDS[suffix], LIBRARIES[suffix]) if suffix else (adapters.CHECKPOINT, ("ray", "torch"))
    with pytest.raises(SettingError, match="must name a file that exists" if suffix else "policy must be one of"):
        find_policy(place)
    if suffix:
        place.touch()
    else:
        place.mkdir()
        (place / "class_and_ctor_args.pkl").touch()
    monkeypatch.delitem(sys.modules, f"fovconn_env.baselines.adapters.{kind.module}", raising=False)
    for name in libraries:
        monkeypatch.setitem(sys.modules, name, None)
    words = rf"policy '.*mine{suffix}' needs ({'|'.join(libraries)}).*: pip install \"{re.escape(kind.package)}\""
    for policy in (str(place), place, f"lambda2-cbf:{place}"):
        with pytest.raises(MissingPackage, match=words):
            find_policy(policy)


def test_a_model_of_an_unknown_suffix_is_no_policy(tmp_path):
    (tmp_path / "mine.h5").touch()
    with pytest.raises(SettingError, match=r"policy must be one of .*model\.zip"):
        find_policy(tmp_path / "mine.h5")


@pytest.mark.parametrize("suffix", LIBRARIES)
def test_a_model_travels_to_a_cluster_by_its_whole_path(suffix):
    file = Path(f"nets/mine{suffix}").resolve()
    assert _parts(f"nets/mine{suffix}") == ("", str(file), "")
    assert _parts(f"safe:nets/mine{suffix}") == ("lambda2-cbf:", str(file), "")
