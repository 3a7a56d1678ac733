"""A bundle: one folder that contains a complete text-to-motion model and can be shared."""

import contextlib
import dataclasses
import functools
import importlib.resources
import re
import reprlib
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
from flax import traverse_util
from tokenizers import Tokenizer

from t2m_jax.checkpoints.derived import add_derived, drop_derived
from t2m_jax.checkpoints.pretrained import check_vocabulary
from t2m_jax.checkpoints.run import DATA_FILE, run_config_text
from t2m_jax.checkpoints.text_encoder import (
    PretrainedEncoder,
    find_text_encoder_config,
    pretrained_reference,
    save_pretrained,
    trained_network,
    with_encoder_name,
)
from t2m_jax.config import Tagged, load_versioned, save_config
from t2m_jax.errors import UserError
from t2m_jax.files.arrays import fingerprint, fit_arrays, read_arrays, save_arrays
from t2m_jax.files.manifest import check_folder, has_manifest, write_manifest
from t2m_jax.files.reading import load_json, load_text
from t2m_jax.files.writing import atomic_folder, save_json, save_text
from t2m_jax.keys import new_key
from t2m_jax.models.caption_encoder import CaptionEncoderConfig, init_network
from t2m_jax.models.system import find_part, variable_shapes
from t2m_jax.motion.normalizer import Normalizer, load_normalizer, save_normalizer
from t2m_jax.motion.skeleton import skeleton_from_name
from t2m_jax.text.bpe import TOKENIZER_FILE, load_bpe, save_bpe
from t2m_jax.yaml_file import MAX_FILE_BYTES, parse_yaml

