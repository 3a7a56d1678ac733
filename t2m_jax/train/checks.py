"""What is read and checked before a run starts or is resumed: data set, statistics, config, first weights."""

import contextlib
import logging
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from flax import traverse_util

from t2m_jax.checkpoints.averaging import FREE_FIELDS
from t2m_jax.checkpoints.bundle import BUNDLED, BundleConfig, bundle_path
from t2m_jax.checkpoints.bundle import CONFIG_FILE as BUNDLE_FILE
from t2m_jax.checkpoints.evaluator import EVALUATOR_CONFIG, PACKAGED, load_trained_evaluator
from t2m_jax.checkpoints.model import load_model
from t2m_jax.checkpoints.run import CONFIG_FILE, foreign_file, is_run, run_config_text, run_info
from t2m_jax.checkpoints.text_encoder import trained_network
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.config import flat_fields, load_config
from t2m_jax.data.checks import check_feature_dim, check_rate, find_difference
from t2m_jax.data.folder import Dataset, open_dataset
from t2m_jax.distributed import is_writer
from t2m_jax.errors import UserError
from t2m_jax.files.locks import lock
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, normalizer_from_files, weighted_normalizer
from t2m_jax.train.config import FROM_DATA, ExperimentConfig, InitParts

logger = logging.getLogger(__name__)

T = TypeVar("T")

MAY_CHANGE = (
    "run",
    "loop.num_steps",
    "loop.log_every",
    "loop.checkpoint_every",
    "loop.keep_checkpoints",
    "loop.steps_per_call",
    "sharding",
    "placement",
)
"""Fields and sections that a resumed run may change, because they do not affect what its updates compute."""


@contextlib.contextmanager
def claim_run(run: Path) -> Iterator[None]:
    """Holds the lock of a run, so that no other training writes into it. Of several processes, one holds it for all.

    Raises:
        UserError: Another training writes into it, or its folder cannot be written.
    """
    with contextlib.ExitStack() as held:
        # All processes of a training write into one run, through process 0.
        if is_writer():
            try:
                # The lock is beside the run, whose folder may not exist yet.
                run.absolute().parent.mkdir(parents=True, exist_ok=True)
                held.enter_context(lock(run))
            except OSError as error:
                raise UserError(f"{run}: cannot be written ({error.strerror or error})") from error
        yield


def check_new_run(run: Path) -> None:
    """Raises `UserError` if a folder cannot become a run."""
    if is_run(run):
        raise UserError(f"{run}: contains a run already; add --resume to continue it, or choose another --run")
    if name := foreign_file(run):  # it could be overwritten
        raise UserError(f"{run}: contains {name} and is no run; choose another --run, or empty the folder")
    if str(run) in BUNDLED:
        raise UserError(f"run: {run} is the name of a packaged model; choose another --run")


def read_run_config(run: Path, schema: type[T]) -> T:
    """Returns the config of a run.

    Raises:
        UserError: It has changed since the run wrote it, or does not fit the schema.
    """
    run_config_text(run)  # raises, for the values of a run decide what its checkpoints mean
    return load_config(run / CONFIG_FILE, schema)


def check_same_config(config: ExperimentConfig) -> None:
    """Raises `UserError` if a run was started with other values of fields that must not change."""
    saved = flat_fields(read_run_config(config.run, type(config)))
    for name, value in flat_fields(config).items():
        if not {name, name.partition(".")[0]} & set(MAY_CHANGE) and not _is_same(config, name, saved[name], value):
            raise UserError(
                f"{config.run}: was started with {name} {saved[name]}, not {value}; resume it with the same config "
                "(`--run RUN --resume` alone takes the config of the run)"
            )


