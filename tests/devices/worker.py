"""A program of its own for tests with several devices or processes, which must be chosen before JAX starts.

`python -m tests.devices.worker TASK FOLDER [name=value]...` works in a folder with data and finished runs.
"""

import dataclasses
import functools
import os
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.tree_util import keystr

from t2m_jax.data.banks.motions import MotionBank, batch_at
from t2m_jax.sampling import TextToMotion, encode_motions
from t2m_jax.train import LoopConfig, train
from t2m_jax.train.config import ExperimentConfig, ShardingConfig
from t2m_jax.train.evaluator_config import TrainEvaluatorConfig
from t2m_jax.train.experiment import find_trainer
from t2m_jax.train.movement import init_movement_state, update_movements
from t2m_jax.train.program import Devices, Update
from t2m_jax.train.streams import stream_key
from tests import tiny

NUM_UPDATES, BATCH = 20, 8
KINDS = ("vqvae", "gpt", "movement", "evaluator")
"""What T2M-GPT and its evaluation train."""
LOOP = LoopConfig(num_steps=NUM_UPDATES, batch_size=BATCH, seed=5, log_every=1, checkpoint_every=4, validate_every=0)
WAYS = {
    "one": ShardingConfig(devices=1),
    "jit": ShardingConfig(),
    "pmap": ShardingConfig(mode="pmap"),
    "shares": ShardingConfig(optimizer="sharded", bank="sharded"),
}


def configs(folder: Path) -> dict[str, ExperimentConfig]:
    """Returns one training of each kind; the batch norm of the VQ-VAE sees all devices, too."""
    vqvae = tiny.vqvae_training(folder / "data", folder / "none", loop=LOOP)
    gpt = tiny.gpt_training(folder / "data", folder / "vqvae", folder / "none", loop=LOOP)
    hifigpt = tiny.hifigpt_training(folder / "data", folder / "rvqvae", folder / "none", loop=LOOP)
    model = dataclasses.replace(vqvae.model, norm="BN", num_stages=1)
    return {
        "vqvae": dataclasses.replace(vqvae, model=model, window=16),
        "gpt": dataclasses.replace(gpt, model=dataclasses.replace(gpt.model, num_layers=1)),
        "evaluator": TrainEvaluatorConfig(
            data=folder / "data", run=folder / "none", init=folder / "evaluator", model=tiny.EVALUATOR, loop=LOOP
        ),
        "rvqvae": tiny.rvqvae_training(folder / "data", folder / "none", loop=LOOP),
        "hifigpt": dataclasses.replace(hifigpt, contrastive_weight=0.5),
    }


def weights_with_gradient(params: Any) -> np.ndarray:
    """Returns all weights in one row, but for biases that a batch norm takes away again.

    The gradients of these are nothing but rounding, which AdamW scales up to whole steps.
    """
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return np.concatenate([leaf.ravel() for path, leaf in leaves if "['dilated']['conv']['bias']" not in keystr(path)])


def train_in_memory(folder: Path, ways: list[str]) -> dict[str, np.ndarray]:
    """Returns losses, codebooks and other state after some updates of each kind, for each way to use the devices.

    A way such as `gpt:pmap` is for one kind only; others are for `KINDS`. Compiling takes most of the time.
    """
    found: dict[str, np.ndarray] = {}
    ways = [way if ":" in way else f"{kind}:{way}" for way in ways for kind in (KINDS if ":" not in way else [""])]
    for kind, config in configs(folder).items():
        if not any(way.startswith(f"{kind}:") for way in ways):
            continue
        setup = find_trainer(kind).prepare(find_trainer(kind).resolve(config, False), False)
        trainings: dict[str, Any] = {kind: (setup.update, setup.init, setup.data)}
        if kind == "evaluator":
            movements = dataclasses.replace(config, movement_batch_size=BATCH, run=Path())
            bank: MotionBank = setup.data.motions
            init = functools.partial(init_movement_state, movements, stream_key(LOOP.seed, "movements"))
            trainings["movement"] = (Update(update_movements, config=movements), init, bank)
        for name, (update, init, data) in trainings.items():
            for way in [way.removeprefix(f"{name}:") for way in ways if way.startswith(f"{name}:")]:
                devices = Devices(WAYS[way], batch_size=BATCH)
                state = devices.put_state(init())
                state, metrics = devices.run(update, state, devices.put_data(data), NUM_UPDATES, size=NUM_UPDATES)
                found |= {f"{way} {name} {metric}": np.asarray(values) for metric, values in metrics.items()}
                found[f"{way} {name} weights"] = weights_with_gradient(jax.device_get(state.params))
                if name.endswith("vqvae"):
                    found[f"{way} {name} codebook"] = np.asarray(state.codebook["quantizer"]["codebook"])
                    found[f"{way} {name} hits"] = np.asarray(state.codebook["quantizer"]["ema_count"])
    return found


