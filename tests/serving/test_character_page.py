"""The user's own character in the studio, in a browser: chosen, seen as it moves, and downloaded."""

import numpy as np
import pytest

from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.motion import Motion
from tests.export.test_viewer import browser  # noqa: F401 - a fixture
from tests.motion.character_files import read_parts
from tests.motion.figures import walking_positions
from tests.motion.glb_files import edited
from tests.serving.test_page import (
    WAVE,
    expect,
    generate,
    num_frames,
    open_studio,  # noqa: F401 - a fixture
    stage_picture,
)

pytestmark = pytest.mark.slow


@pytest.fixture
def hero(tmp_path):
    """Returns the file of a red figure of a tenth of the size, with an animation of its own."""

    def paint(tree):
        tree["animations"][0]["name"] = "own"
        tops = tree["scenes"][0]["nodes"]
        tree["nodes"].append({"name": "small", "scale": [0.1] * 3, "children": tops})
        tree["scenes"][0]["nodes"] = [len(tree["nodes"]) - 1]
        tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}} for _ in tree["materials"]]

    Motion(walking_positions(12), 20.0).save(tmp_path / "hero.glb")
    return edited(tmp_path / "hero.glb", paint).rename(tmp_path / "hero.vrm")


def red(page) -> np.ndarray:
    """Returns which pixels of the stage are red."""
    picture = stage_picture(page)
    return (picture[..., 0] > 90) & (picture[..., 1:].max(axis=-1) < 0.5 * picture[..., 0])


# Whether the browser keeps no character.
IS_FORGOTTEN = """() => new Promise((resolve) => {
  const opened = indexedDB.open("t2m-studio");
  opened.onsuccess = () => {
    const found = opened.result.transaction("takes").objectStore("takes").get("character");
    found.onsuccess = () => resolve(found.result === undefined);
  };
})"""


def test_a_character_is_chosen_moves_and_is_downloaded(open_studio, hero, tmp_path):  # noqa: F811
    page = open_studio()
    generate(page, WAVE)
    assert not red(page).any()
    page.locator("#character-input").set_input_files(hero)
    expect(page.locator("#character-name")).to_have_text("hero.vrm")
    expect(page.locator("#save-character")).to_be_enabled()
    before = red(page)
    page.get_by_role("slider", name="Frame", exact=True).fill("20")
    expect(page.locator("#clock")).to_contain_text("frame 20")
    after = red(page)
    assert min(before.sum(), after.sum()) > 500 and (before != after).mean() > 0.001
    with page.expect_download() as info:
        page.get_by_role("button", name="Download the character").click()
    info.value.save_as(tmp_path / "moved.glb")
    assert [one["name"] for one in read_parts(tmp_path / "moved.glb").tree["animations"]] == ["own", WAVE]
    assert load_motion(tmp_path / "moved.glb", animation=WAVE).num_frames == num_frames(page)
    assert not page.evaluate(IS_FORGOTTEN)
    page.reload()
    expect(page.locator("#character-name")).to_have_text("hero.vrm")
    expect(page.locator("#save-character")).to_be_enabled()
    assert red(page).sum() > 500
    page.get_by_role("button", name="Remove").click()
    expect(page.locator("#save-character")).to_be_hidden()
    assert not red(page).any()
    page.wait_for_function(IS_FORGOTTEN)


def without_mesh(tree):
    del tree["meshes"]
    for node in tree["nodes"]:
        node.pop("mesh", None)


def test_a_skeleton_without_a_mesh_is_only_downloaded(open_studio, hero):  # noqa: F811
    page = open_studio()
    generate(page, WAVE)
    before = stage_picture(page)
    page.locator("#character-input").set_input_files(edited(hero, without_mesh))
    expect(page.get_by_role("alert")).to_contain_text("hero.vrm: cannot be drawn here (it has no mesh)")
    expect(page.locator("#save-character")).to_be_enabled()
    assert (before != stage_picture(page)).mean() < 0.01


def test_a_file_that_is_no_character_is_refused_in_one_line(open_studio, hero, tmp_path):  # noqa: F811
    page = open_studio(may_fail=["400"])
    generate(page, WAVE)
    wheels = edited(
        hero.rename(tmp_path / "wheels.glb"),
        lambda tree: [node.update(name=f"wheel{number}") for number, node in enumerate(tree["nodes"])],
    )
    (tmp_path / "cube.glb").write_text("solid cube")
    (tmp_path / "cube.obj").write_text("solid cube")
    for path, message in (
        (tmp_path / "cube.glb", "cube.glb: is not a GLB file"),
        (tmp_path / "cube.obj", "cube.obj: is not a character; choose a .glb or .vrm file"),
        (wheels, "were not recognized; open it together with a table"),
    ):
        page.locator("#character-input").set_input_files(path)
        expect(page.get_by_role("alert")).to_contain_text(message)
        expect(page.locator("#save-character")).to_be_hidden()


def test_the_character_stays_if_another_one_is_refused(open_studio, hero, tmp_path):  # noqa: F811
    page = open_studio(may_fail=["400"])
    name, alert = page.locator("#character-name"), page.get_by_role("alert")
    (tmp_path / "junk.glb").write_text("solid cube")
    choose = page.locator("#character-input").set_input_files
    # Without a motion, no character is sent.
    choose(hero)
    expect(name).to_have_text("hero.vrm")
    choose(tmp_path / "junk.glb")
    expect(name).to_have_text("junk.glb")
    Motion(walking_positions(12), 20.0).save(tmp_path / "walk.npz")
    page.locator("#file-input").set_input_files(tmp_path / "walk.npz")
    for _ in range(2):
        expect(alert).to_contain_text("junk.glb: is not a GLB file")
        expect(name).to_have_text("hero.vrm")
        expect(page.locator("#save-character")).to_be_enabled()
        assert red(page).sum() > 500
        choose(tmp_path / "junk.glb")
    expect(alert).to_contain_text("junk.glb: is not a GLB file")
    expect(name).to_have_text("hero.vrm")
    page.reload()
    expect(page.locator("#save-character")).to_be_enabled()
    expect(name).to_have_text("hero.vrm")
    page.get_by_role("button", name="Remove").click()
    choose(tmp_path / "junk.glb")
    expect(alert).to_contain_text("junk.glb: is not a GLB file")
    expect(page.locator("#save-character")).to_be_hidden()
