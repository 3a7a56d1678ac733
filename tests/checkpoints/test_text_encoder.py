"""What identifies a pretrained text encoder in runs and bundles."""

import pytest

from t2m_jax.checkpoints.clip import load_clip
from t2m_jax.checkpoints.sentence import load_sentence_encoder
from t2m_jax.checkpoints.text_encoder import (
    ClipReference,
    SentenceReference,
    encoder_identity,
    load_pretrained,
    save_pretrained,
)
from t2m_jax.errors import UserError
from tests.clip_golden import FULL, TEXT_ONLY, TORCH, copy_files
from tests.sentence_golden import BERT, MPNET, change_json, copy_encoder


def test_an_encoder_is_the_same_in_every_form_of_its_files(tmp_path):
    wanted = encoder_identity(load_clip(FULL))
    other = load_clip(copy_files(FULL, tmp_path / "other", weights=TORCH))
    save_pretrained(tmp_path / "saved", other)
    assert wanted == encoder_identity(other) == encoder_identity(load_clip(tmp_path / "saved"))
    assert wanted != encoder_identity(load_clip(TEXT_ONLY))


@pytest.mark.parametrize(
    ("file", "changes"),
    [
        ("sentence_bert_config.json", {"max_seq_length": 30}),
        ("1_Pooling/config.json", {"pooling_mode": "cls"}),
        ("tokenizer.json", {"normalizer": None}),
    ],
)
def test_an_encoder_that_gives_other_embeddings_is_another_one(file, changes, tmp_path):
    copy = copy_encoder(BERT, tmp_path / "copy")
    reference = SentenceReference(name=str(copy), identity=encoder_identity(load_sentence_encoder(BERT)))
    assert load_pretrained(reference).fingerprint
    change_json(copy / file, **changes)
    with pytest.raises(UserError, match=r"copy: is not the text encoder that the model was trained with"):
        load_pretrained(reference)


def test_an_encoder_whose_identity_is_not_known_is_taken():
    assert load_pretrained(ClipReference(name=str(FULL)), text_dim=24).config.text_dim == 24
    assert load_pretrained(SentenceReference(name=str(MPNET))).config.num_buckets == 32
