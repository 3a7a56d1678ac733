"""Makes character.png in the folder of this file: a motion of the studio, and the same one on a character of a file.

    python docs/images/make_character.py quaternius_human-base.glb

The character of the picture is Quaternius' Universal Animation Library (CC0).
"""

import shutil
import subprocess
import sys
from pathlib import Path

from make_studio import ARGUMENTS
from PIL import Image
from playwright.sync_api import expect, sync_playwright

SENTENCE = "a person waves with the left hand"
FRAME = 44


def main(character: Path) -> None:
    """Starts a server, and takes a picture of the page before and after the character is chosen."""
    path = Path(__file__).with_name("character.png")
    server = subprocess.Popen(
        [sys.executable, "-m", "t2m_jax", "serve", "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    address = server.stdout.readline().strip()
    pictures = []
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1100, "height": 900}, reduced_motion="reduce")
        page.goto(address)
        page.get_by_role("textbox", name="Seed").fill("7")
        page.get_by_role("textbox", name="Sentence").fill(SENTENCE)
        page.get_by_role("button", name="Generate", exact=True).click()
        expect(page.locator(".take")).to_have_count(1, timeout=120_000)
        page.locator("#scrub").fill(f"{FRAME}")
        for chosen in (None, character):
            if chosen is not None:
                page.locator("#character-input").set_input_files(chosen)
                expect(page.get_by_text("The character is being moved")).to_be_visible(timeout=120_000)
                expect(page.locator("#save-character")).to_be_enabled(timeout=120_000)
            page.wait_for_timeout(2500)
            page.locator("#stage-frame").screenshot(path=path)
            pictures.append(Image.open(path).convert("RGB"))
        browser.close()
    server.terminate()
    width, height = pictures[0].size
    both = Image.new("RGB", (2 * width, height))
    for number, picture in enumerate(pictures):
        both.paste(picture, (number * width, 0))
    both.quantize(128).save(path, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
