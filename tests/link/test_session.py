"""Sessions by profile, opening in a thread, and the tuning of sockets."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
import zenoh
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.link.carriers.session import (
    connected_sockets,
    foreign_options,
    on_thread,
    open_in_thread,
    open_operator_session,
    open_session,
    open_with,
    operator_options,
    session_options,
    tune_links,
)
from swarmd.link.settings import NetworkSettings
from swarmd.testing.driver_contract import TIMEOUT
from tests.support.processes import free_endpoint


def field(**changes: object) -> NetworkSettings:
    return replace(
        NetworkSettings(swarm="lab", profile="field", interface="wlan0"),
        **changes,
    )


MODE, LEASE = "mode", "transport/link/tx/lease"
LISTEN, DIAL = "listen/endpoints", "connect/endpoints"
ROUTED = NetworkSettings(swarm="lab", profile="routed", routers=("tcp/10.0.0.1:7447",))


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        (NetworkSettings(swarm="lab"), {LISTEN: ["tcp/127.0.0.1:0"], LEASE: 2000}),
        (field(), {LISTEN: ["tcp/[::]:7440#iface=wlan0"], LEASE: 3000}),
        (field(listen=("tcp/10.0.0.5:7001",)), {LISTEN: ["tcp/10.0.0.5:7001#iface=wlan0"]}),
        (field(seeds=("tcp/10.0.0.5:7447",), multicast=False), {DIAL: []}),
        (ROUTED, {MODE: "client", LISTEN: [], DIAL: ["tcp/10.0.0.1:7447"]}),
    ],
    ids=["dev", "field", "field's own endpoint", "seeds", "routed"],
)
def test_a_daemon_listens_and_dials_nobody_but_its_routers(
    settings: NetworkSettings, wanted: dict[str, object]
) -> None:
    options = session_options(settings)
    assert {path: options[path] for path in wanted} == wanted
    assert not options["scouting/gossip/enabled"]
    # It answers scouts and sends none.
    answers = settings.profile == "dev" or (settings.profile == "field" and settings.multicast)
    assert options["scouting/multicast/enabled"] is answers
    assert options.get("scouting/multicast/autoconnect", []) == []


@pytest.mark.parametrize(
    ("settings", "is_secured", "answers"),
    [
        (NetworkSettings(swarm="lab"), False, True),
        (NetworkSettings(swarm="lab", discoverable=False), False, False),
        (field(), False, True),
        (field(), True, False),
        (field(discoverable=True), True, True),
        (field(seeds=("tcp/10.0.0.5:7447",), multicast=False), False, False),
        (ROUTED, False, False),
    ],
)
def test_robots_answer_scouts_unless_their_swarm_is_secured(
    settings: NetworkSettings, is_secured: bool, answers: bool
) -> None:
    assert settings.answers_scouts(is_secured=is_secured) is answers


def test_robots_behind_routers_are_not_discoverable() -> None:
    faults = dict(replace(ROUTED, discoverable=True).faults())
    assert faults.keys() == {("discoverable",)}


def test_a_program_scouts_for_robots_or_dials_them() -> None:
    scouting = foreign_options(field(), [], scouts=True)
    assert scouting["scouting"]["multicast"]["autoconnect"] == ["router", "peer"]
    assert scouting["connect"]["endpoints"] == []
    dialling = foreign_options(field(), ["tcp/10.0.0.5:7440"])
    assert not dialling["scouting"]["multicast"]["enabled"]


def test_an_operator_dials_what_it_found_and_listens_nowhere() -> None:
    found = ["tcp/10.0.0.5:7440", "tcp/[fe80::1%2]:7440"]
    options = operator_options(field(listen=("tcp/10.0.0.5:7440",)), found)
    assert (options[MODE], options[LISTEN], options[DIAL]) == ("peer", [], found)
    assert operator_options(ROUTED, found)[DIAL] == ["tcp/10.0.0.1:7447"]


def test_another_program_gets_a_file_that_dials_and_does_not_scout() -> None:
    found = foreign_options(NetworkSettings(swarm="lab"), ["tcp/127.0.0.1:9", "tcp/127.0.0.1:10"])
    assert found["mode"] == "peer"
    assert found["connect"]["endpoints"] == ["tcp/127.0.0.1:9", "tcp/127.0.0.1:10"]
    assert found["scouting"]["multicast"] == found["scouting"]["gossip"] == {"enabled": False}
    assert found["transport"] == {"shared_memory": {"enabled": False}}, "no sizes, no timeouts"
    zenoh.Config.from_json5(json.dumps(found))
    routed = foreign_options(ROUTED, ["tcp/10.0.0.5:7440"])
    assert (routed["mode"], routed["connect"]["endpoints"]) == ("client", ["tcp/10.0.0.1:7447"])


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
        (field(swarm="default"), "a name of its own"),
        (replace(ROUTED, routers=()), "needs `routers`"),
        (NetworkSettings(swarm="lab", listen=("tcp/0.0.0.0:0",)), "dev"),
        (NetworkSettings(swarm="lab", seeds=("tcp/10.0.0.5:7447",)), "dev"),
    ],
)
def test_a_wrong_setting_is_named_in_one_line(settings: NetworkSettings, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        session_options(settings)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_port_in_use_is_one_clear_line(settings: NetworkSettings) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(NetworkError, match="in use on this machine") as caught:
            open_session(replace(settings, listen=(endpoint,)))
    assert endpoint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert " at /" not in str(caught.value)


OPENING = """
from swarmd.link.carriers.session import open_session
from swarmd.link.settings import NetworkSettings
open_session(NetworkSettings(swarm="nobody")).close()
"""


@pytest.mark.integration
def test_loopback_that_is_down_is_reported_with_the_remedy() -> None:
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
    with pytest.raises(NetworkError, match=r"'wlan9'.*\blo\b"):
        open_session(replace(settings, profile="field", interface="wlan9"))


def test_an_operator_meets_the_daemon_that_it_dials(settings: NetworkSettings) -> None:
    endpoint, nobody = free_endpoint(), free_endpoint()
    daemon = open_session(replace(settings, listen=(endpoint,)))
    operator = open_operator_session(settings, [nobody, endpoint])
    try:
        heard = operator.liveliness().declare_subscriber("swarm/**", zenoh.handlers.FifoChannel(8))
        token = daemon.liveliness().declare_token(f"swarm/{settings.swarm}/a/alive/1")
        assert str(heard.recv().key_expr) == f"swarm/{settings.swarm}/a/alive/1"
        del token
    finally:
        operator.close()
        daemon.close()


def session() -> zenoh.Session:
    config = zenoh.Config()
    for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
        config.insert_json5(key, json.dumps(False))
    config.insert_json5("listen/endpoints", json.dumps([]))
    return zenoh.open(config)


async def test_an_opened_session_is_returned() -> None:
    found = await open_in_thread(session)
    assert not found.is_closed()
    found.close()


@pytest.mark.parametrize("waits", [False, True])
def test_a_session_opened_after_a_cancel_is_closed(waits: bool) -> None:
    made: list[zenoh.Session] = []
    go_on = threading.Event()

    def open_it() -> zenoh.Session:
        go_on.wait(TIMEOUT)
        made.append(session())
        return made[-1]

    async def run() -> None:
        task = asyncio.create_task(open_in_thread(open_it))
        await asyncio.sleep(0.01)
        task.cancel()
        if waits:
            await asyncio.gather(task, return_exceptions=True)
        go_on.set()  # the loop ends before the opening does

    asyncio.run(run())
    assert [one.is_closed() for one in made] == [True]


async def test_a_session_opened_while_cancelled_is_closed() -> None:
    made: list[zenoh.Session] = []
    is_made = threading.Event()

    def open_it() -> zenoh.Session:
        made.append(session())
        is_made.set()
        return made[-1]

    task = asyncio.create_task(open_in_thread(open_it))
    await asyncio.sleep(0)
    assert is_made.wait(TIMEOUT)  # the loop is held up, and has not heard of it
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert [one.is_closed() for one in made] == [True]


def user_timeout(sock: socket.socket) -> int:
    return sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


def lingers(sock: socket.socket) -> bool:
    return bool(struct.unpack("ii", sock.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0])


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """A connected pair that is nobody's link, set as Zenoh sets its own."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
        near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        with near, far:
            yield near, far


