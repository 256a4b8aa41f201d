"""The adapter of driver `ros1`: a process under the system's Python with rospy.

It passes serialised messages between ROS 1 and the driver, over the socket that is its standard
input, and reports the state of the ROS master. It needs Python 3.8, rospy and the standard library;
of this project it imports only `master.py`, which lies beside it. The driver imports this module
for the layout of the packets:

    to the driver   D topic arrival bytes  a message; arrival: s on CLOCK_MONOTONIC; topic: an index
                                           in the list of `topics` and then `command_topics`. A
                                           message on `command_topics` is a command of another node
                                           or a stop; its bytes are empty unless its type is one of
                                           `definitions`
                    J {...}                an event as JSON: state, foreign, gone, end
                    H                      a sign of life
    to the adapter  C time bytes           a command, made at `time` on CLOCK_MONOTONIC
                    S time bytes           a std_msgs/String for the topic `state_topic`
                    B                      farewell: send zero and leave

The adapter is the base's watchdog and outlives the daemon:

1. A non-zero command arms the adapter. Zeros of the daemon for _DISARM_TIME disarm it.
2. An armed adapter that gets no command for COMMAND_TIMEOUT sends zeros until the daemon commands
   again. A daemon that is back within ZERO_TIME moves nothing before that time is over: the adapter
   sends zero in place of its commands.
3. When the daemon closes the socket, the adapter sends zeros for ZERO_TIME, and ends.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import resource
import signal
import socket
import struct
import sys
import threading
import time
from glob import glob
from typing import Any, Dict, List, Optional  # noqa: UP035  (Python 3.8)

DATA = b"D"
EVENT = b"J"
ALIVE = b"H"
COMMAND = b"C"
STATE = b"S"
FAREWELL = b"B"
DATA_HEAD = struct.Struct("<cId")
COMMAND_HEAD = struct.Struct("<cd")

COMMAND_TIMEOUT = 0.4
"""Seconds without a command after which the adapter itself sends zeros."""
ZERO_TIME = 2.0
"""Seconds of zeros after the daemon has ended, and at least after it was silent."""

_PERIOD = 0.05  # s of a tick
_TICKS_ALIVE = 4  # ticks between two signs of life
_MAX_COMMAND_AGE = 0.2  # s; an older command was sent before the daemon was frozen
_DISARM_TIME = 0.5  # s of zeros after which the daemon may be silent
_POLL_PERIOD = 1.0  # s between two questions to the master
_RETRY_PERIOD = 0.3  # s, while the master does not answer
_WRITE_TIMEOUT = struct.pack("@ll", 0, 100_000)  # s and us that writing a command may take
_HANDSHAKE_TIMEOUT = 1.0  # s within which a connected node has to send its header
_LEAVE_TIMEOUT = 1.0  # s for unregistering this node from the master
_MAX_MEMORY = 512 << 20  # bytes; rospy allocates whatever length a message announces
_MAX_TEXT = 4096  # bytes of a command or stop; the socket has no room for megabytes
_TWIST = struct.Struct("<6d")


class KeptTopic:
    """The last message of a topic that is published on change, sent until the driver has taken it.

    The message is valid only while its publisher is there, so the class also reports the end of
    the publisher. The connection object does not show this end, since rospy uses the object again
    for the next connection. Each connection has a header object of its own: once no open connection
    has the header of the message, the publisher of the message has ended.

    A stop counts without its publisher: its topic has no `subscriber` here, and reports no end.
    """

    def __init__(self, index: int, adapter: Adapter) -> None:
        self._index = index
        self._adapter = adapter
        self.subscriber: Any = None
        self._lock = threading.Lock()
        self._unsent: Any = None
        self._header: Any = None

    def take(self, header: Any, *packet: bytes) -> None:
        """Send a message that came on the connection with this header; keep it if that fails."""
        with self._lock:
            self._header = header
            self._unsent = None if self._adapter.send(*packet) else packet

    def send_again(self) -> None:
        """Send the message again if the driver has not taken it."""
        with self._lock:
            if self._unsent is not None and self._adapter.send(*self._unsent):
                self._unsent = None

    def report_end(self) -> None:
        """Report the end of the last message's connection, until the driver has taken the event."""
        with self._lock:
            if self._header is None or self.subscriber is None:
                return
            ends = getattr(self.subscriber.impl, "connections", ())
            if any(end.header is self._header and end.socket is not None for end in ends):
                return
            self._unsent = None
            if self._adapter.event({"event": "gone", "topic": self._index}):
                self._header = None


