"""The half of driver `ros1` that speaks to ROS: a process under the system's Python with rospy.

It passes serialised messages on, in both directions, over the socket that is its standard input,
and tells what the master knows. Needs Python 3.8, rospy and the standard library; imports nothing
of this project. The driver imports it for the frames, which are single packets:

    to the driver   D link arrival bytes   a message; arrival in s on CLOCK_MONOTONIC
                    J {...}                an event as JSON: state, link, told
                    H                      it lives
    to the adapter  C time bytes           a command, made at `time` on CLOCK_MONOTONIC
                    B                      bye: send zero and leave

It outlives its guardian: 0.4 s after a command that was not zero, or the first zeros that followed,
it sends zeros until the guardian is back; after the end of the socket for 2 s, then it leaves.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import sys
import threading
import time
import xmlrpc.client
from glob import glob
from typing import Any, Callable, Dict, List, Optional, Tuple  # noqa: UP035  (Python 3.8)

DATA, EVENT, ALIVE = b"D", b"J", b"H"
COMMAND, BYE = b"C", b"B"
DATA_HEAD = struct.Struct("<cBd")
COMMAND_HEAD = struct.Struct("<cd")

SILENCE = 0.4
"""Seconds without a command after which the adapter itself sends zeros."""
STOPPING = 2.0
"""Seconds of zeros after the guardian has gone."""

_BEAT = 0.05
_BEATS_ALIVE = 4
_LATE = 0.2  # a command older than this was made by a guardian that has been stopped since
_ZEROED = 0.5  # s of zeros after which a guardian may be silent
_FLUSH = 0.15
_LOOK = 1.0
_RETRY = 0.3
_WRITE = struct.pack("@ll", 0, 100_000)  # s and us that writing a command may take
_CALL = 1.0  # s for a call of the master's or a node's API
_KNOWN_FOR = 5.0
_MAX_LINKS = 255
_TWIST_SIZE = 48


class Master:
    """The master's API, with a limit of time for each call; OSError if it does not answer."""

    def __init__(self, uri: str, caller: str) -> None:
        self.uri, self.caller = uri, caller
        self._alive: Dict[str, Tuple[float, bool]] = {}  # noqa: UP006

    def call(self, method: str, *arguments: str, uri: str = "") -> Any:
        """The value of one call to the master, or to the node at `uri`."""
        proxy = xmlrpc.client.ServerProxy(uri or self.uri, transport=_Timed())
        try:
            code, text, value = getattr(proxy, method)(self.caller, *arguments)
        except OSError:
            raise
        except Exception as error:  # not XML, not HTTP, or a fault of the other end
            raise OSError(str(error)) from error
        finally:
            proxy("close")()
        if code != 1:
            raise OSError(text)
        return value

    def is_alive(self, node: str) -> bool:
        """Whether a node that the master lists still answers: who was killed stays on its list."""
        at, answer = self._alive.get(node, (-_KNOWN_FOR, True))
        if time.monotonic() - at < _KNOWN_FOR:
            return answer
        try:
            self.call("getPid", uri=self.call("lookupNode", node))
            answer = True
        except ConnectionError:
            answer = False
        except OSError:
            answer = True  # slow or behind a network that fails; it may still publish
        self._alive[node] = time.monotonic(), answer
        return answer

    def wants(self, node: str, topic: str) -> str:
        """The type that a node has subscribed to on a topic; empty if that cannot be told."""
        try:
            entries = self.call("getSubscriptions", uri=self.call("lookupNode", node))
        except OSError:
            return ""
        return next((str(kind) for name, kind in entries if name == topic), "")


