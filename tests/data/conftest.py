import pytest

from t2m_jax.data.importers.synthetic import write_synthetic_dataset


@pytest.fixture(scope="session")
def synthetic_folder(tmp_path_factory):
    """A small data set; tests that change it copy it first."""
    folder = tmp_path_factory.mktemp("synthetic") / "data"
    write_synthetic_dataset(folder, num_clips=20, seed=3)
    return folder
