"""The option --character: motions on a figure of the user, and what is refused."""

import pytest

from t2m_jax import Motion
from t2m_jax.cli.main import main
from tests.motion.character_files import read_parts, table_text, write_character
from tests.motion.figures import walking_positions
from tests.motion.glb_files import edited
from tests.motion.rig.test_retarget import BANDAI


@pytest.fixture
def hero(tmp_path):
    return write_character(tmp_path / "hero.glb", BANDAI)


@pytest.fixture
def walk(tmp_path):
    Motion(walking_positions(12), 20.0, caption="a person walks").save(tmp_path / "walk.npz")
    return tmp_path / "walk.npz"


def animations(path):
    return [animation["name"] for animation in read_parts(path).tree["animations"]]


def test_view_writes_a_copy_that_moves_and_other_formats_as_before(hero, walk, tmp_path, capsys):
    outputs = [tmp_path / "hero-walk.glb", tmp_path / "walk.bvh"]
    options = [part for output in outputs for part in ("-o", f"{output}")]
    assert main(["view", f"{walk}", "--character", f"{hero}", *options, "--names", "vrm"]) == 0
    assert animations(outputs[0]) == ["nod", "a person walks"]
    assert "ROOT hips" in outputs[1].read_text()
    assert capsys.readouterr().out == f"{outputs[0]}\n{outputs[1]}\n"


def test_the_table_is_the_one_of_the_character(hero, walk, tmp_path, refusal, capsys):
    edited(hero, lambda tree: [node.update(name=node["name"].replace("Leg", "Pole")) for node in tree["nodes"]])
    view = ["view", f"{walk}", "--character", f"{hero}", "-o", f"{tmp_path / 'a.glb'}"]
    said = refusal(*view)
    assert "left_hip, right_hip, left_knee, right_knee" in said and "`t2m data rig FILE`" in said
    table = tmp_path / "hero.yaml"
    table.write_text(table_text(lambda bone: bone.replace("Leg", "Pole")))
    assert main([*view, "--rig", f"{table}"]) == 0
    # It is not the table of the motion, so it is not in the next command.
    assert "--rig" not in capsys.readouterr().err


def test_a_table_is_written_for_a_character_without_an_animation(hero, capsys):
    edited(hero, lambda tree: tree.pop("animations"))
    assert main(["data", "rig", f"{hero}"]) == 0
    assert 'left_knee: "LowerLeg_L"' in capsys.readouterr().out


def test_what_does_not_fit_a_character_is_refused_before_the_motion_is_read(hero, tmp_path, refusal, bundle_folder):
    glb, page = tmp_path / "a.glb", tmp_path / "a.html"
    for start in (["view", tmp_path / "no.npz"], ["generate", "a person walks", "--model", bundle_folder]):
        command = [*start, "--character", hero]
        assert "is for .glb files, and none is written; add -o FILE.glb" in refusal(*command, "-o", page)
        said = refusal(*command, "-o", glb, "--units", "cm")
        assert "--units: is for .bvh and .glb files, and none is written" in said
        assert "(a character keeps its own)" in said
        assert "is the character's own file" in refusal(*command, "-o", hero)
        assert "no.glb: there is no such file" in refusal(*start, "--character", tmp_path / "no.glb", "-o", glb)
    assert animations(hero) == ["nod"] and not glb.exists()


@pytest.mark.slow
def test_generate_writes_the_character(hero, tmp_path, bundle_folder, capsys):
    output = tmp_path / "moved.glb"
    command = ["generate", "a person walks", "--model", f"{bundle_folder}", "--character", f"{hero}"]
    assert main([*command, "-o", f"{output}"]) == 0
    assert animations(output) == ["nod", "a person walks"]
    # The file has two animations, so `t2m view` could not know which one.
    assert f"next: open {output}" in capsys.readouterr().err