def _is_same(config: Any, name: str, saved: Any, value: Any) -> bool:
    """Returns whether a field has its old value. What only moved is the same."""
    if saved == value:
        return True
    if name == "data":
        return run_info(config.run).data is not None  # its contents are compared by `check_same_data`
    if None in (saved, value):
        return False  # with a file or without is another training, and not a file that moved
    with contextlib.suppress(UserError):  # there is nothing
        # The run has a copy of its tokenizer, which says what the path meant when it was started.
        if name == "vqvae":
            return load_tokenizer(Path(value)).fingerprint == load_tokenizer(config.run).fingerprint
        if name == "init":
            return _fingerprint(saved) == _fingerprint(value)
        if name == "statistics":
            found = load_statistics(config, open_dataset(config.data))
            return all(map(np.array_equal, found, load_normalizer(config.run)))
    return name == "evaluation.evaluator"  # `BestWeights` compares the contents with those that chose the best weights


def _fingerprint(model: str) -> str:
    """Returns the fingerprint of a bundle, or of the run of a generator, a tokenizer or an evaluator."""
    path = bundle_path(model)
    if (path / EVALUATOR_CONFIG).is_file():
        return load_trained_evaluator(path).fingerprint
    return load_model(path).fingerprint if (path / BUNDLE_FILE).is_file() else load_tokenizer(path).fingerprint


def open_data(folder: Path, *, resume: bool) -> Dataset:
    """Returns the data set of a training.

    Raises:
        UserError: It cannot be read, or has another frame rate than its skeleton and is new.
    """
    dataset = open_dataset(folder)
    problems = [] if resume else check_rate(dataset.info, dataset.skeleton)
    if problems:
        raise UserError(f"{dataset.folder}/{problems[0]}")
    return dataset


def open_training_data(config: Any, *, reader: str, resume: bool) -> tuple[Dataset, Normalizer]:
    """Returns the data set of a config, and its statistics or those of the run that is resumed.

    Args:
        config: A config with the fields `data`, `run`, `statistics`, `root_weight` and `model.feature_dim`.
        reader: What is trained, for error messages.
        resume: Whether the run is resumed.

    Raises:
        UserError: The data set or the statistics cannot be read, or do not fit the model.
    """
    dataset = open_data(config.data, resume=resume)
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
    if statistics in PACKAGED or (path / EVALUATOR_CONFIG).is_file():
        normalizer = load_trained_evaluator(statistics).normalizer
    elif is_run(path) or (path / BUNDLE_FILE).is_file():
        normalizer = load_tokenizer(path).normalizer
    elif path.suffix == ".npy":
        # `mean.npy` and `std.npy`, or `Mean.npy` and `Std.npy` as in HumanML3D.
        std_name = path.name.replace("mean", "std").replace("Mean", "Std")
        if std_name == path.name:
            raise UserError(f"statistics: {path} has no `mean` in its name; give mean.npy, with std.npy beside it")
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


def data_record(dataset: Dataset, draws: str) -> str:
    """Returns what a run keeps of its data: the fingerprint of each part, and `draws` (see `Setup`)."""
    return "; ".join(f"{name} {digest}" for name, digest in _data_parts(dataset, draws).items())


def _data_parts(dataset: Dataset, draws: str) -> dict[str, str]:
    return dataset.fingerprints | ({"labels that decide draws": draws} if draws else {})


def check_same_data(config: ExperimentConfig, dataset: Dataset, draws: str) -> None:
    """Raises `UserError` if a run was started with other clips, captions, splits, statistics or draws."""
    known = run_info(config.run).data
    if known is None or known in (dataset.fingerprint, data_record(dataset, ""), data_record(dataset, draws)):
        return
    # Only what changed is named: captions that were corrected are another matter than other clips.
    parts = dict(part.rpartition(" ")[::2] for part in known.split("; "))
    changed = [name for name, digest in _data_parts(dataset, draws).items() if parts.get(name) != digest]
    raise UserError(
        f"data: {dataset.folder} is not what {config.run} was started with (changed: {', '.join(changed)}); resume "
        f"with the old data, or start a new run with `--init {config.run}`"
    )


