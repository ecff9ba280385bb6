# SPDX-License-Identifier: Apache-2.0
"""A real Chromium on the panel, for tests and benchmarks; `make panel-setup` installs what it needs."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

#: A page has so long to show what is waited for [s]; a busy machine takes seconds to draw one.
TIMEOUT_S: Final = 30.0
_POLL_S: Final = 0.05


#: The button that is there while the rig asks for a point.
POINT_ASKED: Final = "[data-name='rig-done']:not(.hidden)"


def _program(*names: str) -> str:
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        raise FileNotFoundError(f"expected one of {', '.join(names)} on the PATH, found none: type `make panel-setup`")
    return found


class PanelBrowser:
    """One browser with one person.

    Args:
        address: of the panel, such as "http://127.0.0.1:8480".
        size: of the window [px].
    """

    def __init__(self, address: str, size: tuple[int, int] = (1280, 800)) -> None:
        from selenium import webdriver  # noqa: PLC0415
        from selenium.webdriver.chrome.service import Service  # noqa: PLC0415

        self.address = address.rstrip("/")
        options = webdriver.ChromeOptions()
        options.binary_location = _program("chromium", "chromium-browser", "google-chrome")
        for argument in (
            "--headless=new",
            "--no-sandbox",
            "--disable-dev-shm-usage",
            "--disable-gpu",
            "--hide-scrollbars",
        ):
            options.add_argument(argument)
        # nothing of the browser's own may look like a request of a page
        options.add_argument("--disable-background-networking")
        options.add_argument("--disable-component-update")
        options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
        options.accept_insecure_certs = True
        self.driver = webdriver.Chrome(
            options=options, service=Service(_program("chromedriver", "chromium.chromedriver"))
        )
        self.driver.set_page_load_timeout(TIMEOUT_S)
        self.resize(*size)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the browser."""
        self.driver.quit()

    def resize(self, width: int, height: int) -> None:
        """Give the page another size [px]."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def log_in(self, name: str, password: str | None = None) -> None:
        """Log in and wait for what follows."""
        self.driver.delete_all_cookies()
        self.driver.get(f"{self.address}/login")
        self.find("#name").send_keys(name)
        if password is not None:
            self.find("#password").send_keys(password)
        self.find("form button").click()
        self.wait(lambda: self.count("#estop, .problem") > 0, "a page or a problem")

    def open(self, path: str) -> None:
        """Open a page and wait until it is there and its live data flows."""
        self.driver.get(self.address + path)
        self.wait(lambda: self.count("#estop") == 1, "the page")

    def find(self, css: str) -> Any:
        """Return the first element, waiting for it."""
        self.wait(lambda: self.count(css) > 0, css)
        return self.driver.find_element("css selector", css)

    def count(self, css: str) -> int:
        """Return how many elements there are."""
        return len(self.driver.find_elements("css selector", css))

    def text(self, css: str = "body") -> str:
        """Return the text that an element shows; empty where there is none."""
        return str(self.script("const e = document.querySelector(arguments[0]); return e ? e.innerText : '';", css))

    def press(self, name: str) -> None:
        """Press the button of a name, once it can be pressed and rests: one in a dialog that still grows is missed."""
        from selenium.common import exceptions  # noqa: PLC0415

        css = f"[data-name='{name}']"
        state = (
            "const e = document.querySelector(arguments[0]);"
            "if (!e || e.disabled || e.offsetParent === null) return null;"
            "e.scrollIntoView({block: 'center'});"
            "const r = e.getBoundingClientRect(); return [r.x, r.y, r.width, r.height];"
        )
        last: list[Any] = [None]

        def rests() -> bool:
            before, last[0] = last[0], self.script(state, css)
            return last[0] is not None and last[0] == before

        def pressed() -> bool:
            if not rests():
                return False
            try:
                self.driver.find_element("css selector", css).click()
            except (exceptions.ElementClickInterceptedException, exceptions.ElementNotInteractableException):
                return False  # it is being drawn, or a notice lies over it
            return True

        self.wait(pressed, f"button {name} that can be pressed")

    def script(self, code: str, *arguments: Any) -> Any:
        """Run JavaScript."""
        return self.driver.execute_script(code, *arguments)

    def wait(self, condition: Callable[[], bool], expected: str, timeout_s: float = TIMEOUT_S) -> None:
        """Wait until a condition holds.

        Raises:
            AssertionError: it does not in time; with what the page shows.
        """
        from selenium.common.exceptions import StaleElementReferenceException  # noqa: PLC0415

        deadline_s = time.monotonic() + timeout_s
        while True:
            try:
                if condition():
                    return
            except StaleElementReferenceException:
                pass  # the page has just been drawn again
            if time.monotonic() > deadline_s:
                raise AssertionError(
                    f"expected {expected} within {timeout_s:g} s, found:\n{self.text('.dialog')}\n{self.text()[:3000]}"
                )
            time.sleep(_POLL_S)

    def wait_for_text(self, css: str, part: str) -> None:
        """Wait until an element shows a text."""
        self.wait(lambda: part in self.text(css), f"{part!r} in {css}")

    def measure_friction(self, on_asked: Callable[[int], object] = lambda _: None) -> int:
        """Measure all points of the emulated rig by clicks and accept the model with a reason; return how many.

        Args:
            on_asked: called with the number of points so far, while the next is asked for.
        """
        self.open("/friction")
        self.press("rig-begin")

        def has_ended() -> bool:
            return "SUCCEEDED" in self.text("#rig-instruction")

        def seen() -> tuple[str, int]:
            return self.text("#rig-instruction"), self.count("#rig-points tbody tr")

        def measure_one() -> None:
            before = seen()
            self.press("rig-done")
            self.wait(lambda: seen() != before, "the point's T1 and T2")

        while not has_ended():
            self.wait(lambda: self.count(POINT_ASKED) > 0 or has_ended(), "the next point, or the end")
            on_asked(seen()[1])
            if not has_ended():
                measure_one()
        self.press("accept")
        self.find(".activate-reason input").send_keys("first of this cell")
        self.press("activate-confirm")
        self.wait_for_text("#friction-models", "active")
        return seen()[1]

    def requested(self) -> list[str]:
        """Return the URLs that pages have asked for since the last call, data and blob ones left out."""
        found = []
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            parameters = message.get("params", {})
            url = parameters.get("request", {}).get("url") or parameters.get("url", "")
            if message["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated"):
                found.append(str(url))
        return [url for url in found if not url.startswith(("data:", "blob:", "chrome:"))]

    def accessibility(self) -> list[str]:
        """Return axe-core's serious and critical findings of the page."""
        from axe_selenium_python import Axe  # noqa: PLC0415

        axe = Axe(self.driver)
        axe.inject()
        return [
            f"{one['id']}: {one['help']}: {node['html'][:200]}: {node.get('failureSummary', '')}"
            for one in axe.run()["violations"]
            if one["impact"] in {"serious", "critical"}
            for node in one["nodes"]
        ]

    def screenshot(self, path: Path) -> None:
        """Write what is seen as PNG."""
        self.driver.save_screenshot(str(path))
