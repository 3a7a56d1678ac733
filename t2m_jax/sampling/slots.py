"""Motions that are sampled in the slots of a batch. A slot takes the next motion when its own ends."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from t2m_jax.devices import put_rows
from t2m_jax.sampling.loop import LoopState, Sampling
from t2m_jax.sampling.programs import begin_slots, generate_in_slots


class Progress(NamedTuple):
    """What is known of the motion of a slot after some more rows."""

    slot: int
    codes: Int[np.ndarray, "N R"]
    """All its rows so far. With a stop rule that does not end early, these may be more than the motion keeps."""
    num_new: int
    """Rows at the end of `codes` that were not reported before."""
    ended: bool
    """Whether `codes` are the whole motion. The slot is free again."""


class Slots:
    """The motions that are sampled at a time.

    A motion depends on its text and key, but not on the other motions. With the same number of slots, this holds to the
    last bit.
    """

    def __init__(
        self,
        variables: Any,
        generator: Any,
        *,
        num_slots: int,
        num_quantizers: int,
        sampling: Sampling,
        guidance_scale: Float[Array, ""] | None,
    ):
        """Takes a generator as `t2m_jax.sampling.programs` does; see `ModelParts.slots`."""
        self.variables = variables
        self.generator = generator
        self.sampling = sampling
        self.guidance_scale = guidance_scale
        # On the host: what a slot has sampled is read after each step, and only the state stays on the device.
        self.codes = np.zeros((num_slots, sampling.max_codes, num_quantizers), np.int32)
        self.scores = np.full((num_slots, sampling.max_codes), -np.inf, np.float32)
        self.num_rows = np.zeros(num_slots, int)
        self.is_free = np.ones(num_slots, bool)
        self.embeddings: list[Float[Array, " E"]] = []
        self.keys: list[Key[Array, ""]] = []
        self.state: LoopState | None = None

    @property
    def free(self) -> list[int]:
        """The slots without a motion."""
        return [int(slot) for slot in np.flatnonzero(self.is_free)]

    def begin(
        self, slots: Sequence[int], embeddings: Sequence[Float[Array, " E"]], keys: Sequence[Key[Array, ""]]
    ) -> None:
        """Begins motions in free slots.

        Args:
            slots: One for each motion.
            embeddings: The texts of the motions.
            keys: One for each motion; consumed.
        """
        if self.state is None:  # the other slots sample what nobody needs
            self.embeddings = [embeddings[0]] * len(self.is_free)
            self.keys = [keys[0]] * len(self.is_free)
        for slot, embedding, key in zip(slots, embeddings, keys, strict=True):
            self.embeddings[slot] = embedding
            self.keys[slot] = key
            self.num_rows[slot] = 0
            self.is_free[slot] = False
            self.scores[slot] = -np.inf
        # All slots in one call, so that one program serves any number of new motions (continuous batching).
        is_new = np.isin(np.arange(len(self.is_free)), slots)
        texts, is_new = put_rows((jnp.stack(self.embeddings), is_new))
        self.state = begin_slots(
            self.variables, self.state, texts, self.guidance_scale, is_new, generator=self.generator
        )

    def release(self, slots: Sequence[int]) -> None:
        """Ends motions that are not needed any more."""
        self.is_free[list(slots)] = True

    def step(self) -> list[Progress]:
        """Samples some more rows, and returns what is new of each motion."""
        assert self.state is not None, "no motion has begun"
        keys = put_rows(jnp.stack(self.keys))
        options: Any = {"generator": self.generator, "sampling": self.sampling}
        self.state, sampled = generate_in_slots(self.variables, self.state, keys, **options)
        rows, scores, done = map(np.asarray, (*sampled, self.state.done[:, 0]))
        before = self._add(np.swapaxes(rows, 0, 1), scores.T)
        ended = done | (self.num_rows >= self.sampling.max_codes)
        lengths = np.where(ended, self._lengths(), self.num_rows)
        found = [
            Progress(
                int(slot),
                self.codes[slot, : lengths[slot]].copy(),
                max(int(lengths[slot] - before[slot]), 0),
                bool(ended[slot]),
            )
            for slot in np.flatnonzero(~self.is_free)
        ]
        # Free slots go on with what nobody needs: a batch of fewer motions would be another program.
        self.is_free |= ended
        return found

    def _add(self, rows: Int[np.ndarray, "B _ R"], scores: Float[np.ndarray, "B _"]) -> Int[np.ndarray, " B"]:
        """Adds rows to the motions, and returns how many each had before."""
        before = self.num_rows.copy()
        for slot in np.flatnonzero(~self.is_free):
            place = slice(before[slot], before[slot] + rows.shape[1])
            # The last rows of a motion of the longest length may not fill a step.
            room = self.codes[slot, place].shape[0]
            self.codes[slot, place] = rows[slot, :room]
            self.scores[slot, place] = scores[slot, :room]
            self.num_rows[slot] += room
        return before

    def _lengths(self) -> Int[np.ndarray, " B"]:
        """Returns how many rows each motion keeps if it has ended."""
        counts = np.asarray(self.sampling.stop_rule.count(jnp.asarray(self.scores)))
        return np.minimum(counts, self.num_rows)
