"""A bidirectional GRU that reads sequences of different lengths, like PyTorch's GRU with packed sequences."""

import flax.linen as nn
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from t2m_jax.masks import mask_from_lengths
from t2m_jax.models.convolution import uniform_init


def next_state(
    state: Float[Array, "B H"], gates: Float[Array, "B W"], recurrent: Float[Array, "B W"], is_read: Bool[Array, " B"]
) -> Float[Array, "B H"]:
    """Returns the next state of a GRU for what the input and the state give its gates: reset, update, new.

    As in PyTorch, the recurrent part of the new gate is multiplied by the reset gate, so its bias cannot be merged with
    the input bias. The state does not change where `is_read` is False.
    """
    reset, update, new = jnp.split(gates, 3, axis=-1)
    reset_by, update_by, new_by = jnp.split(recurrent, 3, axis=-1)
    kept = nn.sigmoid(update + update_by)
    proposal = jnp.tanh(new + nn.sigmoid(reset + reset_by) * new_by)
    return jnp.where(is_read[:, None], (1 - kept) * proposal + kept * state, state)


@jax.custom_vjp
def last_state(
    first: Float[Array, "B H"],
    gates: Float[Array, "S B W"],
    mask: Bool[Array, "S B"],
    kernel: Float[Array, "H W"],
    bias: Float[Array, " W"],
) -> Float[Array, "B H"]:
    """Returns the state of a GRU after all steps.

    The gradient of the recurrent weights is one product after the loop. JAX's own gradient adds it up inside, which is
    slower, and exchanges it between devices at every step.
    """
    return _all_states(first, gates, mask, kernel, bias)[0]


def _all_states(first: Array, gates: Array, mask: Array, kernel: Array, bias: Array) -> tuple[Array, Array]:
    """Returns the last state, and the state before each step."""

    def step(state: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        return next_state(state, now[0], state @ kernel + bias[None], now[1]), state

    return jax.lax.scan(step, first, (gates, mask))


def _forward(first: Array, gates: Array, mask: Array, kernel: Array, bias: Array) -> tuple[Array, tuple[Array, ...]]:
    last, states = _all_states(first, gates, mask, kernel, bias)
    return last, (states, gates, mask, kernel, bias)


def _backward(kept: tuple[Array, ...], gradient: Array) -> tuple[Array, Array, None, Array, Array]:
    states, gates, mask, kernel, bias = kept

    def step(gradient: Array, now: tuple[Array, Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        state, gate, is_read = now
        recurrent = state @ kernel + bias[None]
        _, pull = jax.vjp(lambda h, g, r: next_state(h, g, r, is_read), state, gate, recurrent)
        of_state, of_gates, of_recurrent = pull(gradient)
        return of_state + of_recurrent @ kernel.T, (of_gates, of_recurrent)

    of_first, (of_gates, of_recurrent) = jax.lax.scan(step, gradient, (states, gates, mask), reverse=True)
    # One product over all steps and sequences, after the loop.
    of_kernel = jnp.einsum("sbh,sbw->hw", states, of_recurrent)
    return of_first, of_gates, None, of_kernel, of_recurrent.sum((0, 1))


last_state.defvjp(_forward, _backward)


class GruDirection(nn.Module):
    """One direction of a GRU."""

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
        # Weights that were read from a file are NumPy arrays.
        kernel = jnp.asarray(self.param("recurrent_kernel", initializer, (width, 3 * width)))
        bias = jnp.asarray(self.param("recurrent_bias", initializer, (3 * width,)))
        first = jnp.broadcast_to(initial, (inputs.shape[0], width))
        # Padding is at the end: read backward it comes first, and leaves the initial state as it is.
        order = slice(None, None, -1 if self.backward else 1)
        return last_state(first, jnp.swapaxes(gates, 0, 1)[order], mask.T[order], kernel, bias)


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