CONFIG_FILE = "bundle.yaml"
WEIGHTS_FILE = "weights.safetensors"
CARD_FILE = "README.md"
NO_LICENSE = "unknown"
"""The license of a model whose card does not have one. It cannot be shared on the hub."""
FORMAT_VERSION = 3
"""Version of bundles: they have a manifest."""
NUM_EXAMPLES = 5
"""Captions of the training data that are examples of a model whose card has none."""
BUNDLED = ("demo", "demo-free", "demo-t2m-gpt")
"""Names of the bundles that are part of the package."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BundleConfig:
    """The parts of a model; the `kind` of each section names its type."""

    format_version: int = FORMAT_VERSION
    """Layout of the folder."""
    skeleton: str = "humanml3d"
    """Name of the skeleton of the motion."""
    tokenizer: Annotated[Any, Tagged(lambda kind: find_part(kind, "tokenizer").config)]
    """Sizes of the tokenizer."""
    generator: Annotated[Any, Tagged(lambda kind: find_part(kind, "generator").config)]
    """Sizes of the generator."""
    text_encoder: Annotated[Any, Tagged(find_text_encoder_config)] = CaptionEncoderConfig()
    """Sizes of the network that is trained with the generator, and the name of a pretrained encoder; one or both."""

    def __post_init__(self) -> None:
        fits = [
            ("tokenizer.feature_dim", self.tokenizer.feature_dim, skeleton_from_name(self.skeleton).feature_dim),
            ("generator.num_codes", self.generator.num_codes, self.tokenizer.num_codes),
            ("generator.num_quantizers", self.generator.num_quantizers, self.tokenizer.num_quantizers),
        ]
        if (network := trained_network(self.text_encoder)) is not None:
            fits.append(("generator.text_dim", self.generator.text_dim, network.text_dim))
        for name, found, wanted in fits:
            if found != wanted:
                raise ValueError(f"{name} is {found}, but the other parts need {wanted}")


class Bundle(NamedTuple):
    """A complete text-to-motion model."""

    config: BundleConfig
    variables: dict[str, Any]
    """The collections of `tokenizer`, `generator` and, if a part of it was trained, `text_encoder`."""
    normalizer: Normalizer
    bpe: Tokenizer | None
    """Subwords of the caption encoder; None if the model has none."""
    training_data: dict[str, Any] | None = None
    """What the model was trained on: words, actions and their numbers of clips; None if it is not recorded."""
    card: str = ""
    """Markdown that describes the model, of its README.md."""
    source: str = ""
    """Where it was loaded from: a name, a path, or a name on the hub with its commit."""

    @property
    def license(self) -> str:
        """The license of the weights (see `card_license`)."""
        return card_license(self.card)

    @property
    def examples(self) -> tuple[str, ...]:
        """Sentences to try: those of the card (see `card_examples`), else some captions of the training data."""
        captions = tuple((self.training_data or {}).get("captions", ()))
        return card_examples(self.card) or captions[:NUM_EXAMPLES]

    @property
    def min_codes(self) -> int:
        """Rows of the shortest motion, if the model decides its length."""
        # No fragments: nearly all motions that the model learned are as long.
        shortest = (self.training_data or {}).get("shortest_frames", 0)
        return max(shortest // self.config.tokenizer.downsample, 1)

    @property
    def fingerprint(self) -> str:
        """Identifies the model: a digest of sizes, weights, statistics and subwords."""
        words = "" if self.bpe is None else self.bpe.to_str()
        return fingerprint(f"{self.config!r}{words}", jax.device_get(self.variables), self.normalizer._asdict())


def bundle_path(name_or_path: str | Path) -> Path:
    """Returns the folder of a bundled name, or the path itself."""
    if str(name_or_path) in BUNDLED:
        return Path(str(importlib.resources.files("t2m_jax") / "bundles" / str(name_or_path)))
    return Path(name_or_path)


def card_license(card: str) -> str:
    """Returns the license in the metadata of a card, as on the Hugging Face hub; `NO_LICENSE` if it has none."""
    found = _card_metadata(card).get("license")
    name = found.strip() if isinstance(found, str) else ""
    return name if name and name.isprintable() else NO_LICENSE


def card_examples(card: str) -> tuple[str, ...]:
    """Returns the sentences under `widget` in the metadata of a card, as on the Hugging Face hub."""
    items = _card_metadata(card).get("widget")
    texts = [item.get("text") for item in items if isinstance(item, dict)] if isinstance(items, list) else []
    return tuple(text for text in texts if isinstance(text, str))


def _card_metadata(card: str) -> dict[Any, Any]:
    """Returns the YAML between the first two lines `---` of a card; of YAML that cannot be read, only the license."""
    found = re.match(r"---\n(.*?)\n---(?:\n|$)", card[:MAX_FILE_BYTES], flags=re.DOTALL)
    text = found[1] if found else ""
    # A card may come from the hub. Whatever is wrong with it, the model can be used.
    with contextlib.suppress(UserError):
        return parse_yaml(text, source=CARD_FILE).data
    licenses = re.findall(r"^license: *[\"']?([\w.+-]+)", text, flags=re.MULTILINE)
    return {"license": licenses[0]} if len(licenses) == 1 else {}


def load_bundle_config(folder: Path) -> BundleConfig:
    """Returns the config of a bundle or of a generator's run.

    Raises:
        UserError: The file is missing, damaged or of an unknown version, or the parts do not fit each other.
    """
    return load_versioned(folder / CONFIG_FILE, BundleConfig, version=FORMAT_VERSION)


def part_kinds(config: BundleConfig) -> dict[str, str]:
    """Returns the kind of each part that has weights, by role; files name the weights of a part by its kind."""
    kinds = {"tokenizer": config.tokenizer.kind, "generator": config.generator.kind}
    if (network := trained_network(config.text_encoder)) is not None:
        kinds["text_encoder"] = network.kind
    return kinds


@functools.lru_cache
def expected_variables(config: BundleConfig) -> dict[str, Any]:
    """Returns the shapes of all variables of a model by role; they are shared, so nobody may change them."""
    # Shapes only: a hostile config may ask for more memory than there is, before its weights are seen not to fit.
    shapes = {"tokenizer": variable_shapes(config.tokenizer), "generator": variable_shapes(config.generator)}
    if (network := trained_network(config.text_encoder)) is not None:
        shapes["text_encoder"] = jax.eval_shape(lambda: init_network(network, new_key(0)))
    return shapes


def load_bundle(path: str | Path) -> Bundle:
    """Returns the model of a bundle folder.

    Raises:
        UserError: A file is missing or damaged, or the parts do not fit each other.
    """
    path = Path(path)
    if not path.is_dir():
        known = ", ".join(BUNDLED)
        raise UserError(f"{path}: no such model; give a bundle folder, a run folder, or a bundled name ({known})")
    if not has_manifest(path):
        load_bundle_config(path)  # says so if it is of an older version, which had no manifest
    check_folder(path)
    config = load_bundle_config(path)
    kinds = part_kinds(config)
    shapes = {kinds[role]: shapes for role, shapes in expected_variables(config).items()}
    flat = traverse_util.flatten_dict(shapes, sep="/")
    leaves = {name: (leaf.shape, leaf.dtype) for name, leaf in flat.items()}
    found = add_derived(read_arrays(path / WEIGHTS_FILE), leaves.keys())
    arrays = traverse_util.unflatten_dict(fit_arrays(path / WEIGHTS_FILE, found, leaves), sep="/")
    normalizer = load_normalizer(path)
    check_statistics_width(path, normalizer, config.tokenizer.feature_dim)
    # The copy in the bundle comes first, so that the model needs no network and no hub name that still exists.
    reference = pretrained_reference(config.text_encoder)
    if reference is not None and (included := path / reference.kind).is_dir():
        config = dataclasses.replace(config, text_encoder=with_encoder_name(config.text_encoder, str(included)))
    data = load_training_data(path)
    variables = {role: arrays[kind] for role, kind in kinds.items()}
    card = load_text(path / CARD_FILE) if (path / CARD_FILE).is_file() else ""
    return Bundle(config, variables, normalizer, load_text_tokenizer(path, config), data, card)


def load_training_data(folder: Path) -> dict[str, Any] | None:
    """Returns what a model was trained on, None if its folder does not say.

    Raises:
        UserError: The file is damaged.
    """
    path = folder / DATA_FILE
    data = load_json(path) if path.is_file() else None
    if data is not None and not isinstance(data, dict):
        raise UserError(f"{path}: expected an object, got {reprlib.repr(data)}")
    # Warnings, pages and the studio use these, and the file may come from the hub: so types are checked once, here.
    for name, kind in {"num_clips": int, "shortest_frames": int, "words": dict, "actions": dict}.items():
        found = (data or {}).get(name, kind())
        numbers = found.values() if isinstance(found, dict) else [found]
        if type(found) is not kind or not all(type(number) is int and number >= 0 for number in numbers):
            raise UserError(f"{path}: {name}: expected numbers from 0, got {reprlib.repr(found)}")
    for name in ("captions", "learned", "missing", "taught"):
        sentences = (data or {}).get(name, [])
        if not isinstance(sentences, list) or not all(isinstance(sentence, str) for sentence in sentences):
            raise UserError(f"{path}: {name}: expected a list of sentences, got {reprlib.repr(sentences)}")
    return data


def check_statistics_width(path: Path, normalizer: Normalizer, feature_dim: int) -> None:
    """Raises `UserError` if the statistics in a model's folder are not for the features that the model reads."""
    if normalizer.mean.shape != (feature_dim,):
        raise UserError(f"{path}: its statistics are for {len(normalizer.mean)} features; the model has {feature_dim}")