class Adapter:
    """The adapter with its threads.

    `run` polls the master. `_read` takes packets of the driver. `_tick` sends zeros and signs of
    life. Threads of rospy receive messages.
    """

    def __init__(self, config: Any, sock: socket.socket, rospy: Any, master: Any) -> None:
        self._config = config
        self._sock = sock
        self._rospy = rospy
        self._master = master
        self._command_type = ""
        self._publisher: Any = None
        self._is_joined = False  # the node is registered with the master
        self._misses = 0  # polls in a row in which the master lacks subscriptions of this node
        self._wake = threading.Event()
        self._ends_at: Optional[float] = None  # noqa: UP045
        # `holds`: an earlier adapter drove the robot. Then it is sent zeros as soon as it connects,
        # for ZERO_TIME; after that other nodes may drive it, unless the daemon commands it again.
        self._is_armed = self._holds = bool(config["holds"])
        self._holds_until = float("inf")
        # Times of the last command, and of the last non-zero command; the time until which commands
        # of the daemon become zeros (rule 2).
        self._commanded_at = -COMMAND_TIMEOUT
        self._moved_at = -COMMAND_TIMEOUT
        self._stops_until = -COMMAND_TIMEOUT
        self._reported: Any = None  # the last event `state` that the driver has taken
        self._answers: Any = None  # the publisher of the topic `state_topic`
        self._others: Any = None  # the subscription to other nodes' commands
        self._kept: Dict[int, KeptTopic] = {  # noqa: UP006
            index: KeptTopic(index, self) for index in config["kept_topics"]
        }

    def run(self) -> None:
        """Serve until the driver sends a farewell or has ended, or the master was restarted."""
        for work in (self._read, self._tick):
            threading.Thread(target=work, daemon=True).start()
        try:
            self._poll_master()
        except Exception as error:  # rospy may raise anything; its threads would live on
            self.end(0.0, f"the adapter failed: {error!r}")
            raise

    def _poll_master(self) -> None:
        while True:
            self._wake.clear()
            try:
                if not self._is_joined:
                    self._master.call("getSystemState")  # fails if a node, not the master, answers
                    try:
                        self._join()
                    except OSError as error:  # rospy does not undo a partial registration
                        raise RuntimeError(f"it could not join the master: {error}") from error
                for kept in self._kept.values():
                    kept.report_end()
                state = self._state()
                self._report(state)
                self._listen_to_others(bool(state["others"]))
            except OSError as error:
                self._report({"event": "state", "master": False, "text": str(error)})
            self._wake.wait(_POLL_PERIOD if self._is_joined else _RETRY_PERIOD)

    def end(self, seconds: float, why: str = "", kind: str = "end") -> None:
        """Report why the adapter ends, send zeros for `seconds` while armed, and then exit."""
        if why and self._ends_at is None:
            self.event({"event": "end", "kind": kind, "text": why})
        ends_at = time.monotonic() + seconds
        self._ends_at = ends_at if self._ends_at is None else min(ends_at, self._ends_at)

    # To ROS

    def _join(self) -> None:
        rospy = self._rospy
        config = self._config
        rospy.init_node(config["name"], argv=[], anonymous=True, disable_signals=True,
                        disable_rosout=True)  # fmt: skip
        self._master.caller = rospy.get_name()
        self._configure_bases(rospy.impl.tcpros_base)
        rospy.on_shutdown(self._on_shutdown)  # called before topics close, as on `rosnode kill`
        if not config["is_check"]:
            # Latched: a node that subscribes later gets the last answer, too.
            self._answers = rospy.Publisher(
                config["state_topic"], self._class_of("std_msgs/String"), latch=True, queue_size=1
            )
        if len(config["command_types"]) == 1:
            self._advertise(config["command_types"][0])
        for index, topic in enumerate(config["topics"]):
            subscriber = rospy.Subscriber(
                topic, rospy.AnyMsg, self._on_message, index, queue_size=1, tcp_nodelay=True
            )
            if index in self._kept:
                self._kept[index].subscriber = subscriber
        for index in range(1, len(config["command_topics"])):
            self._hear_commands(index)
        self._is_joined = True

    def _advertise(self, kind: str) -> None:
        """Publish commands of this type from now on, unless this is a check."""
        self._command_type = kind
        if self._config["is_check"]:
            return
        self._publisher = self._rospy.Publisher(
            self._config["command_topics"][0], self._class_of(kind), subscriber_listener=self,
            tcp_nodelay=True, queue_size=1,
        )  # fmt: skip
        self._publisher.impl.set_queue_size(None)  # written at once, by the publishing thread

    def _class_of(self, kind: str) -> Any:
        """A class of messages that are given as their bytes."""
        md5sum, text = self._config["definitions"][kind]
        fields = {"_type": kind, "_md5sum": md5sum, "_full_text": text}
        return type("Message", (self._rospy.AnyMsg,), fields)

    def _follow_type(self, wanted: Any, connected: int) -> None:
        """Publish commands in the type to which all listeners subscribe.

        The type stays while a node is connected to the topic of commands, and if listeners want
        different types. If the type changes, the adapter ends and the driver starts a new adapter,
        since rospy cannot advertise a topic again with another type.

        `wanted`: the types of the listeners. `connected`: the number of connected nodes.
        """
        allowed = self._config["command_types"]
        kinds = {kind for kind in wanted if kind in allowed}
        if len(allowed) == 1 or len(kinds) != 1 or connected:
            return
        (kind,) = kinds
        if not self._command_type:
            self._advertise(kind)
        elif kind != self._command_type:
            self.end(0.0, f"the base wants {kind} now", "restart")

    def _configure_bases(self, tcpros: Any) -> None:
        """Set the options of the socket of each node that connects, before rospy uses it.

        1. TCP_NODELAY: Nagle's algorithm would delay a second command by up to 40 ms.
        2. A limit of time for writing: a base that no longer reads is disconnected, and may connect
           again.
        3. A limit of time for the header: a node that connects and sends nothing would block all
           other nodes, since rospy would wait for its header for a minute or more.
        """
        tcpros.start_tcpros_server()
        server = tcpros._tcpros_server.tcp_ros_server
        handle = server.inbound_handler

        def configured(sock: socket.socket, address: Any) -> None:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _WRITE_TIMEOUT)
            sock.settimeout(_HANDSHAKE_TIMEOUT)  # until rospy has the header; then it blocks
            handle(sock, address)

        server.inbound_handler = configured

    def _publish(self, payload: bytes, publisher: Any = None) -> None:
        """Publish a command, or a message of another publisher."""
        publisher = publisher or self._publisher
        if publisher is None:
            return
        message = publisher.data_class()
        message._buff = payload
        try:
            publisher.publish(message)
        except Exception as error:  # rospy may be closing its topics
            sys.stderr.write(f"a message could not be sent: {error}\n")

    def _zero_bytes(self) -> bytes:
        if not self._command_type.endswith("Stamped"):
            return bytes(_TWIST.size)
        frame: bytes = self._config["frame_id"].encode()
        now = time.time_ns()
        stamp = now // 1_000_000_000, now % 1_000_000_000
        return struct.pack("<4I", 0, *stamp, len(frame)) + frame + bytes(_TWIST.size)

    def peer_unsubscribe(self, topic: str, peers: int) -> None:
        """Poll the master at once, since a subscriber has left; rospy calls this."""
        self._master.forget()
        self._wake.set()

    def peer_subscribe(self, topic: str, publish: Any, publish_to: Any) -> None:
        """Send zero to a base that has connected, while the robot is driven; rospy calls this."""
        self._master.forget()
        self._wake.set()
        if self._holds:
            self._is_armed = True
            self._holds_until = time.monotonic() + ZERO_TIME
        if self._publisher is not None and self._commanded_at > 0.0:
            message = self._publisher.data_class()
            message._buff = self._zero_bytes()
            self._publisher.impl.acquire()
            try:
                publish_to(message)
            finally:
                self._publisher.impl.release()

    def _on_shutdown(self) -> None:
        self.end(0.0, "ROS has shut the adapter's node down")
        if self._is_armed:
            self._publish(self._zero_bytes())

    # From ROS

    def _on_message(self, message: Any, index: int) -> None:
        """Pass a message to the driver; of another type only its publisher. rospy calls this."""
        arrival = time.monotonic()
        header = message._connection_header
        if header.get("md5sum") == self._config["md5sums"][index]:
            self._send_message(header, index, arrival, message._buff)
        else:
            names = {"node": "callerid", "type": "type", "md5sum": "md5sum"}
            fields = {name: header.get(key, "") for name, key in names.items()}
            self.event({"event": "foreign", "topic": self._config["topics"][index], **fields})

    def _send_message(self, header: Any, topic: int, arrival: float, content: bytes) -> None:
        """Send a message; on a kept topic until the driver takes it. `topic`: as in packet D."""
        packet = DATA_HEAD.pack(DATA, topic, arrival), content
        if topic in self._kept:
            self._kept[topic].take(header, *packet)
        else:
            self.send(*packet)

    def _listen_to_others(self, is_wanted: bool) -> None:
        """Subscribe to the topic of commands while other nodes publish there.

        The subscription also receives this node's own commands, which are ignored.
        """
        if is_wanted and self._others is None:
            self._others = self._hear_commands(0)
        elif not is_wanted and self._others is not None:
            self._others.unregister()
            self._others = None

    def _hear_commands(self, index: int) -> Any:
        """Subscribe to a topic of commands or stops, whatever its type."""
        return self._rospy.Subscriber(
            self._config["command_topics"][index], self._rospy.AnyMsg, self._on_other_command,
            index, queue_size=1, tcp_nodelay=True,
        )  # fmt: skip

    def _on_other_command(self, message: Any, index: int) -> None:
        header = message._connection_header
        arrival = time.monotonic()
        if header.get("callerid") != self._master.caller:
            known = [md5sum for md5sum, _ in self._config["definitions"].values()]
            content = message._buff[:_MAX_TEXT] if header.get("md5sum") in known else b""
            self._send_message(header, len(self._config["topics"]) + index, arrival, content)

    def _state(self) -> Any:
        """The event `state`: what the master knows of the driver's topics (adapter.MasterState).

        Ends the adapter if the master was restarted, or if the type of commands must change.
        """
        master = self._master
        publishers, subscribers, _ = master.call("getSystemState")
        # nodes by topic
        publishers_of = dict(publishers)
        subscribers_of = dict(subscribers)
        self._end_after_restart(subscribers_of)
        types = dict(master.call("getTopicTypes"))
        topics = self._config["topics"]
        command_topic, *further_command_topics = self._config["command_topics"]
        listeners = [
            node
            for node in subscribers_of.get(command_topic, ())
            # An adapter of a driver subscribes to commands, too, but is no base.
            if not _is_adapter(node) and master.is_alive(node)
        ]
        connected = 0 if self._publisher is None else self._bases()
        wants = {}
        if connected < len(listeners):  # a listener that does not connect may want another type
            wants = {node: master.wants(node, command_topic) for node in listeners}
        self._follow_type(wants.values(), connected)
        return {
            "event": "state",
            "master": True,
            "publishers": {
                topic: self._alive(publishers_of.get(topic, []))
                for topic in [*topics, *further_command_topics]
            },
            "types": {topic: types.get(topic, "") for topic in topics},
            "candidates": self._published_topics(types, publishers_of),
            "taken_topics": self._taken_topics(types, subscribers_of),
            "others": [
                node
                for node in publishers_of.get(command_topic, ())
                if node != master.caller and master.is_alive(node)
            ],
            "listeners": listeners,
            "connected": connected,
            "wants": wants,
            "command_type": self._command_type,
        }

    def _end_after_restart(self, subscribers_of: Any) -> None:
        """End the adapter if the master was restarted, and so has forgotten this node.

        The sign: in two polls in a row a subscription of this node is missing in `subscribers_of`,
        the subscribed nodes by topic.
        """
        caller = self._master.caller
        topics = self._config["topics"]
        is_listed = all(caller in subscribers_of.get(topic, ()) for topic in topics)
        self._misses = 0 if is_listed else self._misses + 1
        if self._misses >= 2:
            self.end(0.0, "the ROS master has been restarted", "restart")

    def _published_topics(self, types: Any, publishers_of: Any) -> Any:
        """The published topics of each type that the driver reads.

        The driver proposes these topics to the user in place of a missing topic.
        """
        return {
            kind: sorted(
                topic
                for topic, topic_type in types.items()
                if topic_type == kind and publishers_of.get(topic)
            )
            for kind in self._config["types"]
        }

    def _taken_topics(self, types: Any, subscribers_of: Any) -> Any:
        """The topics of each command type to which a node subscribes that is no adapter.

        The driver proposes these topics to the user if no base takes the commands.
        """
        return {
            kind: sorted(
                topic
                for topic, nodes in subscribers_of.items()
                if types.get(topic) == kind and not all(map(_is_adapter, nodes))
            )
            for kind in self._config["command_types"]
        }

    def _bases(self) -> int:
        """The number of nodes connected to the topic of commands, without adapters."""
        ends = getattr(self._publisher.impl, "connections", ())
        adapters = sum(_is_adapter(end.endpoint_id) for end in ends)
        return int(self._publisher.get_num_connections()) - adapters

    def _alive(self, nodes: Any) -> Any:
        """The publishers that answer; a single publisher is returned without asking."""
        return [n for n in nodes if self._master.is_alive(n)] if len(nodes) > 1 else nodes

    # To the driver

    def _report(self, state: Any) -> None:
        if state != self._reported and self.event(state):
            self._reported = state

    def event(self, event: Any) -> bool:
        """Send an event to the driver; False if the socket is full or closed."""
        return self.send(EVENT, json.dumps(event).encode())

    def send(self, *parts: bytes) -> bool:
        """Send a packet; False if it is dropped, since the socket is full or closed."""
        try:
            self._sock.sendmsg(parts, [], socket.MSG_DONTWAIT)
        except OSError:
            return False  # `_read` notices the end of the socket
        return True

    # From the driver

    def _read(self) -> None:
        while True:
            try:
                frame = self._sock.recv(65536)
            except OSError:
                frame = b""
            kind = frame[:1]
            if not kind:
                return self.end(ZERO_TIME)
            if kind == FAREWELL:
                return self.end(0.0)
            if kind == STATE and self._answers is not None:
                self._publish(frame[COMMAND_HEAD.size :], self._answers)
            if kind == COMMAND and len(frame) > COMMAND_HEAD.size and self._ends_at is None:
                now = time.monotonic()
                if now - COMMAND_HEAD.unpack_from(frame)[1] < _MAX_COMMAND_AGE:
                    self._pass_on(frame[COMMAND_HEAD.size :], now)

    def _pass_on(self, command: bytes, now: float) -> None:
        if now < self._stops_until:
            command = self._zero_bytes()
        self._publish(command)
        self._commanded_at = now
        self._holds = False
        if any(_TWIST.unpack(command[-_TWIST.size :])):
            self._is_armed = True
            self._moved_at = now
        elif now - self._moved_at > _DISARM_TIME:
            self._is_armed = False  # the base stands: a silent daemon may be idle

    def _tick(self) -> None:
        """Send zeros while armed and the daemon is silent or has ended, and signs of life."""
        count = 0
        was_silent = True
        while True:
            now = time.monotonic()
            if self._rospy.is_shutdown() and self._is_joined:
                self._leave()
            if self._holds and now >= self._holds_until:
                self._is_armed = False
            is_silent = now - self._commanded_at > COMMAND_TIMEOUT or self._ends_at is not None
            if self._is_armed and is_silent:
                if not was_silent:
                    self._stops_until = now + ZERO_TIME
                self._publish(self._zero_bytes())
            was_silent = is_silent
            if self._ends_at is not None and (now >= self._ends_at or not self._is_armed):
                self._leave()
            for kept in self._kept.values():
                kept.send_again()
            if count % _TICKS_ALIVE == 0:
                self.send(ALIVE)
            count += 1
            time.sleep(_PERIOD)

    def _leave(self) -> None:
        """Unregister this node from the master, within _LEAVE_TIMEOUT, and exit."""
        if self._is_joined:
            shutdown = self._rospy.signal_shutdown
            threading.Thread(target=shutdown, args=("the driver has ended",), daemon=True).start()
            deadline = time.monotonic() + _LEAVE_TIMEOUT
            while not self._rospy.is_shutdown() and time.monotonic() < deadline:
                time.sleep(0.01)
        os._exit(0)


