"""A real browser that shows the operator's page: what a person would see, click and press."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, sync_playwright
from tests.server.waiting import eventually

from .hall import SCENARIO

DESKTOP, PHONE, PHONE_ON_ITS_SIDE = (1280, 800), (390, 844), (844, 390)
_FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-proxy-server",
]
_PICTURE_PX = SCENARIO.camera.width_px, SCENARIO.camera.height_px


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start Chromium; without one, skip, except where the tests must run (``CI`` is set): then fail."""
    path = shutil.which("chromium")
    if path is None:
        reason = "Chromium is not installed: make browser"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=_FLAGS)
        yield browser
        browser.close()


class Screen:
    """The page in a window of its own."""

    def __init__(self, page: Page, url: str) -> None:
        """Open the page of the server at an address; what its console says of faults is gathered in ``faults``."""
        self.page = page
        self.faults: list[str] = []
        page.set_default_timeout(15_000)
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", self._hear)
        page.goto(url, wait_until="domcontentloaded")

    def _hear(self, line: ConsoleMessage) -> None:
        """Keep what the console says, but for refusals of the server, and advice on how these tests read canvases."""
        harmless = ("Failed to load resource", "Canvas2D: Multiple readback")
        if line.type in ("error", "warning") and not line.text.startswith(harmless):
            self.faults.append(line.text)

    def wait_live(self, *, within_s: float = 15.0) -> None:
        """Wait until the badge says that the picture is live."""
        self.wait("document.getElementById('badge').textContent === 'live'", within_s=within_s)

    def wait(self, condition: str, *, within_s: float = 15.0) -> None:
        """Wait until an expression of JavaScript is true. From outside: the page itself may evaluate nothing."""
        eventually(lambda: self.page.evaluate(condition), within_s=within_s)

    def text(self, name: str) -> str:
        """Return the text of an element by its id."""
        return self.page.locator(f"#{name}").inner_text()

    def place(self, pixel: tuple[float, float]) -> tuple[float, float]:
        """Return where on the screen a pixel of the camera's picture is."""
        box = self.page.locator("#overlay").bounding_box()
        assert box is not None
        scale = min(box["width"] / _PICTURE_PX[0], box["height"] / _PICTURE_PX[1])
        left = box["x"] + (box["width"] - _PICTURE_PX[0] * scale) / 2
        top = box["y"] + (box["height"] - _PICTURE_PX[1] * scale) / 2
        return left + pixel[0] * scale, top + pixel[1] * scale

    def count(self, canvas: str, condition: str) -> int:
        """Return how many pixels of a canvas fulfil a condition of JavaScript on ``r, g, b, a``, each in 0..255."""
        script = f"""canvas => {{
            const {{data}} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
            let found = 0;
            for (let i = 0; i < data.length; i += 4) {{
                const [r, g, b, a] = [data[i], data[i + 1], data[i + 2], data[i + 3]];
                if ({condition}) found++;
            }}
            return found;
        }}"""
        return int(self.page.locator(f"#{canvas}").evaluate(script))

    def says(self, name: str, words: str, *, within_s: float = 15.0) -> None:
        """Wait until the text of an element, by its id, contains the words."""
        self.wait(f"document.getElementById({name!r}).textContent.includes({words!r})", within_s=within_s)

    def hides(self, name: str) -> None:
        """Wait until an element, by its id, is not to be seen."""
        self.wait(f"document.getElementById({name!r}).getClientRects().length === 0")

    def swipe(self, x: float, y: float, *, down_px: float) -> None:
        """Put a finger on the screen, draw it down and lift it, as the hardware would tell it."""
        session = self.page.context.new_cdp_session(self.page)
        session.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
        for share in (0.2, 0.4, 0.6, 0.8, 1.0):
            at = {"x": x, "y": y + share * down_px}
            session.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [at]})
        session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


@contextmanager
def screen(browser: Browser, url: str, *, size: tuple[int, int] = DESKTOP, touch: bool = False) -> Iterator[Screen]:
    """Open the page in a fresh window of a size; on leaving, its console must not have said anything bad."""
    with browser.new_context(viewport={"width": size[0], "height": size[1]}, has_touch=touch) as context:
        opened = Screen(context.new_page(), url)
        yield opened
        assert opened.faults == [], opened.faults