def load_text_tokenizer(path: Path, config: BundleConfig) -> Tokenizer | None:
    """Returns the subwords of a model's caption encoder, None if it has none.

    Raises:
        UserError: The file is missing or damaged, or has a token that the caption encoder does not know.
    """
    if not isinstance(config.text_encoder, CaptionEncoderConfig):
        return None
    bpe = load_bpe(path)
    check_vocabulary(path / TOKENIZER_FILE, bpe, config.text_encoder.vocabulary_size)
    return bpe


def save_bundle(
    path: str | Path, bundle: Bundle, *, card: str, half: bool = True, encoder: PretrainedEncoder | None = None
) -> None:
    """Writes a bundle folder; it appears complete or not at all.

    Args:
        path: Folder to create.
        bundle: The model.
        card: Markdown that describes the model.
        half: Whether the bundle is small: weights have 16 bits, and some follow from others (see `derived`).
        encoder: The pretrained text encoder to include. Without it, users of the bundle need it by its name.

    Raises:
        UserError: `path` exists already.
    """
    with atomic_folder(Path(path)) as folder:
        write_bundle(folder, bundle, card=card, half=half, encoder=encoder)


def write_bundle(
    folder: Path, bundle: Bundle, *, card: str, half: bool = True, encoder: PretrainedEncoder | None = None
) -> None:
    """Writes the files of a bundle into a folder that its caller makes; the other arguments are `save_bundle`'s."""
    kinds = part_kinds(bundle.config)
    save_config(folder / CONFIG_FILE, bundle.config)
    arrays = traverse_util.flatten_dict({kinds[role]: tree for role, tree in bundle.variables.items()}, sep="/")
    save_arrays(folder / WEIGHTS_FILE, drop_derived(arrays) if half else arrays, half=half)
    save_normalizer(folder, bundle.normalizer)
    if bundle.bpe is not None:
        save_bpe(folder, bundle.bpe)
    if bundle.training_data is not None:
        save_json(folder / DATA_FILE, bundle.training_data)
    reference = pretrained_reference(bundle.config.text_encoder)
    if encoder is not None and reference is not None:
        save_pretrained(folder / reference.kind, encoder)
    # The manifest is last, because it lists all files that are there.
    save_text(folder / CARD_FILE, card)
    write_manifest(folder)


def default_card(run: Path) -> str:
    """Returns the Markdown card of a model whose maker wrote none: the training config, and what is unknown."""
    config = run_config_text(run).strip()
    return (
        f"---\nlicense: {NO_LICENSE}\n---\n# {run.name}\n\n"
        "A text-to-motion model trained with t2m_jax. Its makers did not say which data it was trained on, which\n"
        "license it has, or how good it is. Ask them before you use it or share it.\n\n"
        f"## Training config\n\n```yaml\n{config}\n```\n"
    )
