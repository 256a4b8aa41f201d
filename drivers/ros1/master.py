"""Calls to the XML-RPC API of the ROS master and of nodes, each with a limit of time.

`adapter_process.py` imports this module. So the module needs only Python 3.8 and the standard
library, and imports nothing of this project.
"""

from __future__ import annotations

import time
import xmlrpc.client
from typing import Any, Dict, Tuple  # noqa: UP035  (Python 3.8)

_CALL_TIMEOUT = 1.0  # s for a call of the master's or a node's API
_CACHE_TIME = 5.0  # s for which the answer of `is_alive` is kept


class Master:
    """The master's API, with a limit of time for each call; OSError if it does not answer."""

    def __init__(self, uri: str, caller: str) -> None:
        self.uri = uri
        self.caller = caller
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
        """False if a listed node refuses connections: a killed node stays on the master's list."""
        at, answer = self._alive.get(node, (-_CACHE_TIME, True))
        if time.monotonic() - at < _CACHE_TIME:
            return answer
        try:
            self.call("getPid", uri=self.call("lookupNode", node))
            answer = True
        except ConnectionError:
            answer = False
        except OSError:
            answer = True  # a timeout: the node may be slow, and may still publish
        self._alive[node] = time.monotonic(), answer
        return answer

    def forget(self) -> None:
        """Forget the answers of nodes, since a node has come or gone."""
        self._alive = {}

    def wants(self, node: str, topic: str) -> str:
        """The type of a node's subscription to a topic; empty if not known."""
        try:
            entries = self.call("getSubscriptions", uri=self.call("lookupNode", node))
        except OSError:
            return ""
        return next((str(kind) for name, kind in entries if name == topic), "")


class _Timed(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = _CALL_TIMEOUT
        return connection
