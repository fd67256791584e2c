"""Screenshots of the web page during the simulated flight `faults`: `python docs/images/draw_page.py`.

Needs Debian's Chromium and the extras `test` and `web`; takes a minute, since the flight is watched in real time.
"""

import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import Error, Page, sync_playwright

HERE = Path(__file__).parent
PORT = 18642
SHOTS = {"desktop": (1280, 900, "light"), "phone": (390, 844, "dark")}
"""Name: width and height of the window, and what the browser prefers."""
FLOWN_S = 57.0
"""Time of the flight at which it is taken [s]: one sensor does not answer, and three have had faults by then."""


def opened(page: Page) -> None:
    """Open the page as soon as it is served."""
    for _ in range(100):
        try:
            page.goto(f"http://127.0.0.1:{PORT}/")
            return
        except Error:
            page.wait_for_timeout(200)
    raise SystemExit("the page was not served within 20 s")


def main() -> None:
    """Take all screenshots during one flight."""
    program = shutil.which("chromium")
    if program is None:
        raise SystemExit("Chromium is not installed: apt install chromium")
    msp_sim = Path(sys.executable).with_name("msp-sim")
    with subprocess.Popen([msp_sim, "fly", "faults", "--web", str(PORT)], stdout=subprocess.DEVNULL) as flight:
        with sync_playwright() as playwright:
            chromium = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
            pages = {}
            for name, (width, height, scheme) in SHOTS.items():
                options = {"viewport": {"width": width, "height": height}, "color_scheme": scheme}
                pages[name] = chromium.new_context(**options).new_page()
                opened(pages[name])
            for name, page in pages.items():
                while page.evaluate("window.drawn.timeS") < FLOWN_S:
                    page.wait_for_timeout(100)
                page.screenshot(path=HERE / f"page_{name}.png", full_page=name == "desktop")
            chromium.close()
        flight.terminate()


if __name__ == "__main__":
    main()