def train_and_die(folder: Path, *, devices: int, at: int) -> None:
    """Trains on some devices until `at` updates are made, then ends without any warning."""
    run = Devices.run

    def run_until_death(self: Devices, update: Any, state: Any, data: Any, count: int, *, size: int) -> Any:
        if int(state.step) >= at:
            os._exit(9)
        return run(self, update, state, data, count, size=size)

    Devices.run = run_until_death
    continue_training(folder, devices=devices, until=NUM_UPDATES, resume=False)


def continue_training(folder: Path, *, devices: int, until: int, resume: bool = True) -> None:
    """Trains the VQ-VAE of `folder/run` on some devices until `until` updates are made."""
    config = dataclasses.replace(configs(folder)["vqvae"], run=folder / "run")
    sharding = ShardingConfig(devices=devices, optimizer="sharded" if devices > 1 else "replicated")
    train(
        dataclasses.replace(config, sharding=sharding, loop=dataclasses.replace(LOOP, num_steps=until)), resume=resume
    )


def cut_on_devices(folder: Path) -> None:
    """Checks that a batch is divided where it is cut: every device has its rows and no others."""
    config = configs(folder)["vqvae"]
    setup = find_trainer("vqvae").prepare(config, False)
    cut = jax.jit(functools.partial(batch_at, batch_size=BATCH, window=16))
    for way in ("jit", "shares"):
        devices = Devices(WAYS[way], batch_size=BATCH)
        data = devices.put_data(setup.data)
        windows = devices.measure(cut, data, jax.random.key(0), np.int32(3))
        expected = cut(setup.data, jax.random.key(0), np.int32(3))
        for whole, divided in zip(expected, windows, strict=True):
            assert [shard.data.shape[0] for shard in divided.addressable_shards] == [1] * BATCH, divided.sharding
            np.testing.assert_array_equal(divided, whole)
    frames = data.frames.rows
    assert {shard.data.shape[0] for shard in frames.addressable_shards} == {len(frames) // 8}
    state = devices.put_state(setup.init())
    moments = [leaf for leaf in jax.tree.leaves(state.opt_state) if leaf.size % 8 == 0 and leaf.size >= 64]
    assert moments and all(leaf.addressable_shards[0].data.size == leaf.size // 8 for leaf in moments)


def generate(folder: Path) -> None:
    """Generates motions and encodes them again, both in batches that all devices share."""
    tokenizer = dataclasses.replace(tiny.VQVAE, num_stages=1)
    generator = dataclasses.replace(tiny.GPT, num_layers=1)
    model = TextToMotion(tiny.random_bundle(dataclasses.replace(tiny.BUNDLE, tokenizer=tokenizer, generator=generator)))
    captions = [f"{caption} {number}" for number in range(8) for caption in tiny.CAPTIONS[:2]]
    motions = model.generate(captions, seed=1, raw=True)  # codes and features only: the clean-up takes long to compile
    codes = encode_motions(model.tokenizer, [motion.features for motion in motions if len(motion.features) >= 4])
    found = {f"generated {number}": motion.codes for number, motion in enumerate(motions)}
    np.savez(
        folder / f"{jax.device_count()}.npz", **found, **{f"encoded {number}": c for number, c in enumerate(codes)}
    )


def main() -> None:
    """Runs a task."""
    task, folder, options = sys.argv[1], Path(sys.argv[2]), dict(option.split("=") for option in sys.argv[3:])
    jax.config.update("jax_num_cpu_devices", int(options.get("local", 8)))
    jax.config.update("jax_numpy_rank_promotion", "raise")
    if "process" in options:
        number = int(options["process"])
        jax.distributed.initialize(f"127.0.0.1:{options['port']}", num_processes=2, process_id=number)
    if task == "memory":
        found = train_in_memory(folder, options["ways"].split(","))
        if jax.process_index() == 0:
            np.savez(folder / f"{options['name']}.npz", **found)
    elif task == "cut":
        cut_on_devices(folder)
    elif task == "generate":
        generate(folder)
    elif task == "die":
        train_and_die(folder, devices=int(options["devices"]), at=int(options["at"]))
    elif task == "resume":
        continue_training(folder, devices=int(options["devices"]), until=int(options["until"]))


if __name__ == "__main__":
    main()
