"""Every config in `configs/` loads, and its header names the command that uses it."""

import pytest

from t2m_jax.config import load_config
from t2m_jax.train.config import TrainGptConfig, TrainVqVaeConfig
from tests.conftest import REPOSITORY

SCHEMAS = {"vqvae": TrainVqVaeConfig, "gpt": TrainGptConfig}
CONFIGS = sorted((REPOSITORY / "configs").rglob("*.yaml"))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_config_loads(path):
    config = load_config(path, SCHEMAS[path.stem])
    assert config.run.is_relative_to("runs")
    header = path.read_text().partition("\ndata:")[0]
    assert f"t2m train {path.stem} {path.relative_to(REPOSITORY)}" in header


@pytest.mark.parametrize("folder", sorted({path.parent for path in CONFIGS}), ids=lambda path: path.name)
def test_the_stages_of_a_folder_fit(folder):
    vqvae, gpt = (load_config(folder / f"{stage}.yaml", schema) for stage, schema in SCHEMAS.items())
    assert gpt.vqvae == vqvae.run
    assert gpt.data == vqvae.data
    assert gpt.model.num_codes == vqvae.model.num_codes
    assert gpt.model.text_dim == gpt.caption_encoder.text_dim


def test_the_defaults_are_the_published_models():
    """Sizes of T2M-GPT on HumanML3D: the counts of its paper's code, less the unused position table."""
    import jax

    from t2m_jax.checkpoints.bundle import BundleConfig, expected_variables

    vqvae, gpt = TrainVqVaeConfig().model, TrainGptConfig()
    shapes = expected_variables(BundleConfig(vqvae=vqvae, gpt=gpt.model, caption_encoder=gpt.caption_encoder))
    counts = {name: sum(leaf.size for leaf in jax.tree.leaves(shapes[name]["params"])) for name in shapes}
    assert counts["vqvae"] == 19_436_807
    assert counts["gpt"] == 228_311_040
