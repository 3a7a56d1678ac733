"""Makes the sentence encoders of tests/golden/sentence with PyTorch and `sentence-transformers`.

    pip install -e '.[parity]'
    python -m tests.parity.make_sentence_fixture

Three tiny encoders with random weights, one of each structure that is supported: `bert` (WordPiece, mean, normalized),
`roberta` (XLM-R with Unigram, first token, not normalized, 16 bits) and `mpnet` (WordPiece, mean, longer captions).
"""

import json
import shutil
import tempfile
from pathlib import Path

import numpy as np
import torch
from sentence_transformers import SentenceTransformer
from sentence_transformers.sentence_transformer.modules import Normalize, Pooling, Transformer
from tokenizers import Tokenizer, models, normalizers, pre_tokenizers, processors, trainers
from transformers import (
    BertConfig,
    BertModel,
    MPNetConfig,
    MPNetModel,
    PreTrainedTokenizerFast,
    XLMRobertaConfig,
    XLMRobertaModel,
)

from tests.parity.clip_captions import CAPTIONS, training_captions
from tests.parity.randomize import randomize

GOLDEN = Path(__file__).parents[1] / "golden" / "sentence"
SIZES = {"hidden_size": 24, "intermediate_size": 40, "num_hidden_layers": 2, "num_attention_heads": 3}


def make_tokenizer(model: str, start: str, end: str, pad: str, unknown: str) -> PreTrainedTokenizerFast:
    """Returns a tokenizer learned from motion captions, which adds a start and an end."""
    specials = [start, pad, end, unknown]
    if model == "wordpiece":
        tokenizer = Tokenizer(models.WordPiece(unk_token=unknown))
        tokenizer.normalizer = normalizers.BertNormalizer(lowercase=True)
        tokenizer.pre_tokenizer = pre_tokenizers.BertPreTokenizer()
        trainer = trainers.WordPieceTrainer(vocab_size=250, special_tokens=specials, show_progress=False)
    else:
        tokenizer = Tokenizer(models.Unigram())
        tokenizer.pre_tokenizer = pre_tokenizers.Metaspace()
        trainer = trainers.UnigramTrainer(
            vocab_size=250, special_tokens=specials, unk_token=unknown, show_progress=False
        )
    tokenizer.train_from_iterator(training_captions(), trainer)
    marks = [(token, tokenizer.token_to_id(token)) for token in (start, end)]
    tokenizer.post_processor = processors.TemplateProcessing(single=f"{start} $A {end}", special_tokens=marks)
    return PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, cls_token=start, sep_token=end, pad_token=pad, unk_token=unknown
    )


def make(name: str, network: torch.nn.Module, tokenizer: PreTrainedTokenizerFast, *, pooling: str, length: int) -> None:
    """Writes an encoder as `sentence-transformers` does."""
    randomize(network, seed=len(name))
    with tempfile.TemporaryDirectory() as scratch:
        (network.half() if name == "roberta" else network).save_pretrained(scratch)
        tokenizer.save_pretrained(scratch)
        steps = [Transformer(scratch, max_seq_length=length), Pooling(SIZES["hidden_size"], pooling_mode=pooling)]
        SentenceTransformer(modules=[*steps, Normalize()] if name == "bert" else steps).save(f"{GOLDEN / name}")
    (GOLDEN / name / "README.md").unlink()
    (GOLDEN / name / "model.safetensors").chmod(0o644)


def main() -> None:
    """Writes all encoders and their embeddings of the captions."""
    shutil.rmtree(GOLDEN, ignore_errors=True)
    words = make_tokenizer("wordpiece", "[CLS]", "[SEP]", "[PAD]", "[UNK]")
    config = BertConfig(vocab_size=len(words), max_position_embeddings=48, **SIZES)
    make("bert", BertModel(config), words, pooling="mean", length=40)
    pieces = make_tokenizer("unigram", "<s>", "</s>", "<pad>", "<unk>")
    config = XLMRobertaConfig(vocab_size=len(pieces), max_position_embeddings=66, type_vocab_size=1, **SIZES)
    make("roberta", XLMRobertaModel(config), pieces, pooling="cls", length=64)
    words = make_tokenizer("wordpiece", "<s>", "</s>", "<pad>", "[UNK]")
    config = MPNetConfig(vocab_size=len(words), max_position_embeddings=180, **SIZES)
    make("mpnet", MPNetModel(config), words, pooling="mean", length=170)
    captions = [*CAPTIONS, " and then ".join(CAPTIONS[:20])]
    found = {}
    for name in ("bert", "roberta", "mpnet"):
        encoder = SentenceTransformer(str(GOLDEN / name), device="cpu", model_kwargs={"dtype": torch.float32})
        found[name] = encoder.encode(captions, batch_size=len(captions))
    np.savez_compressed(GOLDEN / "golden.npz", **found)
    (GOLDEN / "captions.json").write_text(json.dumps(captions, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
