"""`TextToMotion`: a sample is a function of seed, sentence and its number, and of nothing beside it."""

import dataclasses
import itertools
import subprocess
import sys

import jax
import numpy as np
import pytest

from t2m_jax.checkpoints.bundle import BUNDLED
from t2m_jax.checkpoints.text_encoder import ClipReference
from t2m_jax.data.importers.synthetic import make_motion
from t2m_jax.errors import UserError
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.skeleton import HUMANML3D, KIT_ML
from t2m_jax.sampling import Greedy, TextToMotion, TopK, encode_motions
from t2m_jax.sampling.model import ModelParts
from t2m_jax.sampling.prompts import read_prompts, sample_key
from t2m_jax.sampling.request import MAX_SAMPLES, SamplingOptions
from t2m_jax.text.coverage import PromptWarning
from t2m_jax.text.encoder import TextEncoder
from tests.jit import process_of_user
from tests.tiny import BUNDLE, CAPTIONS, random_bundle


@pytest.fixture(scope="module")
def bundle():
    return random_bundle()


@pytest.fixture(scope="module")
def model(bundle):
    return TextToMotion(bundle)


def test_a_model_is_identified_by_the_weights_of_clip_wherever_they_are(bundle):
    class Clip:
        def __init__(self, fingerprint):
            self.fingerprint = fingerprint

        def __call__(self, captions):
            return jax.numpy.zeros((len(captions), bundle.config.generator.text_dim))

    def fingerprint(name, weights):
        config = dataclasses.replace(bundle.config, text_encoder=ClipReference(name=name))
        variables = {role: bundle.variables[role] for role in ("tokenizer", "generator")}
        model = bundle._replace(config=config, variables=variables, bpe=None)
        return TextToMotion(model, text_encoder=Clip(weights)).fingerprint

    assert fingerprint("a", "1") == fingerprint("/b", "1") != fingerprint("a", "2")


@pytest.fixture(scope="module")
def eight(model):
    return model.generate(CAPTIONS[:4], seed=3, num_samples=2)


def assert_same(motion, other):
    np.testing.assert_array_equal(motion.codes, other.codes)
    np.testing.assert_allclose(motion.positions, other.positions, atol=1e-4)
    assert (motion.caption, motion.seed) == (other.caption, other.seed)


def test_a_motion_is_complete(model, eight):
    assert [motion.caption for motion in eight] == [caption for caption in CAPTIONS[:4] for _ in range(2)]
    for motion in eight:
        assert motion.seed == 3
        assert motion.fps == 20.0
        assert motion.positions.shape == (4 * len(motion.codes), 22, 3)
        assert motion.features.shape == (4 * len(motion.codes), 263)
        assert 0 < len(motion.codes) <= model.config.generator.max_codes
        assert motion.codes.max() < BUNDLE.tokenizer.num_codes
    assert len({len(motion.codes) for motion in eight}) > 1, "the test wants motions of several lengths"


@pytest.mark.parametrize(("frames", "rows"), [(0, 1), (27, 6), (10**6, BUNDLE.generator.max_codes)])
def test_no_motion_is_shorter_than_nearly_all_clips_of_training(bundle, frames, rows):
    parts = TextToMotion(bundle._replace(training_data={"shortest_frames": frames})).parts
    assert (parts.sampling().min_codes, parts.sampling(SamplingOptions(max_codes=2)).min_codes) == (rows, min(rows, 2))
    assert parts.sampling(min_codes=0).min_codes == 0


@pytest.mark.slow
def test_eight_together_equal_eight_alone(model, eight):
    """The second sample of a sentence cannot be had alone: two are made, and the batch is another one all the same."""
    for number, caption in enumerate(CAPTIONS[:4]):
        first, second = eight[2 * number : 2 * number + 2]
        assert_same(first, model.generate(caption, seed=3)[0])
        assert_same(second, model.generate([caption], seed=3, num_samples=2)[1])


@pytest.mark.slow
def test_order_and_neighbours_do_not_matter(model, eight):
    # As many as in a batch of other tests, which share its program.
    others = model.generate([CAPTIONS[4], CAPTIONS[2], CAPTIONS[0], CAPTIONS[1]], seed=3)
    assert_same(others[1], eight[4])
    assert_same(others[2], eight[0])


def test_seeds_and_samples_differ(model, eight):
    assert eight[0].codes.tolist() != eight[1].codes.tolist()
    assert model.generate(CAPTIONS[0], seed=4)[0].codes.tolist() != eight[0].codes.tolist()


