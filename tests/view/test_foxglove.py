"""A swarm for Foxglove, read by a client of its WebSocket protocol."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import socket
import struct
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import urlsplit

import foxglove
import pytest
from foxglove import channels, messages
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from swarmd.core.errors import NetworkError
from swarmd.core.messages import LoggedEvent, State
from swarmd.network.operator.operator import Operator
from swarmd.view.foxglove import _STATUS_SCHEMA, FoxgloveServer, _entity, _heard
from swarmd.view.foxglove_socket import MAX_BACKLOG, Channel, FoxgloveSocket, protobuf_channel
from swarmd.view.live import PLAIN, LiveSource
from swarmd.view.source import ShownRobot
from tests.support.fed_swarm import PATTERNS, FedOperator, FedSwarm
from tests.support.processes import CAP, wait_until
from tests.support.swarmctl import swarmctl

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

PROTOCOL = Subprotocol("foxglove.sdk.v1")
DATA = 1  # the kind of a message with data


class Client:
    """A client that knows the channels by topic; it subscribes under the id of the channel."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.channels: dict[str, dict[str, Any]] = {}

    def await_topics(self, *topics: str, step: Callable[[], None] = lambda: None) -> None:
        """Read until these topics are advertised; `step` is called between two messages."""
        while not set(topics) <= self.channels.keys():
            step()
            self.read(step)

    def subscribe(self, *topics: str) -> None:
        ids = [self.channels[topic]["id"] for topic in topics]
        wanted = [{"id": one, "channelId": one} for one in ids]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def read(self, step: Callable[[], None] = lambda: None) -> tuple[str, bytes] | None:
        """The topic and payload of the next message; None of one without data."""
        while True:
            try:
                message = self.socket.recv(timeout=0.05)
                break
            except TimeoutError:
                step()
        if isinstance(message, str):
            told = json.loads(message)
            if told["op"] == "advertise":
                self.channels |= {one["topic"]: one for one in told["channels"]}
            return None
        kind, subscription = struct.unpack_from("<BI", message)
        assert kind == DATA
        topic = next(name for name, one in self.channels.items() if one["id"] == subscription)
        return topic, message[13:]

    def first_of(self, *topics: str, step: Callable[[], None] = lambda: None) -> dict[str, bytes]:
        """The first message of each of these topics."""
        found: dict[str, bytes] = {}
        while not set(topics) <= found.keys():
            if (one := self.read(step)) is not None:
                found.setdefault(*one)
        return found


@contextlib.contextmanager
def client(address: str, close_timeout: float = CAP) -> Iterator[Client]:
    words: dict[str, Any] = {"open_timeout": CAP, "close_timeout": close_timeout}
    with connect(address, subprotocols=[PROTOCOL], **words) as socket:
        yield Client(socket)


def test_a_client_reads_places_states_scans_and_events() -> None:
    with FedSwarm(2) as swarm:
        one, other = swarm.names
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        source.start()
        with (
            contextlib.closing(source),
            FoxgloveServer(source, "127.0.0.1", 0) as server,
            client(server.address) as reader,
        ):
            topics = ("/tf", "/robots", "/events", f"/{one}/status", f"/{one}/scan")
            reader.await_topics(*topics, f"/{other}/status", step=server.publish)
            schemas = {topic: reader.channels[topic]["schemaName"] for topic in topics}
            assert schemas == {
                "/tf": "foxglove.FrameTransforms",
                "/robots": "foxglove.SceneUpdate",
                "/events": "foxglove.Log",
                f"/{one}/status": "swarmd.RobotRow",
                f"/{one}/scan": "foxglove.PointCloud",
            }
            assert not [key for key in swarm.watched if key[0] == "scan"]
            reader.subscribe("/tf", "/robots", f"/{one}/status", f"/{one}/scan")
            found = reader.first_of(
                "/tf", "/robots", f"/{one}/status", f"/{one}/scan", step=server.publish
            )
            assert {key for key in swarm.watched if key[0] == "scan"} == {("scan", one)}
            for topic in ("/tf", "/robots"):
                # Either robot may be heard first.
                while not all(name.encode() in found[topic] for name in (one, other)):
                    found |= reader.first_of(topic, step=server.publish)
            assert b"world" in found["/tf"]
            assert b"running" in found["/robots"]
            assert one.encode() in found[f"/{one}/scan"]
            swarm.change(other, State.STOPPED, events=(LoggedEvent(at=98.0, text="cable"),))
            reader.subscribe("/events")
            events: list[bytes] = []
            while not events or b"cable" not in events[-1]:  # after those that were there before
                events.append(reader.first_of("/events", step=server.publish)["/events"])
            assert other.encode() in events[-1]
            assert one.encode() not in events[-1]
            row = json.loads(found[f"/{one}/status"])
            assert (row["state"], row["report"]["opinion"]) == ("running", "A")