def fitting_weights(source: Path, weights: Mapping[str, Any], like: Mapping[str, Any]) -> dict[str, Any]:
    """Returns `like` with those of `weights` that have the names and shapes of its arrays.

    Raises:
        UserError: There are none.
    """
    given = traverse_util.flatten_dict(dict(weights), sep="/")
    merged = traverse_util.flatten_dict(dict(like), sep="/", keep_empty_nodes=True)
    fitting = {name: given[name] for name in merged.keys() & given.keys() if given[name].shape == merged[name].shape}
    # Codes, sums, counts and the flag belong together: half of them is a codebook of zeros that counts as initialized.
    codebook = {name for name in merged if name.startswith("codebook/")}
    if not codebook <= fitting.keys():
        fitting = {name: array for name, array in fitting.items() if name not in codebook}
    if not fitting:
        raise UserError(f"init: no array of {source} has a name and a shape of this config")
    logger.info("%d of %d arrays start from %s, the others at random", len(fitting), len(merged), source)
    return traverse_util.unflatten_dict(merged | fitting, sep="/")


def warn_of_schedule(config: Any) -> None:
    """Says so if the last updates of a training would change nothing, as those after a decay of the learning rate."""
    cosine = config.optimizer.cosine
    if cosine is not None and config.loop.num_steps > cosine[1]:
        logger.warning(
            "optimizer.cosine: the learning rate is 0 from update %d on, but loop.num_steps is %d; to train on, "
            "start a new run with `--init`",
            cosine[1],
            config.loop.num_steps,
        )


def check_same_function(source: str, given: Any, config: Any, fields: Iterable[str]) -> None:
    """Raises `UserError` if the weights of a part would compute something else with another config.

    Args:
        source: The part that training starts from, for the message.
        given: Its config.
        config: That of the run's part.
        fields: Names of fields that no array shows by its shape; those that neither config has do not count.
    """
    for name in fields:
        own, wanted = getattr(given, name, None), getattr(config, name, None)
        if own != wanted:
            raise UserError(f"init: {source} has {name} {own!r}, not {wanted!r} as in the config")


def check_same_model(path: Path, given: BundleConfig, config: BundleConfig, *, parts: InitParts, stays: bool) -> None:
    """Raises `UserError` if the generator or the text network of a model would compute something else with a config.

    Args:
        path: Of the model, for the message.
        given: Its config.
        config: That of the run.
        parts: Which of its weights the run starts from.
        stays: Whether the generator is not trained, so that all of it must be the same.
    """
    fields = ("num_heads", "cumulative_depth")
    if parts == "all":
        networks = [trained_network(one.text_encoder) for one in (given, config)]
        check_same_function(f"the text network of {path}", networks[0], networks[1], fields)
    if parts == "all" or stays:
        own = sorted(flat_fields(config.generator).keys() - set(FREE_FIELDS)) if stays else fields
        check_same_function(f"the generator of {path}", given.generator, config.generator, own)


def checked_weights(source: Path, weights: Mapping[str, Any], like: Mapping[str, Any]) -> dict[str, Any]:
    """Returns weights to start from.

    Raises:
        UserError: Their names or shapes are not those of `like`.
    """
    found = traverse_util.flatten_dict(dict(weights), sep="/")
    wanted = traverse_util.flatten_dict(dict(like), sep="/")
    for name in sorted(found.keys() | wanted.keys()):
        shapes = [tree[name].shape if name in tree else "missing" for tree in (found, wanted)]
        if shapes[0] != shapes[1]:
            raise UserError(f"init: array {name!r} of {source} is {shapes[0]}, not {shapes[1]} as in the config")
    # Bundles have 16-bit weights. Training goes on in the precision of the state.
    return jax.tree.map(lambda leaf, other: jax.numpy.asarray(leaf, other.dtype), dict(weights), dict(like))