def _is_adapter(node: str) -> bool:
    """True for the node of a `ros1` driver, by its name."""
    return node.rpartition("/")[2].startswith("swarmd_")


class _Errors(io.TextIOBase):
    """Standard error that neither blocks nor raises: its reader may be frozen or gone."""

    def write(self, text: str) -> int:
        """Write it unless that would block."""
        with contextlib.suppress(OSError):
            os.write(2, text.encode(errors="replace"))
        return len(text)


def load_rospy() -> Any:
    """Import rospy, also from /opt/ros without a sourced set-up file; raises ImportError."""
    folders: List[str] = sorted(glob("/opt/ros/*/lib/python3/dist-packages"))  # noqa: UP006
    try:
        return importlib.import_module("rospy")
    except ImportError:
        if not folders:
            raise
    sys.path += folders
    return importlib.import_module("rospy")


def main() -> None:
    """Serve the driver at the other end of standard input."""
    config = json.loads(sys.argv[1])
    reach = importlib.import_module("master").Master  # beside this file
    master = reach(config["master"], "/" + config["name"])
    del sys.path[0]  # this folder: its modules are not for this interpreter
    os.set_blocking(2, False)
    sys.stderr = _Errors()
    resource.setrlimit(resource.RLIMIT_DATA, (_MAX_MEMORY, _MAX_MEMORY))
    sock = socket.socket(fileno=os.dup(0))
    sys.setswitchinterval(0.0005)  # s: polling the master must not delay a command
    try:
        rospy = load_rospy()
    except ImportError as error:
        sock.send(
            EVENT + json.dumps({"event": "end", "kind": "fatal", "text": str(error)}).encode()
        )
        return
    adapter = Adapter(config, sock, rospy, master)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: adapter.end(ZERO_TIME, "a signal ended the adapter"))
    adapter.run()


if __name__ == "__main__":
    main()
