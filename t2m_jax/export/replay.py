"""A data set of motion that a model generates, to be learned again.

A model that learns new motion alone forgets what it knew. If it also learns what it generated before, it keeps more
(generative replay, Shin et al. 2017, arXiv:1705.08690), and its training data are not needed.
"""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from t2m_jax.data.folder import DatasetInfo
from t2m_jax.data.texts import Caption, format_caption
from t2m_jax.data.writer import ImportReport, check_count, finish_folder, new_folder, write_clip
from t2m_jax.errors import UserError
from t2m_jax.field_checks import check_seed
from t2m_jax.motion.features import features_from_positions
from t2m_jax.motion.motion import Motion
from t2m_jax.sampling.pipeline import TextToMotion
from t2m_jax.text.coverage import PromptWarning

BATCH = 64
"""Motions that are generated together."""


def write_replay(
    model: TextToMotion, destination: str | Path, *, num_clips: int, sentences: Sequence[str] = (), seed: int = 0
) -> ImportReport:
    """Makes a data-set folder of motions that a model generates, all in the training split, and returns a report.

    Args:
        model: The model.
        destination: Folder to make.
        num_clips: Number of clips. If there are more sentences, some are drawn; if there are fewer, they are repeated.
        sentences: What is generated; by default the captions that the model's record of its training data has.
        seed: Draws the sentences, and motion.

    Raises:
        UserError: There are no sentences, one has a `#`, the number is not from 1 to `MAX_NEW_CLIPS`, the
            seed of a repetition is not from 0 to 2**32 - 1, or the destination exists.
    """
    known = list(dict.fromkeys(sentences or (model.training_data or {}).get("captions", ())))
    if not known:
        raise UserError("the model has no record of its captions; give sentences (`--sentences FILE`)")
    check_count("num-clips", num_clips, least=1)
    check_seed(seed)
    check_seed(seed + (num_clips - 1) // len(known))  # of the last repetition
    for sentence in known:  # before hours of sampling
        format_caption(Caption(sentence))
    known = [known[place] for place in np.random.default_rng(seed).permutation(len(known))]
    info = DatasetInfo(
        name="replay", skeleton=model.skeleton.name, fps=model.skeleton.fps, licence=model.license, source=model.source
    )
    splits: dict[str, list[str]] = {"train": []}
    left_out = {}
    num_frames = 0
    with new_folder(destination) as folder:
        for number, motion in enumerate(_generate(model, known, num_clips, seed=seed)):
            name = f"replay_{number:05d}"
            if not info.fits(motion.num_frames - 1):
                left_out[name] = f"{motion.num_frames} frames; {info.min_frames} to {info.max_frames} are trained on"
                continue
            features = features_from_positions(motion.positions / model.skeleton.metres_per_unit, model.skeleton)
            write_clip(folder, name, features, captions=[Caption(motion.caption)], skeleton=model.skeleton)
            splits["train"].append(name)
            num_frames += len(features)
        sizes = finish_folder(folder, splits, info=info, skeleton=model.skeleton)
    return ImportReport(len(splits["train"]), num_frames, sizes, left_out, ())


def _generate(model: TextToMotion, sentences: Sequence[str], num_clips: int, *, seed: int) -> Iterator[Motion]:
    """Yields motions of the sentences, and then of the same sentences with the next seed, until there are enough."""
    done = 0
    while done < num_clips:
        repeat, first = divmod(done, len(sentences))
        asked = sentences[first : first + min(BATCH, num_clips - done)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PromptWarning)  # its own captions have rare words, too
            # As captions are learned: action by action, motions would be longer than those of training.
            motions = model.generate(asked, seed=seed + repeat, whole=True)
        done += len(motions)
        yield from motions
