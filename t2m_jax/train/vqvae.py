"""Training of the VQ-VAE: state, one pure step, validation."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, Key

from t2m_jax.data.banks.motions import Windows
from t2m_jax.losses import reconstruction_loss, velocity_loss
from t2m_jax.models.quantizer import perplexity_from_counts
from t2m_jax.models.vqvae import VqVae, VqVaeOutput
from t2m_jax.motion.skeleton import skeleton_from_feature_dim
from t2m_jax.train.config import TrainVqVaeConfig
from t2m_jax.train.optimizer import make_optimizer

Metrics = dict[str, Float[Array, ""]]


class VqVaeState(NamedTuple):
    """Everything an update changes."""

    step: Int[Array, ""]
    params: Any
    codebook: Any
    """Empty where the codebook is a parameter."""
    batch_stats: Any
    """Running statistics of norm `BN`, empty with others."""
    opt_state: optax.OptState

    @property
    def variables(self) -> dict[str, Any]:
        """The collections as the model takes them."""
        return {"params": self.params, "codebook": self.codebook, "batch_stats": self.batch_stats}


@functools.partial(jax.jit, static_argnames="config")
def init_vqvae_state(config: TrainVqVaeConfig, key: Key[Array, ""]) -> VqVaeState:
    """Returns the state before the first update; `key` is consumed."""
    motion = jnp.zeros((1, config.window, config.model.feature_dim))
    variables = VqVae(config.model).init(key, motion, train=False)
    opt_state = make_optimizer(config.optimizer).init(variables["params"])
    codebook, batch_stats = variables.get("codebook", {}), variables.get("batch_stats", {})
    return VqVaeState(jnp.array(0, jnp.int32), variables["params"], codebook, batch_stats, opt_state)


def vqvae_losses(output: VqVaeOutput, windows: Windows, config: TrainVqVaeConfig) -> Metrics:
    """Returns the terms of the loss and their weighted sum, `loss`."""
    positions = skeleton_from_feature_dim(config.model.feature_dim).layout.positions
    motion = windows.motion[:, : output.reconstruction.shape[1]]
    mask = windows.mask[:, : output.reconstruction.shape[1]]
    everything = reconstruction_loss(output.reconstruction, motion, mask, kind=config.reconstruction)
    velocity = velocity_loss(
        output.reconstruction,
        motion,
        mask,
        kind=config.reconstruction,
        velocity=config.velocity,
        positions=positions,
    )
    loss = everything + config.velocity_weight * velocity + config.commitment_weight * output.commitment_loss
    return {
        "loss": loss,
        "reconstruction": everything,
        "velocity": velocity,
        "commitment": output.commitment_loss,
        "perplexity": perplexity_from_counts(output.code_counts),
    }


def vqvae_train_step(
    state: VqVaeState, windows: Windows, key: Key[Array, ""], *, config: TrainVqVaeConfig
) -> tuple[VqVaeState, Metrics]:
    """Returns the state after one update and the metrics before it; `key` is consumed."""
    model = VqVae(config.model)

    def objective(params: Any) -> tuple[Float[Array, ""], tuple[Any, Metrics]]:
        output, updates = model.apply(
            state.variables | {"params": params},
            windows.motion,
            windows.mask,
            train=True,
            rngs={"codebook": key},
            mutable=["codebook", "batch_stats"],
        )
        metrics = vqvae_losses(output, windows, config)
        return metrics["loss"], (updates, metrics)

    (_, (moved, metrics)), gradient = jax.value_and_grad(objective, has_aux=True)(state.params)
    updates, opt_state = make_optimizer(config.optimizer).update(gradient, state.opt_state, state.params)
    params = optax.apply_updates(state.params, updates)
    codebook, batch_stats = moved.get("codebook", {}), moved.get("batch_stats", {})
    return VqVaeState(state.step + 1, params, codebook, batch_stats, opt_state), metrics


def vqvae_validation_step(state: VqVaeState, windows: Windows, *, config: TrainVqVaeConfig) -> Metrics:
    """Returns the losses on held-out windows; nothing is learned."""
    output = VqVae(config.model).apply(state.variables, windows.motion, windows.mask, train=False)
    return vqvae_losses(output, windows, config)