class _Timed(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = _CALL
        return connection


class Adapter:
    """All threads of this process: `run` looks at the master; others read, beat and receive."""

    def __init__(self, config: Any, sock: socket.socket, rospy: Any) -> None:
        self._config, self._sock, self._rospy = config, sock, rospy
        self._master = Master(config["master"], "/" + config["name"])
        self._command = config["command"]
        self._publisher: Any = None
        self._is_joined = False
        self._misses = 0
        self._links: Dict[Tuple[str, ...], int] = {}  # noqa: UP006
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._ends_at: Optional[float] = None  # noqa: UP045
        # A robot that an earlier adapter drove is stopped as soon as it can be reached.
        self._is_armed = bool(config["holds"])
        self._commanded_at = self._moved_at = -SILENCE
        self._told: Any = None

    def run(self) -> None:
        """Serve until the driver says bye or is gone, or ROS is to be begun anew."""
        for work in (self._read, self._beat):
            threading.Thread(target=work, daemon=True).start()
        try:
            self._look()
        except Exception as error:  # rospy may raise anything; its threads would live on
            self.end(0.0, f"the adapter failed: {error!r}")
            raise

    def _look(self) -> None:
        while True:
            self._wake.clear()
            try:
                if not self._is_joined:
                    self._master.call("getPid")
                    self._join()
                self._tell(self._state())
            except OSError as error:
                self._tell({"event": "state", "master": False, "text": str(error)})
            self._wake.wait(_LOOK if self._is_joined else _RETRY)

    def end(self, seconds: float, why: str = "", kind: str = "end") -> None:
        """Tell the driver why, send zeros for that long unless the base stands, then leave."""
        if why and self._ends_at is None:
            self._event({"event": "told", "kind": kind, "text": why})
        ends_at = time.monotonic() + seconds
        self._ends_at = ends_at if self._ends_at is None else min(ends_at, self._ends_at)

    # To ROS

    def _join(self) -> None:
        rospy, config = self._rospy, self._config
        rospy.init_node(config["name"], argv=[], anonymous=True, disable_signals=True,
                        disable_rosout=True)  # fmt: skip
        self._master.caller = rospy.get_name()
        rospy.on_shutdown(self._on_shutdown)  # called before topics close, as on `rosnode kill`
        if self._command is not None:
            kind = {f"_{k}": self._command[k] for k in ("type", "md5sum", "full_text")}
            self._message = type("Command", (rospy.AnyMsg,), kind)
            self._publisher = rospy.Publisher(
                self._command["topic"], self._message, subscriber_listener=_Listener(self._on_base),
                tcp_nodelay=True, queue_size=1,
            )  # fmt: skip
            self._publisher.impl.set_queue_size(None)  # written at once, by who publishes
        for topic in config["topics"]:
            rospy.Subscriber(
                topic, rospy.AnyMsg, self._on_message, topic, queue_size=1, tcp_nodelay=True
            )
        self._is_joined = True

    def _publish(self, payload: bytes) -> None:
        if self._publisher is None:
            return
        message = self._message()
        message._buff = payload
        try:
            self._publisher.publish(message)
        except Exception as error:  # rospy may be closing its topics
            print(f"a command could not be sent: {error}", file=sys.stderr)

    def _zero(self) -> None:
        self._publish(self._zero_bytes())

    def _zero_bytes(self) -> bytes:
        if self._command is None or not self._command["type"].endswith("Stamped"):
            return bytes(_TWIST_SIZE)
        frame: bytes = self._command["frame_id"].encode()
        now = time.time_ns()
        stamp = now // 1_000_000_000, now % 1_000_000_000
        return struct.pack("<4I", 0, *stamp, len(frame)) + frame + bytes(_TWIST_SIZE)

    def _on_base(self, publish_to: Any) -> None:
        """A base has connected, or left (None); one that connects while we drive gets zero first.

        Nagle's algorithm would hold a second command back for up to 40 ms. A base that no longer
        reads is given up instead of waited for: it may connect again.
        """
        self._wake.set()
        for cell in getattr(publish_to, "__closure__", None) or ():
            sock = getattr(cell.cell_contents, "socket", None)
            if isinstance(sock, socket.socket):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _WRITE)
        if publish_to is not None and self._publisher is not None and self._commanded_at > 0.0:
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
            self._zero()
            time.sleep(_FLUSH)  # a thread of rospy's writes it

    # From ROS

    def _on_message(self, message: Any, topic: str) -> None:
        """Pass one message on; on rospy's thread of that connection."""
        arrival = time.monotonic()
        header = message._connection_header
        key = topic, header.get("callerid", ""), header.get("type", ""), header.get("md5sum", "")
        link = self._links.get(key)
        if link is None:
            with self._lock:
                link = self._links.setdefault(key, len(self._links) % _MAX_LINKS)
            names = ("topic", "node", "type", "md5sum")
            self._event({"event": "link", "link": link, **dict(zip(names, key))})  # noqa: B905
        self._send(DATA_HEAD.pack(DATA, link, arrival), message._buff)

    def _state(self) -> Any:
        """What the master knows of our topics."""
        master, rospy = self._master, self._rospy
        publishers, subscribers, _ = master.call("getSystemState")
        publishes, subscribes = dict(publishers), dict(subscribers)
        topics = self._config["topics"]
        is_listed = all(master.caller in subscribes.get(topic, ()) for topic in topics)
        self._misses = 0 if is_listed else self._misses + 1
        if self._misses >= 2:
            self.end(0.0, "the ROS master has been restarted", "restart")
        types = dict(master.call("getTopicTypes"))
        command = self._config["command_topic"]
        others = [n for n in publishes.get(command, ()) if n != master.caller]
        listeners = [n for n in subscribes.get(command, ()) if master.is_alive(n)]
        connected = 0 if self._publisher is None else self._publisher.get_num_connections()
        wants = {}
        if connected < len(listeners):
            wants = {node: master.wants(node, command) for node in listeners}
        return {
            "event": "state",
            "master": True,
            "node": rospy.get_name(),
            "publishers": {topic: publishes.get(topic, []) for topic in topics},
            "types": {topic: types.get(topic, "") for topic in topics},
            "candidates": {
                kind: sorted(t for t, k in types.items() if k == kind and publishes.get(t))
                for kind in self._config["kinds"]
            },
            "others": [n for n in others if master.is_alive(n)],
            "listeners": listeners,
            "connected": connected,
            "wants": wants,
        }

    # To the driver

    def _tell(self, state: Any) -> None:
        if state != self._told:
            self._told = state
            self._event(state)

    def _event(self, event: Any) -> None:
        self._send(EVENT, json.dumps(event).encode())

    def _send(self, *parts: bytes) -> None:
        """One packet, or none if the driver does not read: what is old by then is of no use."""
        try:
            self._sock.sendmsg(parts, [], socket.MSG_DONTWAIT)
        except OSError:
            return  # its end is seen by the reader

    # From the driver

    def _read(self) -> None:
        while True:
            try:
                frame = self._sock.recv(65536)
            except OSError:
                frame = b""
            kind = frame[:1]
            if not kind:
                return self.end(STOPPING)
            if kind == BYE:
                return self.end(0.0)
            if kind == COMMAND and len(frame) > COMMAND_HEAD.size and self._ends_at is None:
                now = time.monotonic()
                if now - COMMAND_HEAD.unpack_from(frame)[1] < _LATE:
                    self._pass_on(frame[COMMAND_HEAD.size :], now)

    def _pass_on(self, command: bytes, now: float) -> None:
        self._publish(command)
        self._commanded_at = now
        if any(command[-_TWIST_SIZE:]):
            self._is_armed, self._moved_at = True, now
        elif now - self._moved_at > _ZEROED:
            self._is_armed = False  # it stands and knows it: silence may be an idle guardian's

    def _beat(self) -> None:
        """Zeros while the guardian is silent, and on the way out; also a sign of life."""
        count = 0
        while True:
            now = time.monotonic()
            if self._rospy.is_shutdown() and self._is_joined:
                self._leave()
            is_silent = now - self._commanded_at > SILENCE or self._ends_at is not None
            if self._is_armed and is_silent:
                self._zero()
            if self._ends_at is not None and (now >= self._ends_at or not self._is_armed):
                self._leave()
            if count % _BEATS_ALIVE == 0:
                self._send(ALIVE)
            count += 1
            time.sleep(_BEAT)

    def _leave(self) -> None:
        """Take our names off the master, if it answers, and end."""
        if self._is_joined:
            shutdown = self._rospy.signal_shutdown
            threading.Thread(target=shutdown, args=("the driver has ended",), daemon=True).start()
            deadline = time.monotonic() + _CALL
            while not self._rospy.is_shutdown() and time.monotonic() < deadline:
                time.sleep(0.01)
        os._exit(0)


class _Listener:
    """Whom rospy tells of bases that connect and leave."""

    def __init__(self, changed: Callable[[Any], None]) -> None:
        self._changed = changed

    def peer_subscribe(self, topic: str, publish: Any, publish_to: Any) -> None:
        """One has connected."""
        self._changed(publish_to)

    def peer_unsubscribe(self, topic: str, peers: int) -> None:
        """One has left."""
        self._changed(None)


def load_rospy() -> Any:
    """rospy, also of a ROS under /opt that no set-up file has been sourced for; ImportError."""
    import importlib

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
    del sys.path[0]  # this folder: its modules are not for this interpreter
    config = json.loads(sys.argv[1])
    sock = socket.socket(fileno=os.dup(0))
    sys.setswitchinterval(0.0005)  # s: a look at the master must not hold a command back
    try:
        rospy = load_rospy()
    except ImportError as error:
        sock.send(
            EVENT + json.dumps({"event": "told", "kind": "fatal", "text": str(error)}).encode()
        )
        return
    adapter = Adapter(config, sock, rospy)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: adapter.end(STOPPING, "somebody ended the adapter"))
    adapter.run()


if __name__ == "__main__":
    main()
