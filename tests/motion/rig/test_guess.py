"""Tables for rigs that are not known by name."""

import pytest

from t2m_jax.cli.main import main
from t2m_jax.motion.bvh import load_bvh, save_bvh
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.rig.retarget import retarget
from t2m_jax.motion.rig.rigs import find_table
from tests.motion.figures import walking_positions

BIPED = {
    "Hips": "Bip01 Pelvis", "Spine": "Bip01 Spine", "Spine1": "Bip01 Spine1", "Spine2": "Bip01 Spine2",
    "Neck": "Bip01 Neck", "Head": "Bip01 Head",
} | {
    f"{side}{ours}": f"Bip01 {side[0]} {theirs}"
    for side in ("Left", "Right")
    for ours, theirs in {
        "UpLeg": "Thigh", "Leg": "Calf", "Foot": "Foot", "Toe": "Toe0", "Shoulder": "Clavicle", "Arm": "UpperArm",
        "ForeArm": "Forearm", "Hand": "Hand",
    }.items()
}  # fmt: skip


@pytest.fixture
def biped(tmp_path):
    """A BVH file with the names of 3ds Max's biped, which is no known rig."""
    path = tmp_path / "biped.bvh"
    save_bvh(path, Motion(positions=walking_positions(20), fps=20.0))
    lines = path.read_text().split("\n")
    for number, line in enumerate(lines):
        word, _, name = line.strip().partition(" ")
        if word in ("ROOT", "JOINT"):
            lines[number] = f"{word} {BIPED[name]}"
    path.write_text("\n".join(lines))
    return path


def test_an_unknown_rig_gets_a_table_that_works(biped, tmp_path, capsys):
    assert find_table(load_bvh(biped).joint_names) is None
    main(["data", "rig", str(biped)])
    printed = capsys.readouterr().out
    main(["data", "rig", str(biped), "-o", str(tmp_path / "rig.yaml")])
    assert (tmp_path / "rig.yaml").read_text() == printed
    assert "Left is left in 100% of the frames" in printed and printed.count("Bip01 Pelvis") == 1
    motion = retarget(load_bvh(biped), rig=str(tmp_path / "rig.yaml"))
    assert abs(motion.positions - walking_positions(20)).max() < 0.01


@pytest.mark.parametrize("mark", ["\\", '"', "'", ": #", "é"])
def test_names_of_joints_may_have_any_characters(biped, tmp_path, capsys, mark):
    biped.write_text(biped.read_text().replace("Bip01 ", f"Bip01{mark}"))
    main(["data", "rig", str(biped), "-o", str(tmp_path / "rig.yaml")])
    motion = retarget(load_bvh(biped), rig=str(tmp_path / "rig.yaml"))
    assert abs(motion.positions - walking_positions(20)).max() < 0.01


def test_exchanged_sides_are_said(biped, capsys):
    text = biped.read_text().replace(" L ", " X ").replace(" R ", " L ").replace(" X ", " R ")
    biped.write_text(text)
    main(["data", "rig", str(biped)])
    assert "LEFT AND RIGHT ARE EXCHANGED in 100% of the frames" in capsys.readouterr().out


def test_joints_that_nothing_resembles_are_marked(tmp_path, capsys):
    path = tmp_path / "chain.bvh"
    save_bvh(path, Motion(positions=walking_positions(3), fps=20.0))
    lines = path.read_text().split("\n")
    count = 0
    for number, line in enumerate(lines):
        word = line.strip().partition(" ")[0]
        if word in ("ROOT", "JOINT"):
            lines[number], count = f"{word} q{count}", count + 1
    path.write_text("\n".join(lines))
    main(["data", "rig", str(path)])
    printed = capsys.readouterr().out
    assert "# left_knee:  # NEEDED, none was recognized" in printed and "# spine2:  # may be missing" in printed
    assert "Left and right were not checked" in printed