def test_a_robot_that_does_not_answer_has_no_state_and_the_stamp_of_its_last_word() -> None:
    with FedSwarm(2, silent=["tb3-002"]) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        source.start()
        with (
            contextlib.closing(source),
            FoxgloveServer(source, "127.0.0.1", 0) as server,
            client(server.address) as reader,
        ):
            reader.await_topics("/robots", step=server.publish)
            reader.subscribe("/robots")
            found = b""
            while not all(words in found for words in (b"failed: it may still move", b"running")):
                found = reader.first_of("/robots", step=server.publish)["/robots"]
            assert found.count(b"running") == 1  # the state of the other one
    heard = _heard({"presence": "failed", "age": 3.5}, 100.0)
    assert (heard.sec, heard.nsec) == (96, 500_000_000)
    assert _heard({"presence": "expected", "age": math.inf}, 100.0).sec == 0
    robot = ShownRobot("r1", 0, "", PLAIN)
    row = {"state": "running", "stands": "held", "presence": "failed"}
    grey, orange = (repr(_entity(robot, one, heard)) for one in (row, {**row, "presence": "alive"}))
    assert "r: 0.5, g: 0.5, b: 0.5" in grey
    assert "r: 0.95" in orange


def test_a_scan_is_shown_no_longer_than_it_is_new(monkeypatch: pytest.MonkeyPatch) -> None:
    with FedSwarm(1) as swarm:
        (name,) = swarm.names
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        source.start()
        with contextlib.closing(source):
            wait_until(lambda: bool(source.rows().get(name, {}).get("limits")), "a status")
            source.select([name])
            wait_until(lambda: source.scan(name) is not None, "a scan")
            swarm.watched.pop(("scan", name))  # its sensor is silent
            now = time.monotonic()
            monkeypatch.setattr("swarmd.view.live.time.monotonic", lambda: now + 2.0)
            assert source.scan(name) is None


def test_a_port_in_use_is_an_error_in_one_line() -> None:
    with FedSwarm(1) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        with FoxgloveServer(source, "127.0.0.1", 0) as server:
            port = urlsplit(server.address).port
            assert port is not None
            with pytest.raises(NetworkError, match=f"127.0.0.1:{port}") as error:
                FoxgloveServer(source, "127.0.0.1", port)
            assert "\n" not in str(error.value)


@pytest.mark.parametrize("origin", [None, "null", "https://evil.example", "http://localhost:80"])
@pytest.mark.parametrize("path", ["", "/", "/guess", "/?secret"])
def test_without_the_secret_no_page_and_no_program_connects(origin: str | None, path: str) -> None:
    with FedSwarm(1) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        with FoxgloveServer(source, "127.0.0.1", 0) as server:
            place = urlsplit(server.address)
            origins = None if origin is None else Origin(origin)
            words: dict[str, Any] = {
                "subprotocols": [PROTOCOL],
                "open_timeout": CAP,
                "origin": origins,
            }
            with pytest.raises(InvalidStatus) as error:
                connect(f"ws://{place.netloc}{path}", **words).close()
            assert error.value.response.status_code == 403
            with connect(f"{server.address}?layout=1", **words) as other:
                assert json.loads(other.recv(timeout=CAP))["op"] == "serverInfo"


def test_junk_and_silent_connections_keep_no_client_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmd.view.server.MAX_WAITING", 2)
    junk = (b"\x16\x03\x01" * 9000, b"GET /\r\n\r\n", b"\r\n\r\n", b"GET /\xff HTTP/1.1\r\n\r\n")
    with FedSwarm(1) as swarm, contextlib.ExitStack() as stack:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        server = stack.enter_context(FoxgloveServer(source, "127.0.0.1", 0))
        place = urlsplit(server.address)
        address = (str(place.hostname), int(place.port or 0))
        opened = [stack.enter_context(socket.create_connection(address, CAP)) for _ in range(4)]
        for content in junk:
            with (
                socket.create_connection(address, CAP) as raw,
                contextlib.suppress(ConnectionError),
            ):
                raw.sendall(content)
                while raw.recv(4096):
                    pass
        with client(server.address) as reader:
            assert json.loads(reader.socket.recv(timeout=CAP))["op"] == "serverInfo"
            with contextlib.suppress(ConnectionError):
                assert opened[0].recv(1) == b""


