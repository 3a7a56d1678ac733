"""Makes the CLIP fixtures of tests/golden/clip with PyTorch and `transformers`, or checks them against both again.

    pip install -e '.[parity]'
    python -m tests.parity.make_clip_fixture           # writes the files anew
    python -m tests.parity.make_clip_fixture --check   # the reference still says what is recorded, and we agree

Two tiny CLIPs with random weights: `full` has an image tower beside it, QuickGELU, the `eos_token_id` 2 of early
configs, and both weight formats; `text_only` is a text tower in 16 bits with exact GELU and a token behind End. Their
BPE vocabulary is learned from motion captions. Recent versions of `transformers` do not write PyTorch files, so it is
written here in the layout of the versions that did.
"""

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
import transformers
from tokenizers import AddedToken, Regex, Tokenizer, models, normalizers, pre_tokenizers, trainers
from transformers import (
    CLIPConfig,
    CLIPModel,
    CLIPTextConfig,
    CLIPTextModelWithProjection,
    CLIPTokenizerFast,
    CLIPVisionConfig,
)

from t2m_jax.checkpoints.clip import load_clip, save_clip
from t2m_jax.models.clip_text import ClipText
from t2m_jax.sampling.text_encoders import PretrainedTextEncoder
from t2m_jax.text.bpe import clip_tokens
from tests.parity.clip_captions import CAPTIONS, training_captions
from tests.parity.randomize import randomize

GOLDEN = Path(__file__).parents[1] / "golden" / "clip"
WEIGHTS = ("model.safetensors", "pytorch_model.bin")
OLDER_FILES = ("vocab.json", "merges.txt")
"""What the reference makes `tokenizer.json` from; we read only that."""
START, END, ADDED = "<|startoftext|>", "<|endoftext|>", "<walk>"
NUM_MERGES = 250
MAX_LENGTH = 77


def learn_vocabulary() -> tuple[dict[str, int], list[tuple[str, str]]]:
    """Returns vocabulary and merges in CLIP's order: bytes, bytes that end a word, merges, start, end."""
    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    learner = Tokenizer(models.BPE(end_of_word_suffix="</w>"))
    learner.normalizer = normalizers.Sequence([normalizers.NFC(), normalizers.Lowercase()])
    learner.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(Regex(r"\p{L}+|\p{N}|[^\s\p{L}\p{N}]+"), behavior="removed", invert=True),
            pre_tokenizers.ByteLevel(add_prefix_space=False),
        ]
    )
    size = 2 * len(alphabet) + NUM_MERGES
    trainer = trainers.BpeTrainer(
        vocab_size=size, end_of_word_suffix="</w>", initial_alphabet=alphabet, show_progress=False
    )
    learner.train_from_iterator(training_captions(), trainer)
    merges = [tuple(pair) for pair in json.loads(learner.to_str())["model"]["merges"]][:NUM_MERGES]
    tokens = [*alphabet, *(letter + "</w>" for letter in alphabet), *map("".join, merges), START, END]
    return {token: number for number, token in enumerate(dict.fromkeys(tokens))}, merges


def save_vocabulary(folder: Path) -> dict[str, int]:
    """Writes the tokenizer as the reference does; returns the vocabulary."""
    vocabulary, merges = learn_vocabulary()
    folder.mkdir(parents=True)
    save_tokenizer(folder, vocabulary, merges)
    return vocabulary


def save_tokenizer(folder: Path, vocabulary: dict[str, int], merges: list[tuple[str, str]]) -> None:
    """Writes the tokenizer of a vocabulary."""
    (folder / OLDER_FILES[0]).write_text(json.dumps(vocabulary, ensure_ascii=False), encoding="utf-8")
    lines = ["#version: 0.2", *(" ".join(pair) for pair in merges)]
    (folder / OLDER_FILES[1]).write_text("\n".join(lines) + "\n", encoding="utf-8")
    CLIPTokenizerFast.from_pretrained(folder, model_max_length=MAX_LENGTH).save_pretrained(folder)
    for name in OLDER_FILES:
        (folder / name).unlink(missing_ok=True)


def text_config(vocabulary_size: int, **changes: object) -> CLIPTextConfig:
    """Returns the tiny text tower of `full`, with changes."""
    sizes = {"hidden_size": 32, "intermediate_size": 96, "num_hidden_layers": 3, "num_attention_heads": 4}
    sizes |= {"max_position_embeddings": MAX_LENGTH, "projection_dim": 24, "vocab_size": vocabulary_size}
    return CLIPTextConfig(**{**sizes, **changes})


def make_full(folder: Path) -> None:
    """Writes a whole CLIP in both formats."""
    vocabulary = save_vocabulary(folder)
    vision = CLIPVisionConfig(
        hidden_size=16, intermediate_size=32, num_hidden_layers=1, num_attention_heads=2, image_size=8, patch_size=4
    )
    text = text_config(len(vocabulary), bos_token_id=vocabulary[START], eos_token_id=2)
    model = CLIPModel(CLIPConfig(text_config=text.to_dict(), vision_config=vision.to_dict(), projection_dim=24))
    randomize(model, seed=1)
    model.save_pretrained(folder)
    state_dict = model.state_dict()
    # Versions that wrote this file also wrote the numbers of the positions.
    state_dict["text_model.embeddings.position_ids"] = torch.arange(MAX_LENGTH)[None]
    torch.save(state_dict, folder / WEIGHTS[1])


