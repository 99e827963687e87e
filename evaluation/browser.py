"""A browser without a screen, told what to do over its debugging socket: for tests and benchmarks of pages."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
import urllib.request
from itertools import count
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
"""The program; None where there is none (Debian: `apt install chromium`)."""
PATIENCE = 90.0
"""s to wait for an answer, on a machine that is busy with other things."""


class Browser:
    """Chromium with one page; a context manager. folder : for its profile, is made."""

    def __init__(self, folder: Path) -> None:
        options = ("--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0")
        self._folder = folder
        self._numbers = count(1)
        self._process = subprocess.Popen(
            [CHROMIUM or "chromium", *options, f"--user-data-dir={folder}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def __enter__(self) -> Browser:
        try:
            self._socket = connect(self._page(), max_size=None, open_timeout=PATIENCE, legacy=True)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()

    def _page(self) -> str:
        """Address of the page's debugging socket, once the browser runs. Raises TimeoutError."""
        told, until = self._folder / "DevToolsActivePort", time.monotonic() + PATIENCE
        while not (told.exists() and len(told.read_text().split()) == 2):
            if time.monotonic() > until:
                raise TimeoutError("the browser does not start")
            time.sleep(0.02)
        with urllib.request.urlopen(f"http://127.0.0.1:{told.read_text().split()[0]}/json/list") as answer:
            pages = json.load(answer)
        return str(next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page"))

    def open(self, address: str) -> None:
        """Go to an address; returns before it is loaded."""
        self._call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """Value of an expression in the page; None where it has none, or failed."""
        return self._call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def _call(self, method: str, **parameters: Any) -> Any:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == number:
                return answer["result"]
