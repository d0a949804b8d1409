"""A headless Chromium, told what to do through its own pipe (Chrome DevTools protocol).

The messages are JSON with a zero byte behind each; Chromium reads them from file descriptor 3 and
writes to 4, so that no package is needed.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", "--no-first-run")
LAUNCH = """
import os, sys
ends = [os.dup(os.dup(os.dup(int(end)))) for end in sys.argv[1:3]]  # none of them is 3 or 4
for end, number in zip(ends, (3, 4)):
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Become the browser, with the ends of the pipes where it looks for them."""
PATIENCE = 120.0
"""Longest wait for one answer [s]."""


def found() -> str | None:
    """The path of a browser, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One tab.  `said` collects what the page writes to its console, and its errors."""

    def __init__(self, folder: Path, width: int = 1280, height: int = 900) -> None:
        told, self._told = os.pipe()
        self._heard, hears = os.pipe()
        self.said: list[str] = []
        self._number, self._left = 0, b""
        command = [str(found()), *FLAGS, f"--user-data-dir={folder}"]
        self._process = subprocess.Popen(
            [sys.executable, "-c", LAUNCH, str(told), str(hears), *command],
            pass_fds=(told, hears), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(told)
        os.close(hears)
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = ""
        attached = self._ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self._ask(f"{domain}.enable")
        self.size(width, height)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._told)
        os.close(self._heard)

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """Set the size of the window [CSS px]."""
        self._ask("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=phone)  # fmt: skip

    def media(self, kind: str = "screen", scheme: str = "light") -> None:
        """Show the page on screen or as printed, in a light or dark scheme."""
        scheme_feature = {"name": "prefers-color-scheme", "value": scheme}
        self._ask("Emulation.setEmulatedMedia", media=kind, features=[scheme_feature])

    def script(self, on: bool) -> None:
        """Let pages run their script, or not."""
        self._ask("Emulation.setScriptExecutionDisabled", value=not on)

    def open(self, page: Path) -> None:
        """Load a file and wait until it is there."""
        self._ask("Page.navigate", url=page.resolve().as_uri())
        end = time.monotonic() + PATIENCE
        while self("document.readyState") != "complete" or self("location.href") == "about:blank":
            if time.monotonic() > end:
                raise TimeoutError(f"{page} was not loaded in {PATIENCE:g} s")
            time.sleep(0.05)

    def __call__(self, expression: str) -> Any:
        """The value of an expression of JavaScript; a promise is waited for."""
        answer = self._ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise AssertionError(json.dumps(answer["exceptionDetails"], indent=1))
        return answer["result"].get("value")

    def press(self, key: str) -> None:
        """A key goes down and up."""
        for kind in ("keyDown", "keyUp"):
            self._ask("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as PNG."""
        data = self._ask("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if getattr(self, "_session", ""):
            message["sessionId"] = self._session
        os.write(self._told, json.dumps(message).encode() + b"\0")
        while True:
            heard = self._hear()
            self._listen(heard)
            if heard.get("id") == self._number:
                if "error" in heard:
                    raise RuntimeError(f"{method}: {heard['error']}")
                answer: dict[str, Any] = heard["result"]
                return answer

    def _hear(self) -> dict[str, Any]:
        while b"\0" not in self._left:
            ready, _, _ = select.select([self._heard], [], [], PATIENCE)
            part = os.read(self._heard, 1 << 20) if ready else b""
            if not part:
                raise TimeoutError("the browser does not answer")
            self._left += part
        one, _, self._left = self._left.partition(b"\0")
        message: dict[str, Any] = json.loads(one)
        return message

    def _listen(self, heard: dict[str, Any]) -> None:
        told = heard.get("params", {})
        if heard.get("method") == "Runtime.consoleAPICalled":
            self.said += [str(part.get("value", part)) for part in told["args"]]
        elif heard.get("method") == "Runtime.exceptionThrown":
            self.said.append(json.dumps(told["exceptionDetails"])[:2000])
        elif heard.get("method") == "Log.entryAdded":
            self.said.append(told["entry"]["text"])