@pytest.fixture
def few_together(monkeypatch):
    """Returns the motions of the largest batch, which is one of those that other tests compile."""
    monkeypatch.setattr("t2m_jax.sampling.generation.MAX_BATCH", 4)
    return 4


@pytest.mark.slow
def test_more_than_one_batch(model, few_together):
    many = model.generate(CAPTIONS[0], seed=1, num_samples=few_together + 2)
    assert len(many) == few_together + 2
    assert_same(many[0], model.generate(CAPTIONS[0], seed=1)[0])


@pytest.mark.slow
def test_motions_are_generated_a_batch_at_a_time_as_they_are_taken(model, few_together, monkeypatch):
    sizes, sample_codes = [], ModelParts.sample_codes

    def record(self, text_embedding, *args, **kwargs):
        sizes.append(len(text_embedding))
        return sample_codes(self, text_embedding, *args, **kwargs)

    monkeypatch.setattr(ModelParts, "sample_codes", record)
    motions = model.generate_each(CAPTIONS[0], seed=1, num_samples=3 * few_together)
    assert sizes == []
    taken = list(itertools.islice(motions, few_together))
    assert len(taken) == few_together and sizes == [few_together]
    next(motions)
    assert sizes == [few_together, few_together]


def test_white_space_is_folded(model, eight):
    assert_same(model.generate(f"  {CAPTIONS[0]}\n", seed=3)[0], eight[0])


def test_greedy_needs_no_seed(model):
    one, other = (model.generate(CAPTIONS[1], seed=seed, strategy=Greedy())[0] for seed in (0, 1))
    np.testing.assert_array_equal(one.codes, other.codes)


@pytest.mark.slow
def test_length_can_be_limited(model):
    assert all(len(motion.codes) <= 3 for motion in model.generate(CAPTIONS, max_codes=3, raw=True))


def test_motion_is_cleaned_unless_it_is_wanted_as_decoded(model, eight):
    (raw,) = model.generate(CAPTIONS[0], seed=3, raw=True)
    assert raw.positions_raw is None
    np.testing.assert_allclose(raw.positions, eight[0].positions_raw, atol=1e-5)
    np.testing.assert_allclose(raw.features, eight[0].features, atol=1e-5)
    bones = np.linalg.norm(eight[0].positions[:, 4] - eight[0].positions[:, 1], axis=-1)
    np.testing.assert_allclose(bones, model.skeleton.bone_lengths[4], rtol=1e-3)
    assert np.abs(raw.positions - eight[0].positions).max() > 1e-3
    np.testing.assert_allclose(model.decode(raw.codes, raw=True).positions, raw.positions, atol=1e-4)


