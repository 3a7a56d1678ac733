"""Measures the script time of actions in the studio whose history has 200 motions with pictures.

    python docs/measure/studio.py

Needs `playwright` and a Chromium, which the variable CHROMIUM names if it is not found. Each motion has four samples
of a sentence, and all are copies of one. "script" is the processor time that the page's own code takes until the
browser is idle again, "page" also has styles, layout and drawing.
"""

import contextlib
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Callable

from playwright.sync_api import Page, sync_playwright

from t2m_jax.errors import UserError

MOTIONS = 200
TIMES = 5
"""How often each action is measured."""
WAIT = 120_000
"""Milliseconds."""
FILL = """async (count) => {
  const { Store } = await import("/assets/store.js");
  const store = await Store.open();
  const [entry] = await store.entries();
  const take = await store.take(entry.id);
  for (let number = 1; number < count; number += 1) {
    const copy = { id: `${entry.id}-${number}`, created: entry.created - number };
    await store.add({ ...entry, ...copy }, { ...take, ...copy });
  }
}"""
IDLE = "new Promise((done) => setTimeout(() => requestIdleCallback(done), 400))"


def fill(page: Page, address: str) -> None:
    """Generates one motion, and copies it in the storage of the browser."""
    page.goto(address)
    page.select_option("#num-samples", "4")
    page.fill("#sentences textarea", "a person walks forward")
    page.click("#generate")
    page.wait_for_selector(".take", timeout=WAIT)
    page.evaluate(FILL, MOTIONS)
    page.reload()
    page.locator(".take").nth(MOTIONS - 1).wait_for(timeout=WAIT)
    page.evaluate(IDLE)


def actions(page: Page) -> dict[str, Callable[[], object]]:
    """Returns what people do, by name."""

    def press(key: str) -> Callable[[], object]:
        return lambda: page.keyboard.press(key)

    def rename() -> None:
        page.keyboard.press("n")
        page.fill("#new-name", "another name")
        page.keyboard.press("Enter")

    rows, places = page.locator(".take-open"), iter(range(3, MOTIONS))
    return {
        "open a motion": lambda: rows.nth(next(places)).click(),
        "rename": rename,
        "undo": press("Control+z"),
        "redo": press("Control+y"),
        "duplicate": press("d"),
        "delete": press("Delete"),
        "compare": press("c"),
        "leave the comparison": lambda: rows.nth(next(places)).click(),
        "next frame": press("ArrowRight"),
        "another sample": press("2"),
        "mark a span": press("]"),
        "whole motion": press("\\"),
        "write in a sentence": lambda: page.type("#sentences textarea", "s"),
        "leave the sentence": lambda: page.locator("h1").click(),
        "show the keys": press("?"),
        "close the keys": press("Escape"),
    }


def measured(page: Page, read: Callable[[], dict[str, float]], act: Callable[[], object]) -> tuple[float, float]:
    """Returns the milliseconds of script, and of everything that the page does, of one action."""
    before = read()
    act()
    page.evaluate(IDLE)
    after = read()
    script, everything = (1000 * (after[name] - before[name]) for name in ("ScriptDuration", "TaskDuration"))
    return script, everything


def main() -> None:
    """Prints a table of all actions."""
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise UserError("no Chromium found; name one in the variable CHROMIUM")
    command = [sys.executable, "-m", "t2m_jax", "serve", "--port", "0"]
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(server.terminate)
        running = stack.enter_context(sync_playwright())
        browser = running.chromium.launch(executable_path=chromium, args=["--use-angle=swiftshader"])
        page = browser.new_context(reduced_motion="reduce", viewport={"width": 1440, "height": 900}).new_page()
        fill(page, server.stdout.readline().strip())
        profile = page.context.new_cdp_session(page)
        profile.send("Performance.enable", {"timeDomain": "threadTicks"})  # other programs do not count

        def read() -> dict[str, float]:
            return {entry["name"]: entry["value"] for entry in profile.send("Performance.getMetrics")["metrics"]}

        found: dict[str, list[tuple[float, float]]] = {}
        for _ in range(TIMES):
            for name, act in actions(page).items():
                found.setdefault(name, []).append(measured(page, read, act))
        browser.close()
    print("| action | script: median, longest (ms) | page: median, longest (ms) |\n| --- | ---: | ---: |")  # noqa: T201
    for name, times in found.items():
        columns = [f"{statistics.median(column):.0f}, {max(column):.0f}" for column in zip(*times, strict=True)]
        print(f"| {name} | {' | '.join(columns)} |")  # noqa: T201


if __name__ == "__main__":
    main()