def locator(name: tuple[str, int]) -> str:
    return f"tcp/{name[0]}:{name[1]}"


def test_the_sockets_between_two_locators_are_tuned(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    near, far = pair
    assert tune_links([(locator(near.getsockname()), locator(far.getsockname()))], 2.5) == 2
    assert [user_timeout(sock) for sock in pair] == [2500, 2500]
    assert not lingers(near)


def test_other_sockets_are_left_alone(pair: tuple[socket.socket, socket.socket]) -> None:
    near, _ = pair
    assert tune_links([("tcp/127.0.0.1:1", "tcp/127.0.0.1:2")], 2.5) == 0
    assert tune_links([("nonsense", "unixpipe/x")], 2.5) == 0
    assert user_timeout(near) == 0
    assert lingers(near)


def test_looking_for_sockets_leaks_no_descriptor(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    before = set(os.listdir("/proc/self/fd"))
    assert len(list(connected_sockets())) >= 2
    assert set(os.listdir("/proc/self/fd")) <= before  # another thread may close one
    pair[0].sendall(b"still there")
    assert pair[1].recv(20) == b"still there"


def test_every_live_link_is_tuned(settings: NetworkSettings) -> None:
    """Both ends are in this process: each of two links shows up as two sockets."""
    endpoints = [free_endpoint(), free_endpoint()]
    sessions = [open_session(replace(settings, listen=(one,))) for one in endpoints]
    sessions.append(open_operator_session(settings, endpoints))
    end = time.monotonic() + 20.0
    try:
        found: list[tuple[int, bool]] = []
        while len(found) < 4 or set(found) != {(2000, False)}:
            assert time.monotonic() < end, found
            found = live_sockets(sessions)
    finally:
        for session in sessions:
            session.close()


def live_sockets(sessions: list[zenoh.Session]) -> list[tuple[int, bool]]:
    """User timeout in ms, and whether close lingers, of each socket that belongs to a link."""
    links = [link for session in sessions for link in session.info.links()]
    ports = {int(one.rpartition(":")[2]) for link in links for one in (link.src, link.dst)}
    return [
        (user_timeout(sock), lingers(sock))
        for sock in connected_sockets()
        if {sock.getsockname()[1], sock.getpeername()[1]} <= ports
    ]


def test_an_error_of_one_item_does_not_end_the_thread_of_a_callback(
    caplog: pytest.LogCaptureFixture,
) -> None:
    taken: list[int] = []
    is_ended = threading.Event()

    def take(item: int) -> None:
        taken.append(item)
        if item == 1:
            raise ValueError("an item that its handler cannot take")
        is_ended.set()

    callback = on_thread(take)
    callback.callback(1)
    while 1 not in taken:
        is_ended.wait(0.01)
    callback.callback(2)
    is_going_on = is_ended.wait(5.0)
    assert callback.drop is not None
    callback.drop()
    assert is_going_on
    assert taken == [1, 2]
    assert "cannot take" in caplog.text


def test_an_option_that_is_not_utf_8_is_one_line() -> None:
    folder = os.fsdecode(b"/home/m\xfcller/keys")
    with pytest.raises(NetworkError, match="no session for swarm 'meadow': ") as caught:
        open_with({"transport/link/tls/root_ca_certificate": folder}, "swarm 'meadow'")
    assert "\n" not in str(caught.value)