def test_a_motion_is_encoded_from_its_features_or_its_positions(model):
    walk = Motion(make_motion("walk", seed=1, num_frames=61), 20.0)
    again = model.encode(walk)
    (expected,) = encode_motions(model.tokenizer, [features_from_positions(walk.positions, HUMANML3D)], progress=False)
    np.testing.assert_array_equal(again, expected)
    assert again.shape == ((walk.num_frames - 1) // model.config.tokenizer.downsample, 1)
    np.testing.assert_array_equal(model.encode(walk.resampled(40))[2:-2], expected[2:-2])
    generated = model.generate(CAPTIONS[0], raw=True)[0]
    (expected,) = encode_motions(model.tokenizer, [generated.features], progress=False)
    np.testing.assert_array_equal(model.encode(dataclasses.replace(generated, codes=None)), expected)


def test_a_motion_of_the_model_keeps_its_codes(model):
    generated = model.generate(CAPTIONS[0], seed=3)[0]
    np.testing.assert_array_equal(model.encode(generated), generated.codes)
    others = (generated.codes + 1) % model.config.tokenizer.num_codes
    expected = model.encode(dataclasses.replace(generated, codes=None))
    assert (expected != generated.codes).any(), "a random tokenizer finds other codes"
    wrong = (
        others,
        generated.codes[:-1],
        generated.codes[:0],
        generated.codes + 10**9,
        generated.codes.repeat(2, axis=1),
    )
    for codes in wrong:
        np.testing.assert_array_equal(model.encode(dataclasses.replace(generated, codes=codes)), expected)
    with pytest.raises(UserError, match="features"):
        model.encode(dataclasses.replace(generated, features=generated.features[:, :200]))


@pytest.mark.parametrize("count", [57, 58, 59, 60])
def test_the_end_of_a_file_is_encoded(model, count):
    """Its rows of codes are as long as the motion, up to half a row."""
    walk = Motion(make_motion("walk", seed=1, num_frames=count), 20.0)
    row = model.config.tokenizer.downsample
    assert abs(len(model.encode(walk)) * row - count) <= row / 2


def test_motions_that_cannot_be_encoded_are_refused(model):
    with pytest.raises(UserError, match="skeleton"):
        model.encode(Motion(np.zeros((40, 21, 3)), 12.5, skeleton=KIT_ML))
    with pytest.raises(UserError, match="a code needs"):
        model.encode(Motion(make_motion("walk", seed=1, num_frames=60), 20.0)[:3])


@pytest.mark.slow
def test_decode_gives_the_generated_motion_again(model, eight):
    again = model.decode(eight[0].codes, caption=eight[0].caption)
    np.testing.assert_allclose(again.positions, eight[0].positions, atol=1e-4)


@pytest.mark.parametrize("method", ["generate", "generate_each"])
@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"seed": -1}, "seed"),
        ({"seed": 2**32}, "seed"),
        ({"num_samples": 0}, "num-samples"),
        ({"num_samples": MAX_SAMPLES + 1}, "num-samples: 1000001 is not a whole number from 1 to 1,000,000"),
        ({"num_samples": 300_000_000}, "num-samples"),
        ({"max_codes": 0}, "max-codes"),
        ({"max_codes": 1000}, "max-codes"),
    ],
)
def test_numbers_out_of_range_are_refused_before_the_first_motion(model, monkeypatch, method, options, name):
    monkeypatch.setattr(ModelParts, "sample_codes", lambda *_, **__: pytest.fail("began to generate"))
    with pytest.raises(UserError, match=name):
        getattr(model, method)(CAPTIONS[0], **options)


@pytest.mark.parametrize("codes", [[], [-1], [BUNDLE.tokenizer.num_codes], [[1, 2]]])
def test_codes_out_of_range_are_refused(model, codes):
    with pytest.raises(UserError, match="codes"):
        model.decode(np.array(codes, np.int32))


def test_the_text_encoder_reads_each_caption_for_itself(model):
    assert isinstance(model.text_encoder, TextEncoder)
    together = model.text_encoder(CAPTIONS)
    assert together.shape == (len(CAPTIONS), BUNDLE.generator.text_dim)
    for caption, embedding in zip(CAPTIONS, together, strict=True):
        np.testing.assert_allclose(model.text_encoder([caption])[0], embedding, atol=1e-5)
    assert len(np.unique(np.round(together, 3), axis=0)) == len(CAPTIONS)


def test_sample_keys_are_distinct():
    keys = [sample_key(seed, caption, sample) for seed in (0, 1) for caption in CAPTIONS for sample in (0, 1)]
    assert len({tuple(jax.random.key_data(key).tolist()) for key in keys}) == len(keys)


def test_sampling_does_not_change_the_variables(bundle):
    model = TextToMotion(bundle)
    for _ in range(2):
        jax.tree.map(np.testing.assert_array_equal, model.variables, bundle.variables)
        model.generate(CAPTIONS[0])


@pytest.mark.slow
def test_numbers_are_a_strategy(model):
    expected = model.generate(CAPTIONS[0], strategy=TopK(k=3, temperature=0.7))[0]
    np.testing.assert_array_equal(model.generate(CAPTIONS[0], temperature=0.7, top_k=3)[0].codes, expected.codes)
    greedy = model.generate(CAPTIONS[0], strategy=Greedy())[0]
    np.testing.assert_array_equal(model.generate(CAPTIONS[0], temperature=0.0)[0].codes, greedy.codes)
    with pytest.raises(UserError, match=r"strategy: excludes temperature"):
        model.generate(CAPTIONS[0], strategy=Greedy(), top_p=0.5)


@pytest.mark.slow
def test_progress_is_told_after_each_batch(model, few_together):
    told = []
    model.generate(CAPTIONS[:2], num_samples=5, on_progress=lambda *counts: told.append(counts))
    assert told == [(few_together, 10), (2 * few_together, 10), (10, 10)]