def make_text_only(folder: Path) -> None:
    """Writes a text tower in 16 bits, with one token behind End."""
    vocabulary = save_vocabulary(folder)
    start, end = vocabulary[START], vocabulary[END]
    tokenizer = CLIPTokenizerFast.from_pretrained(folder)
    tokenizer.add_tokens([AddedToken(ADDED)])
    tokenizer.save_pretrained(folder)
    for name in OLDER_FILES:
        (folder / name).unlink(missing_ok=True)
    sizes = {"hidden_size": 24, "num_attention_heads": 2, "num_hidden_layers": 2, "hidden_act": "gelu"}
    config = text_config(end + 2, **sizes, bos_token_id=start, eos_token_id=end)
    model = CLIPTextModelWithProjection(config)
    randomize(model, seed=2)
    model.half().save_pretrained(folder)


def reference(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns tokens and embeddings of the captions by the reference, in 32 bits."""
    tokenizer = CLIPTokenizerFast.from_pretrained(folder)
    inputs = tokenizer(list(CAPTIONS), padding="max_length", truncation=True, max_length=77, return_tensors="pt")
    with torch.no_grad():
        if folder.name.startswith("full"):
            model = CLIPModel.from_pretrained(folder).float().eval()
            pooled = model.text_model(inputs["input_ids"], inputs["attention_mask"])[1]
            embeddings = model.text_projection(pooled)
        else:
            model = CLIPTextModelWithProjection.from_pretrained(folder).float().eval()
            embeddings = model(inputs["input_ids"], inputs["attention_mask"]).text_embeds
    return inputs["input_ids"].numpy().astype(np.int32), embeddings.numpy()


def make() -> None:
    """Writes all fixtures."""
    if GOLDEN.exists():
        shutil.rmtree(GOLDEN)
    GOLDEN.mkdir(parents=True)
    make_full(GOLDEN / "full")
    make_text_only(GOLDEN / "text_only")
    arrays = {}
    for name in ("full", "text_only"):
        arrays[f"{name}/tokens"], arrays[f"{name}/embeddings"] = reference(GOLDEN / name)
    np.savez_compressed(GOLDEN / "golden.npz", **arrays)
    (GOLDEN / "captions.json").write_text(json.dumps(CAPTIONS, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")


def ours(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns tokens and embeddings of the captions by t2m_jax."""
    clip = load_clip(folder)
    tokens = clip_tokens(clip.tokenizer, CAPTIONS, max_length=clip.config.max_length)
    return tokens, np.asarray(PretrainedTextEncoder(clip)(CAPTIONS))


def report(what: str, found: tuple, wanted: tuple, tolerance: float) -> bool:
    """Prints one comparison and returns whether it holds."""
    same = np.array_equal(found[0], wanted[0])
    error = float(np.abs(found[1] - wanted[1]).max())
    good = same and error <= tolerance
    print(f"{'ok  ' if good else 'FAIL'} {what}: ids {'identical' if same else 'DIFFER'}, largest error {error:.1e}")
    return good


def check_ours(name: str, wanted: tuple, scratch: Path) -> list[bool]:
    """Compares every file of weights with the recorded values."""
    results = []
    for weights in (weights for weights in WEIGHTS if (GOLDEN / name / weights).exists()):
        folder = scratch / f"{name}-{weights}"
        folder.mkdir()
        for file in ("config.json", "tokenizer.json", weights):
            shutil.copy(GOLDEN / name / file, folder)
        results.append(report(f"t2m_jax, {name}, {weights}", ours(folder), wanted, 1e-5))
    return results


def check_saved(name: str, wanted: tuple, scratch: Path) -> bool:
    """Compares the reference on a folder that `save_clip` wrote with the recorded values."""
    folder = scratch / f"saved-{name}"
    save_clip(folder, load_clip(GOLDEN / name))
    return report(f"reference on what save_clip wrote of {name}", reference(folder), wanted, 1e-5)


def check_full_size(scratch: Path) -> bool:
    """Compares a ViT-B/32 of random weights and captions of random tokens."""
    config = CLIPTextConfig()
    model = CLIPTextModelWithProjection(config).eval()
    randomize(model, seed=3)
    folder = scratch / "full_size"
    model.save_pretrained(folder)
    vocabulary = {f"t{number}": number for number in range(49406)} | {START: 49406, END: 49407}
    save_tokenizer(folder, vocabulary, [])
    clip = load_clip(folder)
    tokens = np.random.default_rng(4).integers(0, 49406, (8, MAX_LENGTH)).astype(np.int32)
    tokens[:, 0] = 49406
    for row, length in enumerate((2, 3, 9, 20, 40, 60, 76, 77)):
        tokens[row, length - 1 :] = 49407
    with torch.no_grad():
        embeddings = model(torch.from_numpy(tokens).long()).text_embeds.numpy()
    found = np.asarray(ClipText(clip.config).apply(clip.variables, tokens))
    # Sums of 2,048 products: rounding leaves ten times what it leaves in the tiny ones.
    return report("t2m_jax, ViT-B/32 of random weights", (tokens, found), (tokens, embeddings), 5e-5)


def check() -> bool:
    """Returns whether the reference says what is recorded and we agree with it."""
    print(f"torch {torch.__version__}, transformers {transformers.__version__}")
    arrays = np.load(GOLDEN / "golden.npz")
    results = []
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        for name in ("full", "text_only"):
            wanted = (arrays[f"{name}/tokens"], arrays[f"{name}/embeddings"])
            results.append(report(f"reference, {name}", reference(GOLDEN / name), wanted, 1e-5))
            results += check_ours(name, wanted, scratch)
        results.append(check_saved("text_only", (arrays["text_only/tokens"], arrays["text_only/embeddings"]), scratch))
        results.append(check_full_size(scratch))
    return all(results)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; compare with what is recorded")
    transformers.utils.logging.set_verbosity_error()
    transformers.utils.logging.disable_progress_bar()
    if not parser.parse_args().check:
        make()
    sys.exit(not check())
