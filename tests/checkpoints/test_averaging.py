"""The mean of two models: its law at both ends and between, what it keeps, and models that have none."""

import dataclasses

import chex
import jax
import pytest

from t2m_jax.checkpoints.averaging import mean_of_models
from t2m_jax.errors import UserError
from tests.tiny import BUNDLE, HIFIGPT_BUNDLE, random_bundle

OLD_RECORD = {"words": {"walks": 3, "stops": 2}, "actions": {"stops": 2}, "taught": ["boing"], "num_clips": 4}
NEW_RECORD = {"words": {"walks": 9, "stops": 1}, "actions": {"waves": 1}, "taught": ["ahoy"], "num_clips": 6}


def model(config=BUNDLE, *, seed=10):
    """Returns a model with weights of its own and the tokenizer of all others, as after a training."""
    tokenizer = random_bundle(config).variables["tokenizer"]
    bundle = random_bundle(config, seed=seed)
    return bundle._replace(variables=bundle.variables | {"tokenizer": tokenizer})


def with_generator(bundle, **changes):
    generator = dataclasses.replace(bundle.config.generator, **changes)
    return bundle._replace(config=dataclasses.replace(bundle.config, generator=generator))


OLD, NEW = model()._replace(training_data=OLD_RECORD), model(seed=11)._replace(training_data=NEW_RECORD, card="# new\n")


@pytest.mark.parametrize("config", [BUNDLE, HIFIGPT_BUNDLE])
@pytest.mark.parametrize("share", [0, 0.25, 1])
def test_weights_lie_between_those_of_both(config, share):
    old, new = model(config), model(config, seed=11)
    found = mean_of_models(old, new, share)
    assert found.variables["tokenizer"] is new.variables["tokenizer"]
    for role in ("generator", "text_encoder"):
        wanted = jax.tree.map(lambda a, b: a + share * (b - a), old.variables[role], new.variables[role])
        chex.assert_trees_all_close(found.variables[role], wanted, atol=1e-6)
        chex.assert_trees_all_equal_dtypes(found.variables[role], new.variables[role])


def test_what_both_have_stays_to_the_last_bit():
    chex.assert_trees_all_equal(mean_of_models(OLD, OLD, 0.7).variables, OLD.variables)


def test_the_record_is_that_of_both():
    found = mean_of_models(OLD, NEW, 0.5)
    assert found.training_data == {
        "words": {"walks": 9, "stops": 2},
        "actions": {"stops": 2, "waves": 1},
        "taught": ["ahoy", "boing"],
        "num_clips": 6,
    }
    assert found.card == "# new\n"
    assert mean_of_models(OLD._replace(training_data=None), NEW, 0.5).training_data == NEW_RECORD


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan"), float("inf")])
def test_a_share_is_from_0_to_1(share):
    with pytest.raises(UserError, match=r"mean: .* is not a number from 0 to 1"):
        mean_of_models(OLD, NEW, share)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (with_generator(NEW, num_heads=1), "generator.num_heads is 2 in the first and 1 in the second model"),
        (model(HIFIGPT_BUNDLE), "in the first and .* in the second model"),
        (random_bundle(seed=11), "other tokenizers"),
        (NEW._replace(normalizer=NEW.normalizer._replace(mean=NEW.normalizer.mean + 1)), "other tokenizers"),
        (NEW._replace(bpe=None), "other subwords"),
    ],
)
def test_models_whose_numbers_mean_something_else_have_no_mean(other, said):
    with pytest.raises(UserError, match=f"mean: .*{said}.*trained on from the other"):
        mean_of_models(OLD, other, 0.5)


def test_what_weights_do_not_depend_on_may_differ():
    assert mean_of_models(OLD, with_generator(NEW, dropout=0.3), 0.5).config.generator.dropout == 0.3