@pytest.mark.long
def test_a_client_that_reads_nothing_delays_no_other_and_no_end() -> None:
    with FedSwarm(1) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        server = FoxgloveServer(source, "127.0.0.1", 0)
        channel, payload = server._scene, bytes(2**18)
        with (
            client(server.address, close_timeout=0.1) as slow,
            client(server.address) as reader,
            contextlib.closing(server),
        ):
            for one in (slow, reader):
                one.await_topics("/robots")
                one.subscribe("/robots")
            wait_until(lambda: len(channel.subscriptions) == 2, "both subscribe")
            for _ in range(150):
                server._socket.send(channel, payload)
                while reader.read() is None:
                    pass
            waiting = [one.transport.get_write_buffer_size() for one in channel.subscriptions]
            assert max(waiting) <= MAX_BACKLOG + 2 * len(payload)


def test_the_protocol_is_that_of_the_sdk() -> None:
    """The same channels and messages by the server of the SDK and by ours."""
    log = messages.Log(message="cable")
    context = foxglove.Context()
    theirs = channels.LogChannel("/events", context=context)
    json_theirs = foxglove.Channel(
        "/r1/status", schema=_STATUS_SCHEMA, message_encoding="json", context=context
    )
    sdk = foxglove.start_server(name="swarm x", host="127.0.0.1", port=0, context=context)
    ours = FoxgloveSocket("swarm x", "127.0.0.1", 0)
    status = Channel(
        "/r1/status", "json", "swarmd.RobotRow", "jsonschema", json.dumps(_STATUS_SCHEMA)
    )
    events = protobuf_channel("/events", messages.Log)
    try:
        ours.add([events, status])
        found = []
        for address in (f"ws://127.0.0.1:{sdk.port}", ours.address):
            with client(address) as reader:
                head = json.loads(reader.socket.recv(timeout=CAP))
                del head["sessionId"], head["metadata"]
                reader.await_topics("/events", "/r1/status")
                about = {
                    topic: {key: value for key, value in one.items() if key != "id"}
                    for topic, one in reader.channels.items()
                }
                reader.subscribe("/events", "/r1/status")

                def publish() -> None:
                    theirs.log(log)
                    json_theirs.log(b"{}")
                    ours.send(events, log.encode())
                    ours.send(status, b"{}")

                found.append((head, about, reader.first_of("/events", "/r1/status", step=publish)))
                ids = [one["id"] for one in reader.channels.values()]
                words = {"op": "unsubscribe", "subscriptionIds": ids}
                reader.socket.send(json.dumps(words))
                for nonsense in ("[]", "{", "[" * 9999, '{"op": 1}', '{"op": "x"}', b"\x01"):
                    reader.socket.send(nonsense)
        assert found[0] == found[1]
        wait_until(lambda: not events.is_read and not status.is_read, "no subscription is left")
    finally:
        ours.close()
        sdk.stop()


@pytest.mark.parametrize("words", [("--web",), ("view.py",), ("--bind", "0.0.0.0")])
def test_it_is_shown_alone(words: tuple[str, ...], tmp_path: Any) -> None:
    (tmp_path / "view.py").touch()
    given = [str(tmp_path / one) if one.endswith(".py") else one for one in words]
    done = swarmctl("view", "--foxglove", "0", *given)
    assert (done.code, done.out) == (2, "")


@pytest.mark.integration
def test_swarmctl_shows_a_swarm_of_daemons(swarm: Swarm) -> None:
    swarm.start("tb3-01", swarm.body("tb3-01"))
    view = swarm.begin("view", "--foxglove", "0")
    address = next(line for line in view.out if line.startswith("foxglove: "))
    with client(address.removeprefix("foxglove: ")) as reader:
        reader.await_topics("/tb3-01/status")
        reader.subscribe("/tb3-01/status", "/tf")
        found = reader.first_of("/tb3-01/status", "/tf")
        while not (state := json.loads(found["/tb3-01/status"])["state"]):  # not heard yet
            found |= reader.first_of("/tb3-01/status")
    assert state == "idle"
    assert b"tb3-01" in found["/tf"]
    view.send_signal(signal.SIGTERM)
    assert view.finish().code == 128 + signal.SIGTERM
