"""How transports are chosen; those that need packages are tested in tests/integrations/test_fleet_links.py."""

import contextlib
import sys

import pytest

from fovconn_env.errors import MissingPackage, SettingError
from fovconn_env.fleet import connect, make_hub
from fovconn_env.fleet.transport import TRANSPORTS, transport_of

PACKAGES = {"zenoh": ("zenoh", "zenoh:tcp/127.0.0.1:7790"), "dds": ("cyclonedds", "dds:127.0.0.1:60")}


@pytest.mark.parametrize("transport", PACKAGES)
def test_a_missing_package_is_one_line(transport, fovconn, monkeypatch):
    package, endpoint = PACKAGES[transport]
    for module in [package, *(name for name in sys.modules if name.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, f"fovconn_env.fleet.{transport}_link", raising=False)
    line = rf'the transport {transport} needs {package}: pip install "fovconn-env\[{transport}\]"'
    with pytest.raises(MissingPackage, match=line):
        make_hub(transport)
    with pytest.raises(MissingPackage, match=line):
        connect(endpoint, 1.0)
    for words in (("fleet", "LeaderFollow-v0", "--transport", transport), ("robot", "uav_0", "--connect", endpoint)):
        shown = fovconn(*words)
        assert shown.status == 2
        assert line.replace("\\", "") in " ".join(shown.err.split())


def test_a_transport_has_a_name_and_its_own_endpoints():
    with pytest.raises(
        SettingError, match="transport must be one of local, zenoh, dds, got 'zeno': did you mean 'zenoh'"
    ):
        make_hub("zeno")
    with pytest.raises(
        SettingError, match=r"endpoint must be of the transport dds, got 'zenoh:tcp/a:1'.*transport zenoh"
    ):
        make_hub("dds", "zenoh:tcp/a:1")
    with pytest.raises(SettingError, match=r"endpoint must be unix:PATH, .*, got 'udp:a'"):
        connect("udp:a", 1.0)
    for transport, words in TRANSPORTS.items():
        assert {transport_of(f"{word}:a") for word in words} == {transport}
    with contextlib.closing(make_hub("local")) as hub:
        assert transport_of(hub.endpoint) == "local"
