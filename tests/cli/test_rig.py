"""Files whose joints are not recognized, with a table of the user."""

import numpy as np
import pytest

from t2m_jax.cli.main import main
from t2m_jax.errors import UserError
from t2m_jax.motion import Motion
from t2m_jax.motion.formats import load_motion
from tests.motion.figures import walking_positions
from tests.motion.rig.foreign import nameless, nameless_table  # noqa: F401 - fixtures


def test_view_takes_a_table(nameless, nameless_table, tmp_path, capsys):  # noqa: F811
    output = tmp_path / "walk.npz"
    assert main(["view", str(nameless), "-o", str(output)]) == 2
    assert "nameless.bvh: no known rig has its joints (q0, q1" in capsys.readouterr().err
    assert main(["view", str(nameless), "--rig", str(nameless_table), "-o", str(output)]) == 0
    assert np.abs(load_motion(output).positions - walking_positions(5)).max() < 0.05
    assert f"next: t2m view {output} -o motion.html" in capsys.readouterr().err


def test_view_refuses_what_no_file_has(nameless, nameless_table, tmp_path, capsys):  # noqa: F811
    walk, output = tmp_path / "walk.npz", tmp_path / "a.html"
    assert main(["view", str(nameless), "--rig", str(nameless_table), "-o", str(walk)]) == 0
    for name, value in (("rig", "mixamo"), ("animation", "Walk"), ("up", "z")):
        assert main(["view", str(walk), f"--{name}", value, "-o", str(output)]) == 2
        assert f"--{name}: .npz files have none; leave it out" in capsys.readouterr().err
        assert not output.exists()
        with pytest.raises(UserError, match=rf"{name}: .*walk\.npz has none, as all \.npz files"):
            load_motion(walk, **{name: value})
    # Of several files, those that can have it are read so.
    assert main(["view", str(walk), str(nameless), "--rig", str(nameless_table), "-o", str(output)]) == 0


def test_view_turns_a_figure_with_z_up(tmp_path):
    path = tmp_path / "walk.bvh"
    Motion(walking_positions(40), fps=20.0).save(path)
    assert main(["view", str(path), "--up", "z", "-o", str(tmp_path / "lying.npz")]) == 0
    assert np.ptp(load_motion(tmp_path / "lying.npz").positions[0, :, 1]) < 1 < np.ptp(walking_positions(40)[0, :, 1])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--up", "z"], "--up z: is for a file to go on from; add --from FILE"),
        (["--rig", "mixamo"], "--rig mixamo: is for a file to go on from; add --from FILE"),
        (["--from", "FILE", "--rig", "mixamo"], 'rig mixamo: the file has no joint "Hips" for pelvis'),
        (["--from", "FILE", "--rig", "none.yaml"], "none.yaml: no such config file"),
        (["--from", "FILE"], "no known rig has its joints (q0, q1"),
    ],
)
def test_generate_reads_the_file_to_go_on_from_with_a_table(nameless, capsys, arguments, says):  # noqa: F811
    given = [str(nameless) if one == "FILE" else one for one in arguments]
    assert main(["generate", "a person waves", *given]) == 2
    assert says in capsys.readouterr().err
