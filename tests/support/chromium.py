"""A headless Chromium, driven over its own DevTools socket."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from tests.support.processes import CAP

FOUND = shutil.which("chromium") or shutil.which("chromium-browser")

_LONG_TASKS = """
window.longTasks = [];
new PerformanceObserver((list) => {
  for (const one of list.getEntries()) window.longTasks.push([one.startTime, one.duration]);
}).observe({ type: 'longtask', buffered: true });
window.errors = [];
addEventListener('error', (event) => window.errors.push(String(event.message)));
addEventListener('unhandledrejection', (event) => window.errors.push(String(event.reason)));
"""


class Page:
    """One page of a browser."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._last = 0

    def call(self, method: str, cap: float = CAP, **params: Any) -> Any:
        """The result of a DevTools method."""
        self._last += 1
        self._socket.send(json.dumps({"id": self._last, "method": method, "params": params}))
        until = time.monotonic() + cap
        while time.monotonic() < until:
            message = json.loads(self._socket.recv(timeout=cap))
            if message.get("id") == self._last:
                assert "error" not in message, (method, message["error"])
                return message["result"]
        raise AssertionError(f"{method} gave no answer")

    def events_until(self, method: str) -> list[dict[str, Any]]:
        """The parameters of the events that arrive until one of a name."""
        found: list[dict[str, Any]] = []
        while True:
            message = json.loads(self._socket.recv(timeout=CAP))
            if message.get("method") == method:
                return found
            if "method" in message:
                found.append(message["params"])

    def open(self, address: str) -> None:
        """Load a page."""
        self.call("Page.enable")
        self.call("Runtime.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=_LONG_TASKS)
        self.call("Page.navigate", url=address)
        self.until("document.readyState === 'complete' && !!window.swarm", "loaded")

    def evaluate(self, expression: str, cap: float = CAP) -> Any:
        """The value of an expression; a promise is awaited."""
        result = self.call(
            "Runtime.evaluate", cap, expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in result:
            raised = result["exceptionDetails"].get("exception", {})
            raise AssertionError(raised.get("description") or result["exceptionDetails"])
        return result["result"].get("value")

    def until(self, condition: str, what: str, cap: float = CAP) -> Any:
        """Wait until an expression is true; an error, as of what is not drawn yet, counts as false.

        The page looks itself, ten times a second, and answers once.
        """
        never = json.dumps(f"never: {what}")
        return self.evaluate(
            f"""new Promise((resolve, reject) => {{
              const ends = performance.now() + {1000 * cap};
              let error = '';
              const look = () => {{
                try {{ const value = {condition}; if (value) return resolve(value); error = ''; }}
                catch (raised) {{ error = ` (${{raised}})`; }}
                if (performance.now() > ends) return reject(new Error({never} + error));
                setTimeout(look, 100);
              }};
              look();
            }})""",
            cap=2.0 * cap,
        )

    def click(self, selector: str) -> None:
        """Click with the mouse in the middle of an element."""
        where = f"document.querySelector({json.dumps(selector)})"
        box = self.evaluate(
            f"(() => {{ const e = {where}; e.scrollIntoView({{block: 'center'}});"
            " const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2];"
            " })()"
        )
        self.mouse(box[0], box[1])

    def mouse(self, x: float, y: float, modifiers: int = 0) -> None:
        """Click at a place."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x,
                y=y,
                button="left",
                clickCount=1,
                modifiers=modifiers,
            )

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press, move and release."""
        self.call(
            "Input.dispatchMouseEvent",
            type="mousePressed",
            x=start[0],
            y=start[1],
            button="left",
            clickCount=1,
        )
        for share in (0.3, 0.7, 1.0):
            x = start[0] + share * (end[0] - start[0])
            y = start[1] + share * (end[1] - start[1])
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="left")
        self.call(
            "Input.dispatchMouseEvent",
            type="mouseReleased",
            x=end[0],
            y=end[1],
            button="left",
            clickCount=1,
        )

    def type(self, selector: str, text: str) -> None:
        """Type a text into a field."""
        self.evaluate(f"document.querySelector({json.dumps(selector)}).focus()")
        self.call("Input.insertText", text=text)

    def choose(self, selector: str, file: Path) -> None:
        """Choose a file in the file input at `selector`."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", files=[str(file)], nodeId=node)

    def key(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            text: dict[str, Any] = {"text": key} if kind == "keyDown" and len(key) == 1 else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, **text)

    def resize(self, width: int, height: int, *, is_phone: bool = False) -> None:
        """Another size of the window."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if is_phone else 1,
            mobile=is_phone,
        )

    def picture(self, path: Path) -> Path:
        """Write a screenshot."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(data))
        return path

    @property
    def errors(self) -> list[str]:
        """Errors of scripts."""
        return list(self.evaluate("window.errors"))


class Browser:
    """A running browser; each of its pages has cookies and storage of its own.

    A connection reads in a thread. It ends with its page, so that later tests have no such thread.
    """

    def __init__(self, port: str, path: str) -> None:
        self._devtools, self._path = f"ws://127.0.0.1:{port}", path

    @contextlib.contextmanager
    def page(self, width: int = 1400, height: int = 850) -> Iterator[Page]:
        """A page that is closed when this returns."""
        with self._connected(self._path) as root:
            context = root.call("Target.createBrowserContext")["browserContextId"]
            target = root.call("Target.createTarget", url="about:blank", browserContextId=context)[
                "targetId"
            ]
            try:
                with self._connected(f"/devtools/page/{target}") as page:
                    page.resize(width, height)
                    yield page
            finally:
                root.call("Target.disposeBrowserContext", browserContextId=context)

    @contextlib.contextmanager
    def _connected(self, path: str) -> Iterator[Page]:
        with connect(self._devtools + path, max_size=2**26, open_timeout=CAP) as socket:
            yield Page(socket)


@contextlib.contextmanager
def chromium(folder: Path) -> Iterator[Browser]:
    """A browser that has ended when this returns."""
    assert FOUND is not None
    folder.mkdir(parents=True, exist_ok=True)
    process = subprocess.Popen(
        [
            FOUND,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--disable-extensions",
            "--no-first-run",
            "--remote-debugging-port=0",
            f"--user-data-dir={folder}",
            "about:blank",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "DBUS_SESSION_BUS_ADDRESS": "disabled:"},
    )
    try:
        yield Browser(*_devtools(folder / "DevToolsActivePort", process))
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextlib.contextmanager
def browser(folder: Path, width: int = 1400, height: int = 850) -> Iterator[Page]:
    """A browser with one page; it has ended when this returns."""
    with chromium(folder) as one, one.page(width, height) as page:
        yield page


def _devtools(file: Path, process: subprocess.Popen[bytes]) -> list[str]:
    """Port and path of the DevTools socket, which the browser writes once it listens."""
    ends = time.monotonic() + 2.0 * CAP
    while True:
        lines = file.read_text().splitlines() if file.exists() else []
        if len(lines) == 2:
            return lines
        assert process.poll() is None, "the browser has ended"
        assert time.monotonic() < ends, "the browser does not start"
        time.sleep(0.05)