@pytest.mark.slow
def test_a_model_warns_of_what_it_does_not_know(bundle):
    words = {word: 9 for caption in CAPTIONS for word in caption.split()}
    data = {"data": "mine", "num_clips": 24, "words": words, "actions": {"walk": 9, "wave": 3}}
    model = TextToMotion(bundle._replace(training_data=data))
    with pytest.warns(
        PromptWarning, match=r"'a person jumps': not learned, so without effect: jumps; .* knows walk, wave"
    ):
        jump, walk = model.generate(["a person jumps", "a plumber walks forward"])
    assert jump.unknown_words == ("jumps",) and "jumps" in jump.warning
    assert walk.unknown_words == ("plumber",) and walk.warning == ""
    with pytest.warns(PromptWarning, match="jumps") as found:
        next(model.stream("a person jumps"))
    assert found[0].filename == __file__
    limit = bundle.config.text_encoder.max_length
    with pytest.warns(PromptWarning, match=r"too long, so cut after '.*person wal"):
        model.generate("a person walks " * limit)
    assert jump[:4].warning == jump.warning and jump.mirrored().warning == jump.warning


def test_a_model_says_what_it_is(bundle):
    data = {"data": "mine", "num_clips": 1200, "words": {"walk": 9}, "actions": {"wave": 7, "walk": 9}}
    text = repr(TextToMotion(bundle._replace(training_data=data, card="---\nlicense: mit\n---\n")))
    assert text.startswith("TextToMotion:\n  parts: ")
    for part in ("gpt (0.0", "vqvae (0.0", "humanml3d, 20 frames", "mine (1,200 clips)", "license: mit", "walk, wave"):
        assert part in text
    assert "data: unknown (0 clips)\n  license: unknown\n  source: unknown\n  actions: unknown" in repr(
        TextToMotion(bundle)
    )


@pytest.mark.slow
def test_a_name_in_place_of_a_bundle_gets_a_hint():
    program = "from t2m_jax.sampling import TextToMotion; TextToMotion('demo')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "UserError: 'demo' is not a loaded bundle; use t2m_jax.load('demo')" in done.stderr


def test_weights_are_rearranged_once_and_held_once(bundle):
    model = TextToMotion(bundle)
    model.generate(CAPTIONS[0])
    first = model.parts._variables["generator"]
    model.generate(CAPTIONS[0])
    assert model.parts._variables["generator"] is first
    assert sum(leaf.size for leaf in jax.tree.leaves(first)) == sum(
        leaf.size for leaf in jax.tree.leaves(bundle.variables["generator"])
    )


def codes_by_batch_size(name):
    """Returns the codes of the same motions, generated in batches of several sizes."""
    actions = ("walks", "runs", "jogs", "waves", "strolls", "lifts both arms", "turns around", "raises both hands")
    captions = [f"a person {action} {how}" for action in actions for how in ("", "slowly", "quickly", "and again")]
    codes = {}
    for size in (1, 8, 32):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("t2m_jax.sampling.generation.MAX_BATCH", size)
            model = TextToMotion.load(name)
            motions = [motion for seed in range(4) for motion in model.generate(captions, seed=seed)]
        codes[size] = [motion.codes.tolist() for motion in motions]
    return codes


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.release) if name == "demo" else name for name in BUNDLED]
)
def test_the_batch_size_hardly_changes_a_code(name, monkeypatch):
    """Another batch size changes the last bits of the logits, and so one code in many thousands."""
    with process_of_user(monkeypatch) as process:
        codes = process.submit(codes_by_batch_size, name).result()
    assert sum(np.size(one) for one in codes[1]) > 2500
    assert codes[8] == codes[32]
    # After a changed code, the rest of a motion is another one.
    assert sum(one != other for one, other in zip(codes[1], codes[8], strict=True)) <= 1


@pytest.mark.slow
def test_a_typing_mistake_is_read_as_the_word_that_was_meant(bundle):
    words = dict.fromkeys(("a", "person", "walks", "forward"), 9)
    model = TextToMotion(bundle._replace(training_data={"words": words, "actions": {"walk": 9}}))
    with pytest.warns(PromptWarning, match=r"^'a person wlaks forward': wlaks: read as walks$"):
        (motion,) = model.generate("a person wlaks forward", seed=1)
    assert motion.caption == "a person wlaks forward" and motion.unknown_words == ()
    prompts = read_prompts(["a person walks forward"], model.knowledge, model.text_encoder)
    assert prompts[0].read == prompts[0].text
