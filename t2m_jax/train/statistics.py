"""The data set of a training, and the statistics that normalize its motion."""

import logging
from typing import Any

from t2m_jax.checkpoints.bundle import CONFIG_FILE, bundle_path
from t2m_jax.checkpoints.run import is_run
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.data.checks import check_feature_dim, find_difference
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.errors import UserError
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, normalizer_from_files, weighted_normalizer
from t2m_jax.train.config import FROM_DATA

logger = logging.getLogger(__name__)


def open_training_data(config: Any, *, reader: str, resume: bool) -> tuple[Dataset, Normalizer]:
    """Returns the data set of a config, and its statistics or those of the run that is resumed.

    Args:
        config: A config with the fields `data`, `run`, `statistics`, `root_weight` and `model.feature_dim`.
        reader: What is trained, for error messages.
        resume: Whether the run is resumed.

    Raises:
        UserError: The data set or the statistics cannot be read, or do not fit the model.
    """
    dataset = open_dataset(config.data)
    check_feature_dim(dataset, config.model.feature_dim, reader=reader)
    # A run has a copy, so that the file may be gone or changed.
    if resume:
        return dataset, load_normalizer(config.run)
    return dataset, load_statistics(config, dataset)


def load_statistics(config: Any, dataset: Dataset) -> Normalizer:
    """Returns the statistics that a config names (see `NormalizedConfig.statistics`).

    Raises:
        UserError: They do not exist, or describe motion of another kind than the data. With `init`, this is only a
            warning: some clips of a new kind do not have the statistics of a large data set.
    """
    statistics = config.statistics
    if statistics == FROM_DATA:
        return weighted_normalizer(dataset.normalizer, dataset.skeleton.layout, factor=config.root_weight)
    path = bundle_path(statistics)
    if is_run(path) or (path / CONFIG_FILE).is_file():
        normalizer = load_tokenizer(path).normalizer
    elif path.suffix == ".npy":
        # `mean.npy` and `std.npy`, or `Mean.npy` and `Std.npy` as in HumanML3D.
        std_name = path.name.replace("mean", "std").replace("Mean", "Std")
        normalizer = normalizer_from_files(path, path.with_name(std_name))
    # The original's folders of checkpoints; on a disk that ignores case, `Mean.npy` would be found as well.
    elif (path / "mean.npy").is_file() and not (path / "Mean.npy").is_file():
        normalizer = normalizer_from_files(path / "mean.npy", path / "std.npy")
    elif path.is_dir():
        normalizer = load_normalizer(path)
    else:
        raise UserError(f"statistics: {statistics} does not exist; give a folder with mean.npy, a model, or `data`")
    difference = find_difference(dataset, normalizer, reader=statistics)
    if difference is not None and config.init is None:
        raise UserError(f"{difference}; choose others, or `--statistics {FROM_DATA}`")
    if difference is not None:
        logger.warning("%s; this training starts from a model with them", difference)
    return normalizer
