"""A bidirectional GRU that reads sequences of different lengths as PyTorch reads packed ones."""

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from t2m_jax.masks import mask_from_lengths


def uniform_init(bound: float) -> nn.initializers.Initializer:
    """Returns an initializer that draws from -bound to bound."""

    def initialize(key: PRNGKeyArray, shape: tuple[int, ...], dtype: jax.typing.DTypeLike = jnp.float32) -> jax.Array:
        return jax.random.uniform(key, shape, dtype, -bound, bound)

    return initialize


class GruDirection(nn.Module):
    """One direction of a GRU.

    The new gate's recurrent bias sits inside the product with the reset gate (PyTorch's equations), so the two biases
    cannot be one. Gates stand in the order reset, update, new.
    """

    features: int
    backward: bool

    @nn.compact
    def __call__(
        self, inputs: Float[Array, "B S X"], mask: Bool[Array, "B S"], initial: Float[Array, "1 H"]
    ) -> Float[Array, "B H"]:
        """Returns the state after the last step that is read; where the mask is False the state stays as it is."""
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
    """Both directions of a GRU, each from an initial state that is learned."""

    features: int

    @nn.compact
    def __call__(self, inputs: Float[Array, "B S X"], lengths: Int[Array, " B"]) -> Float[Array, "B W"]:
        """Returns the last states, forward beside backward, of reading the first `lengths[b]` steps.

        The backward direction begins at the last of them. What stands behind has no influence; of a sequence of length
        0 the initial states come back.
        """
        # Weights read from a file are NumPy's.
        initial = jnp.asarray(self.param("initial_state", nn.initializers.normal(1.0), (2, 1, self.features)))
        mask = mask_from_lengths(lengths, inputs.shape[1])
        forward = GruDirection(self.features, backward=False, name="forward")(inputs, mask, initial[0])
        backward = GruDirection(self.features, backward=True, name="backward")(inputs, mask, initial[1])
        return jnp.concatenate([forward, backward], axis=-1)
