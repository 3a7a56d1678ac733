"""A 1-D convolution whose gradient is as fast inside a compiled loop as outside, also on a CPU.

XLA's CPU backend has a fast convolution for one order of the axes. The gradient that JAX derives has other orders.
Outside of loops, XLA transposes them. Inside `while_loop` and `scan` it does not, and the gradient takes a hundred
times longer (https://github.com/jax-ml/jax/issues/12868). So on a CPU, this module writes the gradient in the fast
order.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_LAYOUT = ("NHC", "HIO", "NHC")
"""The fast order of axes: inputs (clips, positions, channels), kernel (taps, channels in, out), outputs as inputs."""


class Window(NamedTuple):
    """Which inputs a convolution reads."""

    stride: int
    dilation: int
    padding: int
    """Number of zeros at each end of the sequence."""


def general_convolution(
    inputs: Float[Array, "B T X"], kernel: Float[Array, "K X Y"], window: Window
) -> Float[Array, "B U Y"]:
    """Returns the convolved sequence, with the gradient that JAX derives."""
    return jax.lax.conv_general_dilated(
        inputs,
        kernel,
        (window.stride,),
        [(window.padding, window.padding)],
        rhs_dilation=(window.dilation,),
        dimension_numbers=_LAYOUT,
    )


@functools.partial(jax.custom_vjp, nondiff_argnums=(2,))
def loop_convolution(
    inputs: Float[Array, "B T X"], kernel: Float[Array, "K X Y"], window: Window
) -> Float[Array, "B U Y"]:
    """Returns the same as `general_convolution`, with a gradient that is fast in loops on a CPU."""
    return general_convolution(inputs, kernel, window)


def _loop_convolution_backward(
    window: Window, arguments: tuple[Float[Array, "B T X"], Float[Array, "K X Y"]], gradient: Float[Array, "B U Y"]
) -> tuple[Float[Array, "B T X"], Float[Array, "K X Y"]]:
    """Returns the gradients of inputs and kernel from the gradient of the output."""
    inputs, kernel = arguments
    stride, dilation, padding = window
    reach = dilation * (kernel.shape[0] - 1)  # from the first tap of an output to its last tap
    last_read = stride * (gradient.shape[1] - 1) + reach - padding  # by the last tap of the last output
    zeros_after = last_read - (inputs.shape[1] - 1)  # negative if a stride leaves inputs at the end unread
    # The outputs that read an input, in ascending order, did so with the taps in descending order.
    input_gradient = jax.lax.conv_general_dilated(
        gradient,
        kernel[::-1].transpose(0, 2, 1),
        (1,),
        [(reach - padding, reach - zeros_after)],
        lhs_dilation=(stride,),
        rhs_dilation=(dilation,),
        dimension_numbers=_LAYOUT,
    )
    # The gradient of a tap is a product of inputs and output gradient, summed over clips and positions. So the clips
    # are the input channels of this convolution.
    kernel_gradient = jax.lax.conv_general_dilated(
        inputs.transpose(2, 1, 0),
        gradient.transpose(1, 0, 2),
        (dilation,),
        [(padding, zeros_after)],
        rhs_dilation=(stride,),
        dimension_numbers=_LAYOUT,
    )
    return input_gradient, kernel_gradient.transpose(1, 0, 2)


loop_convolution.defvjp(
    lambda inputs, kernel, window: (general_convolution(inputs, kernel, window), (inputs, kernel)),
    _loop_convolution_backward,
)


def convolve(
    inputs: Float[Array, "B T X"],
    kernel: Float[Array, "K X Y"],
    *,
    stride: int = 1,
    dilation: int = 1,
    padding: int = 0,
) -> Float[Array, "B U Y"]:
    """Returns the convolved sequence. On a CPU, it cannot be differentiated in forward mode.

    Args:
        inputs: The sequences.
        kernel: One matrix per tap, in the dtype of the inputs.
        stride: Distance of the positions that are kept.
        dilation: Distance of the taps.
        padding: Number of zeros at each end.
    """
    form = loop_convolution if jax.default_backend() == "cpu" else general_convolution
    return form(inputs, kernel, Window(stride, dilation, padding))


def convolve_repeated(inputs: Float[Array, "B N X"], kernel: Float[Array, "3 X Y"]) -> Float[Array, "B 2*N Y"]:
    """Returns the sequence in which every position is repeated, convolved with a zero at each end.

    Of three neighbors in the repeated sequence, two are equal. So their taps can be added before the convolution, which
    saves a third of the products.
    """
    before, at, after = kernel
    # Output i has two parts: the second copy of position i - 1, and the first copy of position i.
    first_tap = jnp.concatenate([before + at, before], axis=1)
    last_tap = jnp.concatenate([after, at + after], axis=1)
    # Padded here and not by the convolution: XLA would swap the operands of a kernel gradient whose outputs are longer
    # than its inputs, and then use a slow convolution.
    padded = jnp.pad(inputs, ((0, 0), (1, 1), (0, 0)))
    pairs = convolve(padded, jnp.stack([first_tap, last_tap]))
    return pairs.reshape(inputs.shape[0], -1, kernel.shape[2])[:, 1:-1]
