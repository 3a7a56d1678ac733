"""A bidirectional GRU that reads sequences of different lengths, like PyTorch's GRU with packed sequences."""

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.convolution import uniform_init


class GruDirection(nn.Module):
    """One direction of a GRU, with the gates in the order reset, update, new.

    As in PyTorch, the recurrent bias of the new gate is multiplied by the reset gate, so it cannot be merged with the
    input bias.
    """

    features: int
    backward: bool

    @nn.compact
    def __call__(
        self, inputs: Float[Array, "B S X"], mask: Bool[Array, "B S"], initial: Float[Array, "1 H"]
    ) -> Float[Array, "B H"]:
        """Returns the state after the last step. The state does not change where the mask is False."""
        width = self.features
        initializer = uniform_init(width**-0.5)
        gates = nn.Dense(3 * width, kernel_init=initializer, bias_init=initializer, name="input")(inputs)
        recurrent_kernel = self.param("recurrent_kernel", initializer, (width, 3 * width))
        recurrent_bias = self.param("recurrent_bias", initializer, (3 * width,))

        def step(
            state: Float[Array, "B H"], now: tuple[Float[Array, "B W"], Bool[Array, " B"]]
        ) -> tuple[Float[Array, "B H"], None]:
            gate, is_read = now
            reset, update, new = jnp.split(gate, 3, axis=-1)
            recurrent = state @ recurrent_kernel + recurrent_bias[None]
            reset_by, update_by, new_by = jnp.split(recurrent, 3, axis=-1)
            kept = nn.sigmoid(update + update_by)
            proposal = jnp.tanh(new + nn.sigmoid(reset + reset_by) * new_by)
            return jnp.where(is_read[:, None], (1 - kept) * proposal + kept * state, state), None

        first = jnp.broadcast_to(initial, (inputs.shape[0], width))
        steps = (jnp.swapaxes(gates, 0, 1), mask.T)
        last, _ = jax.lax.scan(step, first, steps, reverse=self.backward)
        return last


class BiGru(nn.Module):
    """Both directions of a GRU, each with a learned initial state."""

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B S X"], lengths: Int[Array, " B"]) -> Float[Array, "B W"]:
        """Returns the last states after reading the first `lengths[b]` steps, forward and backward side by side.

        The backward direction begins at step `lengths[b] - 1`, and later steps have no influence. The result for a
        sequence of length 0 is the initial states.
        """
        # Weights that were read from a file are NumPy arrays, but the directions take JAX arrays.
        initial = jnp.asarray(self.param("initial_state", nn.initializers.normal(1.0), (2, 1, self.features)))
        mask = mask_from_lengths(lengths, inputs.shape[1])
        forward = GruDirection(self.features, backward=False, name="forward")(inputs, mask, initial[0])
        backward = GruDirection(self.features, backward=True, name="backward")(inputs, mask, initial[1])
        return jnp.concatenate([forward, backward], axis=-1)
