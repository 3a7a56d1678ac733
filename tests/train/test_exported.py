"""Models that were trained here leave Python: onnxruntime makes their motions, and their page has the same graphs."""

import json

import pytest

from t2m_jax.cli.main import main
from t2m_jax.sampling import TextToMotion
from t2m_jax.train import train
from tests.export.test_onnx import parity  # noqa: F401 - a fixture
from tests.tiny import CAPTIONS, hifigpt_training, rvqvae_training


@pytest.fixture(scope="module")
def hifigpt(data, tmp_path_factory):
    """A run of T2M-HiFiGPT."""
    folder = tmp_path_factory.mktemp("hifigpt")
    train(rvqvae_training(data, folder / "rvqvae"))
    train(hifigpt_training(data, folder / "rvqvae", folder / "hifigpt"))
    return folder / "hifigpt"


def check_export(run, folder, parity):  # noqa: F811 - the fixture
    """Compares the motions of a run with those of its graphs, and these with the graphs of its page."""
    for kind in ("onnx", "page"):
        assert main(["export", kind, f"{run}", f"{folder / kind}"]) == 0
    model, graphs = TextToMotion.load(run), parity.OnnxModel(folder / "onnx")
    for greedy in (True, False):
        found = parity.compare(model, graphs, [*CAPTIONS], greedy=greedy)
        assert found["rows"] > 5 and found["other_rows"] == 0
        assert 0 < found["largest_mm"] < 1 and 0 < found["largest_cleaned_mm"] < 1
    manifests = [json.loads((folder / path / "manifest.json").read_text()) for path in ("onnx", "page/model")]
    ours, of_page = ({name: file["sha256"] for name, file in one["files"].items()} for one in manifests)
    # `lock`, which has no weights, is for longer motions in the page.
    same = {name for name in ours if name != "lock.onnx"}
    assert {name: of_page[name] for name in same} == {name: ours[name] for name in same}
    assert "place.onnx" in of_page


@pytest.mark.release
def test_a_run_of_t2m_gpt_is_exported(runs, tmp_path, parity):  # noqa: F811 - the fixture
    check_export(runs.gpt, tmp_path, parity)


@pytest.mark.slow
@pytest.mark.release
def test_a_run_of_hifigpt_is_exported(hifigpt, tmp_path, parity):  # noqa: F811 - the fixture
    check_export(hifigpt, tmp_path, parity)
