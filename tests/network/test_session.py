"""Sessions by profile."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest
import zenoh
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.network.session import (
    FIRST_PORT,
    PORTS,
    open_session,
    scouting_port,
    session_options,
)
from swarmd.network.settings import NetworkSettings


def field(**changes: object) -> NetworkSettings:
    return replace(
        NetworkSettings(swarm="lab", profile="field", interface="wlan0"),
        **changes,
    )


def test_dev_stays_on_loopback() -> None:
    options = session_options(NetworkSettings(swarm="lab"))
    assert options["scouting/multicast/interface"] == "lo"
    assert options["listen/endpoints"] == ["tcp/127.0.0.1:0"]
    assert options["scouting/gossip/enabled"] is False
    assert options["transport/link/tx/lease"] == 2000


def test_field_binds_the_named_interface_alone() -> None:
    options = session_options(field())
    assert options["scouting/multicast/interface"] == "wlan0"
    assert options["listen/endpoints"] == ["tcp/0.0.0.0:7440#iface=wlan0"]
    assert options["transport/link/tx/lease"] == 3000


def test_field_binds_its_own_endpoints_to_the_interface_too() -> None:
    options = session_options(field(listen=("tcp/10.0.0.5:7001",)))
    assert options["listen/endpoints"] == ["tcp/10.0.0.5:7001#iface=wlan0"]


def test_field_dials_its_seeds_and_again_within_a_second() -> None:
    options = session_options(field(seeds=("tcp/10.0.0.5:7447",), multicast=False))
    assert options["scouting/multicast/enabled"] is False
    assert options["scouting/gossip/enabled"] is True
    assert options["connect/endpoints"] == ["tcp/10.0.0.5:7447"]
    retry = options["connect/retry"]
    assert isinstance(retry, dict)
    assert retry["period_max_ms"] == 1000


def test_an_operator_takes_any_port_so_that_it_fits_beside_a_daemon() -> None:
    visitor = field(listen=("tcp/10.0.0.5:7447",)).as_operator()
    assert session_options(visitor)["listen/endpoints"] == ["tcp/0.0.0.0:0#iface=wlan0"]


def test_the_scouting_port_follows_from_the_name() -> None:
    ports = {scouting_port(f"class-{number}") for number in range(500)}
    assert ports <= set(range(FIRST_PORT, FIRST_PORT + PORTS))
    assert len(ports) == PORTS
    assert scouting_port("class-1") == scouting_port("class-1")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (NetworkSettings(swarm="Lab"), "swarm is 'Lab'"),
        (field(interface=None), "needs `interface`"),
        (field(multicast=False), "needs `seeds`"),
        (field(seeds=("10.0.0.5",)), "seeds[0] is '10.0.0.5'"),
        (field(seeds=("tcp/10.0.0.5:0",)), "needs its port"),
        (field(listen=("tcp/10.0.0.5:70000",)), "listen[0] is 'tcp/10.0.0.5:70000'"),
        (field(lease=0.0), "lease is 0 s"),
        (NetworkSettings(swarm="lab", listen=("tcp/0.0.0.0:0",)), "dev"),
        (NetworkSettings(swarm="lab", seeds=("tcp/10.0.0.5:7447",)), "dev"),
    ],
)
def test_a_wrong_setting_is_named_in_one_line(settings: NetworkSettings, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        session_options(settings)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_zenoh_knows_every_option(settings: NetworkSettings) -> None:
    session = open_session(settings)
    assert not session.is_closed()
    session.close()


def test_a_port_in_use_is_one_clear_line(settings: NetworkSettings) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(NetworkError, match="in use on this machine") as caught:
            open_session(replace(settings, listen=(endpoint,)))
    assert endpoint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert " at /" not in str(caught.value)


OPENING = """
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings
open_session(NetworkSettings(swarm="nobody")).close()
"""


def test_loopback_that_is_down_is_told_with_what_brings_it_up() -> None:
    away = ("unshare", "--net", "--map-root-user")
    if subprocess.run([*away, "true"], capture_output=True, check=False).returncode:
        pytest.skip("network namespaces are not permitted here")
    done = subprocess.run(
        [*away, sys.executable, "-c", OPENING],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stderr.splitlines()[-1].endswith(
        "NetworkError: the network interface lo is down, so that nothing on this machine can meet;"
        " run: sudo ip link set lo up"
    )


def test_an_unknown_interface_is_named_with_those_there_are(settings: NetworkSettings) -> None:
    with pytest.raises(NetworkError, match=r"no network interface 'wlan9'.*\blo\b"):
        open_session(replace(settings, profile="field", interface="wlan9"))


def test_sessions_of_one_swarm_meet(settings: NetworkSettings) -> None:
    one = open_session(settings)
    other = open_session(settings)
    try:
        heard = one.liveliness().declare_subscriber("swarm/**", zenoh.handlers.FifoChannel(8))
        token = other.liveliness().declare_token(f"swarm/{settings.swarm}/a/alive/1")
        assert str(heard.recv().key_expr) == f"swarm/{settings.swarm}/a/alive/1"
        del token
    finally:
        one.close()
        other.close()
