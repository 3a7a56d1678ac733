"""Makes studio-1440.png, studio-768.png and studio-390.png in the folder of this file: pictures of `t2m serve`."""

import shutil
import subprocess
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

SIZES = {1440: (900, "light"), 768: (1024, "dark"), 390: (844, "light")}
"""Width, then height and colors."""
CHAIN = ("a person walks forward", "a person waves with the left hand", "a person bows politely")
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def fill_studio(page: Page) -> None:
    """Makes a chain of three sentences and four samples of another one, and shows the chain or the samples."""
    page.get_by_role("textbox", name="Seed").fill("3")
    generate = page.get_by_role("button", name="Generate")
    for number, sentence in enumerate(CHAIN, start=1):
        if number > 1:
            page.locator("#add-sentence").click()
        page.locator("#sentences textarea").last.fill(sentence)
    generate.click()
    expect(page.locator(".take")).to_have_count(1, timeout=120_000)
    for number in (3, 2):
        page.get_by_role("button", name=f"Remove Sentence {number}").click()
    page.get_by_role("textbox", name="Sentence").fill("a person dances happily")
    page.get_by_role("combobox", name="Samples").select_option("4")
    generate.click()
    expect(page.locator(".take")).to_have_count(2, timeout=120_000)


def main() -> None:
    """Starts a server, and takes a picture for each width."""
    folder = Path(__file__).parent
    server = subprocess.Popen(
        [sys.executable, "-m", "t2m_jax", "serve", "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    address = server.stdout.readline().strip()
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        for width, (height, colors) in SIZES.items():
            size = {"width": width, "height": height}
            page = browser.new_page(viewport=size, color_scheme=colors, reduced_motion="reduce")
            page.goto(address)
            fill_studio(page)
            if width != 1440:
                page.locator(".take-open").nth(1).click()
            page.locator("#scrub").fill("36")
            page.wait_for_timeout(1500)
            path = folder / f"studio-{width}.png"
            page.screenshot(path=path)
            Image.open(path).convert("RGB").quantize(128).save(path, optimize=True)
        browser.close()
    server.terminate()


if __name__ == "__main__":
    main()
