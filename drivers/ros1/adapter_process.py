"""The adapter of driver `ros1`: a process under the system's Python with rospy.

It passes serialised messages on, in both directions, over the socket that is its standard input,
and reports what the master knows. Needs Python 3.8, rospy and the standard library; of this project
it imports `master.py` alone, which lies beside it. The driver imports it for the frames, which
are single packets:

    to the driver   D topic arrival bytes  a message of that index in `topics`; arrival in s on
                                           CLOCK_MONOTONIC; the indices after the last are commands
                                           of other nodes on `command_topics`, each empty if it is
                                           no Twist and no TwistStamped
                    J {...}                an event as JSON: state, foreign, gone, end
                    H                      a sign of life
    to the adapter  C time bytes           a command, made at `time` on CLOCK_MONOTONIC
                    B                      farewell: send zero and leave

It outlives its daemon. When no command follows a non-zero one, or the first zeros after it, for
0.4 s, it sends zeros until the daemon is back, for at least 2 s. At the end of the socket it sends
zeros for 2 s and leaves.
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

DATA, EVENT, ALIVE = b"D", b"J", b"H"
COMMAND, FAREWELL = b"C", b"B"
DATA_HEAD = struct.Struct("<cId")
COMMAND_HEAD = struct.Struct("<cd")

COMMAND_TIMEOUT = 0.4
"""Seconds without a command after which the adapter itself sends zeros."""
ZERO_TIME = 2.0
"""Seconds of zeros after the daemon has ended; at least as long after it was silent."""

_PERIOD = 0.05
_TICKS_ALIVE = 4
_MAX_COMMAND_AGE = 0.2  # s; an older command is from before its daemon was frozen
_DISARM_TIME = 0.5  # s of zeros after which the daemon may be silent
_POLL_PERIOD = 1.0
_RETRY_PERIOD = 0.3
_WRITE_TIMEOUT = struct.pack("@ll", 0, 100_000)  # s and us that writing a command may take
_HANDSHAKE_TIMEOUT = 1.0  # s within which a connected node has to send its header
_LEAVE_TIMEOUT = 1.0  # s for unregistering this node from the master
_MAX_MEMORY = 512 << 20  # bytes; rospy allocates whatever length a message announces
_TWIST = struct.Struct("<6d")


class KeptTopic:
    """The last message of a topic that is published on change: sent until the driver has taken it.

    rospy keeps a connection whose publisher has ended, and dials again; a connection that is made
    again has another header.
    """

    def __init__(self, index: int, adapter: Adapter) -> None:
        self._index, self._adapter = index, adapter
        self.subscriber: Any = None
        self._lock = threading.Lock()
        self._unsent: Any = None
        self._header: Any = None

    def take(self, header: Any, *packet: bytes) -> None:
        """Send a message that came over the connection with this header."""
        with self._lock:
            self._header = header
            self._unsent = None if self._adapter.send(*packet) else packet

    def send_again(self) -> None:
        """Send what the driver has not taken yet."""
        with self._lock:
            if self._unsent is not None and self._adapter.send(*self._unsent):
                self._unsent = None

    def report_end(self) -> None:
        """Tell that the connection of the last message has ended; until the driver knows it."""
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
    """All threads of this process: `run` polls the master; others read, tick and receive."""

    def __init__(self, config: Any, sock: socket.socket, rospy: Any, master: Any) -> None:
        self._config, self._sock, self._rospy, self._master = config, sock, rospy, master
        self._command_type = ""
        self._publisher: Any = None
        self._is_joined = False
        self._misses = 0
        self._wake = threading.Event()
        self._ends_at: Optional[float] = None  # noqa: UP045
        # A robot that an earlier adapter drove is stopped as soon as it is reachable; unless the
        # daemon commands it again, other nodes may drive it after enough zeros.
        self._is_armed = self._holds = bool(config["holds"])
        self._holds_until = float("inf")
        self._commanded_at = self._moved_at = self._stops_until = -COMMAND_TIMEOUT
        self._reported: Any = None
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
                    self._master.call("getSystemState")  # nodes have no such thing
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
        """Report why, send zeros for that long unless the base stands, then leave."""
        if why and self._ends_at is None:
            self.event({"event": "end", "kind": kind, "text": why})
        ends_at = time.monotonic() + seconds
        self._ends_at = ends_at if self._ends_at is None else min(ends_at, self._ends_at)

    # To ROS

    def _join(self) -> None:
        rospy, config = self._rospy, self._config
        rospy.init_node(config["name"], argv=[], anonymous=True, disable_signals=True,
                        disable_rosout=True)  # fmt: skip
        self._master.caller = rospy.get_name()
        self._configure_bases(rospy.impl.tcpros_base)
        rospy.on_shutdown(self._on_shutdown)  # called before topics close, as on `rosnode kill`
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
        rospy, (md5sum, text) = self._rospy, self._config["definitions"][kind]
        fields = {"_type": kind, "_md5sum": md5sum, "_full_text": text}
        self._message = type("Command", (rospy.AnyMsg,), fields)
        self._publisher = rospy.Publisher(
            self._config["command_topics"][0], self._message, subscriber_listener=self,
            tcp_nodelay=True, queue_size=1,
        )  # fmt: skip
        self._publisher.impl.set_queue_size(None)  # written at once, by the publishing thread

    def _follow_type(self, wanted: Any, connected: int) -> None:
        """Publish commands in the type that the base wants, once all that tell one agree.

        rospy does not advertise a topic again with another type: then the adapter is replaced.
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
        """Configure the socket of each base that connects, before rospy does.

        Nagle's algorithm would delay a second command by up to 40 ms. A base that no longer reads
        is disconnected instead of waited for: it may connect again. A node that connects and sends
        nothing would block all others: rospy would wait for its header for a minute or more.
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

    def _publish(self, payload: bytes) -> None:
        if self._publisher is None:
            return
        message = self._message()
        message._buff = payload
        try:
            self._publisher.publish(message)
        except Exception as error:  # rospy may be closing its topics
            sys.stderr.write(f"a command could not be sent: {error}\n")

    def _zero_bytes(self) -> bytes:
        if not self._command_type.endswith("Stamped"):
            return bytes(_TWIST.size)
        frame: bytes = self._config["frame_id"].encode()
        now = time.time_ns()
        stamp = now // 1_000_000_000, now % 1_000_000_000
        return struct.pack("<4I", 0, *stamp, len(frame)) + frame + bytes(_TWIST.size)

    def peer_unsubscribe(self, topic: str, peers: int) -> None:
        """A base has left; called by rospy."""
        self._master.forget()
        self._wake.set()

    def peer_subscribe(self, topic: str, publish: Any, publish_to: Any) -> None:
        """A base has connected; called by rospy. While the robot is driven it gets zero first."""
        self._master.forget()
        self._wake.set()
        if self._holds:
            self._is_armed, self._holds_until = True, time.monotonic() + ZERO_TIME
        if self._publisher is not None and self._commanded_at > 0.0:
            message = self._message()
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
        """Pass one message on, on rospy's thread; of one of another type only its publisher."""
        arrival = time.monotonic()
        header = message._connection_header
        if header.get("md5sum") == self._config["md5sums"][index]:
            packet = DATA_HEAD.pack(DATA, index, arrival), message._buff
            if index in self._kept:
                self._kept[index].take(header, *packet)
            else:
                self.send(*packet)
        else:
            names = {"node": "callerid", "type": "type", "md5sum": "md5sum"}
            fields = {name: header.get(key, "") for name, key in names.items()}
            self.event({"event": "foreign", "topic": self._config["topics"][index], **fields})

    def _listen_to_others(self, is_wanted: bool) -> None:
        """Hear the commands of other nodes while there are any; also hears this node's own."""
        if is_wanted and self._others is None:
            self._others = self._hear_commands(0)
        elif not is_wanted and self._others is not None:
            self._others.unregister()
            self._others = None

    def _hear_commands(self, index: int) -> Any:
        """Subscribe to a topic of commands, whatever its type."""
        return self._rospy.Subscriber(
            self._config["command_topics"][index], self._rospy.AnyMsg, self._on_other_command,
            index, queue_size=1, tcp_nodelay=True,
        )  # fmt: skip

    def _on_other_command(self, message: Any, index: int) -> None:
        header, arrival = message._connection_header, time.monotonic()
        if header.get("callerid") != self._master.caller:
            known = [md5sum for md5sum, _ in self._config["definitions"].values()]
            head = DATA_HEAD.pack(DATA, len(self._config["topics"]) + index, arrival)
            self.send(head, message._buff if header.get("md5sum") in known else b"")

    def _state(self) -> Any:
        """What the master knows of our topics."""
        master = self._master
        publishers, subscribers, _ = master.call("getSystemState")
        publishes, subscribes = dict(publishers), dict(subscribers)
        topics = self._config["topics"]
        command, *others_too = self._config["command_topics"]
        is_listed = all(master.caller in subscribes.get(topic, ()) for topic in topics)
        self._misses = 0 if is_listed else self._misses + 1
        if self._misses >= 2:
            self.end(0.0, "the ROS master has been restarted", "restart")
        types = dict(master.call("getTopicTypes"))
        others = [n for n in publishes.get(command, ()) if n != master.caller]
        listeners = [
            n for n in subscribes.get(command, ()) if not _is_adapter(n) and master.is_alive(n)
        ]
        connected = 0 if self._publisher is None else self._bases()
        wants = {}
        if connected < len(listeners):
            wants = {node: master.wants(node, command) for node in listeners}
        self._follow_type(wants.values(), connected)
        return {
            "event": "state",
            "master": True,
            "publishers": {
                topic: self._alive(publishes.get(topic, [])) for topic in [*topics, *others_too]
            },
            "types": {topic: types.get(topic, "") for topic in topics},
            "candidates": {
                kind: sorted(t for t, k in types.items() if k == kind and publishes.get(t))
                for kind in self._config["types"]
            },
            "taken_topics": {
                kind: sorted(
                    topic
                    for topic, nodes in subscribes.items()
                    if types.get(topic) == kind and not all(map(_is_adapter, nodes))
                )
                for kind in self._config["command_types"]
            },
            "others": [n for n in others if master.is_alive(n)],
            "listeners": listeners,
            "connected": connected,
            "wants": wants,
            "command_type": self._command_type,
        }

    def _bases(self) -> int:
        """How many nodes take commands, without the adapters that hear them."""
        ends = getattr(self._publisher.impl, "connections", ())
        adapters = sum(_is_adapter(end.endpoint_id) for end in ends)
        return int(self._publisher.get_num_connections()) - adapters

    def _alive(self, nodes: Any) -> Any:
        """Of several publishers those that live; a single one is not asked."""
        return [n for n in nodes if self._master.is_alive(n)] if len(nodes) > 1 else nodes

    # To the driver

    def _report(self, state: Any) -> None:
        if state != self._reported and self.event(state):
            self._reported = state

    def event(self, event: Any) -> bool:
        """Tell the driver; False if it does not read."""
        return self.send(EVENT, json.dumps(event).encode())

    def send(self, *parts: bytes) -> bool:
        """One packet; False if the driver does not read: messages are of no use later."""
        try:
            self._sock.sendmsg(parts, [], socket.MSG_DONTWAIT)
        except OSError:
            return False  # its end is seen by the reader
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
            if kind == COMMAND and len(frame) > COMMAND_HEAD.size and self._ends_at is None:
                now = time.monotonic()
                if now - COMMAND_HEAD.unpack_from(frame)[1] < _MAX_COMMAND_AGE:
                    self._pass_on(frame[COMMAND_HEAD.size :], now)

    def _pass_on(self, command: bytes, now: float) -> None:
        if now < self._stops_until:
            command = self._zero_bytes()
        self._publish(command)
        self._commanded_at, self._holds = now, False
        if any(_TWIST.unpack(command[-_TWIST.size :])):
            self._is_armed, self._moved_at = True, now
        elif now - self._moved_at > _DISARM_TIME:
            self._is_armed = False  # it stands: silence may be that of an idle daemon

    def _tick(self) -> None:
        """Zeros while the daemon is silent and on the way out; also the signs of life."""
        count, was_silent = 0, True
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
        """Take our names off the master, if it answers, and end."""
        if self._is_joined:
            shutdown = self._rospy.signal_shutdown
            threading.Thread(target=shutdown, args=("the driver has ended",), daemon=True).start()
            deadline = time.monotonic() + _LEAVE_TIMEOUT
            while not self._rospy.is_shutdown() and time.monotonic() < deadline:
                time.sleep(0.01)
        os._exit(0)


def _is_adapter(node: str) -> bool:
    """True for the node of a driver such as this one's."""
    return node.rpartition("/")[2].startswith("swarmd_")


class _Errors(io.TextIOBase):
    """Standard error that neither blocks nor raises: its reader may be frozen or gone."""

    def write(self, text: str) -> int:
        """Write it unless that would block."""
        with contextlib.suppress(OSError):
            os.write(2, text.encode(errors="replace"))
        return len(text)


def load_rospy() -> Any:
    """rospy, also of a ROS under /opt that no set-up file has been sourced for; ImportError."""
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
