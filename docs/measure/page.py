"""Measures the page of `t2m export page` in Chromium: seconds to the first and the next motions, memory and download.

    python docs/measure/page.py FOLDER

Needs `playwright` and a Chromium, which the variable CHROMIUM names if it is not found. "ready" is from the start of
the load until a motion can be made: first with the download from this machine, then from the browser's storage.
"""

import functools
import http.server
import os
import shutil
import sys
import threading
import time
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from t2m_jax.errors import UserError

SENTENCES = ("a person waves with the left hand", "a person walks forward", "somebody jogs and turns right")
WAIT = 300_000
"""Milliseconds."""


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Serves files as `python -m http.server` does, but writes nothing."""

    def log_message(self, *_: object) -> None:
        """Writes nothing."""


def seconds_to_ready(page: Page, address: str) -> float:
    """Loads the page, and returns how long it takes until a motion can be made."""
    begun = time.perf_counter()
    page.goto(address)
    page.wait_for_selector("#generate:enabled", timeout=WAIT)
    return time.perf_counter() - begun


def seconds_to_motion(page: Page, sentence: str, seed: int) -> float:
    """Makes a motion, and returns how long it takes until it is shown."""
    page.fill("#sentence", sentence)
    page.fill("#seed", str(seed))
    begun = time.perf_counter()
    page.click("#generate")
    page.wait_for_selector(f"#take-facts:has-text('seed\u00a0{seed}')", timeout=WAIT)
    return time.perf_counter() - begun


def main() -> None:
    """Prints the figures of a folder."""
    folder = Path(sys.argv[1])
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise UserError("no Chromium found; name one in the variable CHROMIUM")
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(QuietHandler, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}/"
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=["--use-angle=swiftshader"])
        page = browser.new_context(reduced_motion="reduce").new_page()
        lines = [f"{size / 1e6:.1f} MB in all", f"first visit: ready after {seconds_to_ready(page, address):.1f} s"]
        page.goto("about:blank")
        lines.append(f"next visit: ready after {seconds_to_ready(page, address):.1f} s")
        times = [seconds_to_motion(page, SENTENCES[seed % len(SENTENCES)], seed) for seed in range(10)]
        memory = page.evaluate("performance.measureUserAgentSpecificMemory().then(({ bytes }) => bytes)")
        threads = page.evaluate("navigator.hardwareConcurrency")
        browser.close()
    server.shutdown()
    next_times = ", ".join(f"{spent:.1f}" for spent in times[1:])
    lines += [
        f"first motion: {times[0]:.1f} s; next: {next_times}",
        f"{memory / 1e6:.0f} MB of memory, {threads} cores",
    ]
    print("\n".join(lines))  # noqa: T201


if __name__ == "__main__":
    main()
