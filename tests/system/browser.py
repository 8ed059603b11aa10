"""Debian's chromium, without a screen, driven by selenium; and what it shows."""

import base64
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.remote.webdriver import WebDriver

DESKTOP = (1400, 950, 1)
PHONE = (390, 844, 2)
"""Width and height in CSS pixels, device pixels to each."""
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
SHOTS_VARIABLE = "SKYFIX_SCREENSHOTS"
"""Names a folder that gets the pictures, to be looked at."""
PATIENCE_S = 400.0
"""The map is drawn at low priority: on a busy machine that takes minutes."""


class Page:
    """The daemon's page in a window of some size."""

    def __init__(self, driver: WebDriver) -> None:
        self.driver = driver

    def open(self, url: str) -> None:
        self.driver.get(url)

    def resize(self, size: tuple[int, int, int]) -> None:
        """As a device of that size shows it."""
        width, height, ratio = size
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": ratio > 1},
        )

    def text(self, element_id: str) -> str:
        return str(
            self.driver.execute_script("return document.getElementById(arguments[0]).innerText", element_id)
        )

    def does(self, script: str) -> object:
        """What a line of JavaScript returns."""
        return self.driver.execute_script(f"return {script}")

    def until(self, met: Callable[[], object], what: str) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not met():
            assert time.monotonic() < deadline_s, f"never {what}: {self.text('answer')} {self.text('log')}"
            time.sleep(0.1)

    def until_says(self, element_id: str, words: str) -> None:
        self.until(lambda: words in self.text(element_id), f"{words!r} in #{element_id}")

    def shoot(self, name: str, folder: Path) -> None:
        """The whole page as a picture."""
        folder = Path(os.environ.get(SHOTS_VARIABLE) or folder)
        folder.mkdir(parents=True, exist_ok=True)
        width, height = self.does("[innerWidth, document.documentElement.scrollHeight]")  # type: ignore[misc]
        shot = self.driver.execute_cdp_cmd(
            "Page.captureScreenshot",
            {
                "captureBeyondViewport": True,
                "clip": {"x": 0, "y": 0, "width": width, "height": height, "scale": 1},
            },
        )
        (folder / f"{name}.png").write_bytes(base64.b64decode(shot["data"]))

    def complaints(self) -> list[str]:
        """What the browser found wrong: scripts that failed, what the policy forbade, files that were not there."""
        return [entry["message"] for entry in self.driver.get_log("browser")]


@contextmanager
def browser(chromium: Path, chromedriver: Path, profile: Path, size: tuple[int, int, int]) -> Iterator[Page]:
    """A window of that size, with nothing in its memory."""
    width, height, _ = size
    options = webdriver.ChromeOptions()
    options.binary_location = str(chromium)
    for flag in (*FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(chromedriver)))
    try:
        page = Page(driver)
        page.resize(size)
        yield page
    finally:
        driver.quit()
