"""What is attacked: intact files, and the functions that read them."""

import csv
import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from t2m_jax.bench import load_report as load_bench_report
from t2m_jax.bench import save_report as save_bench_report
from t2m_jax.checkpoints.bundle import load_bundle, load_bundle_config, save_bundle
from t2m_jax.checkpoints.clip import read_clip_config
from t2m_jax.checkpoints.evaluator import load_trained_evaluator, save_evaluator
from t2m_jax.checkpoints.run import run_info
from t2m_jax.checkpoints.sentence import load_sentence_tokenizer, read_sentence_config
from t2m_jax.checkpoints.tokenizer import load_tokenizer
from t2m_jax.checkpoints.torch_file import load_torch_file
from t2m_jax.config import load_config
from t2m_jax.data import open_dataset
from t2m_jax.data.audit import audit_dataset
from t2m_jax.data.files import read_names
from t2m_jax.data.importers.caption_table import load_caption_table
from t2m_jax.data.importers.synthetic import make_motion, write_synthetic_dataset
from t2m_jax.data.index import IndexEntry, load_index, save_index
from t2m_jax.data.texts import load_captions
from t2m_jax.evaluation.report.record import Header, load_report
from t2m_jax.evaluation.run import load_partial
from t2m_jax.files.arrays import read_arrays
from t2m_jax.files.manifest import read_manifest
from t2m_jax.motion.amc import load_amc
from t2m_jax.motion.character import load_character
from t2m_jax.motion.formats import load_motion
from t2m_jax.motion.gltf import load_gltf
from t2m_jax.motion.motion import Motion
from t2m_jax.motion.normalizer import load_normalizer
from t2m_jax.motion.rig.rigs import load_rig
from t2m_jax.motion.skeleton import HUMANML3D
from t2m_jax.text.bpe import load_bpe, load_clip_bpe
from t2m_jax.text.word_vectors import load_vocabulary, load_word_vectors
from t2m_jax.train import TrainVqVaeConfig, train
from t2m_jax.train.log import _keep_rows
from tests.bench.conftest import report as bench_report
from tests.data.bvh_files import write_bvh
from tests.motion.acclaim_files import write_acclaim
from tests.motion.character_files import write_character
from tests.motion.glb_files import edited, name_bones, write_person
from tests.motion.rig.test_retarget import BANDAI
from tests.tiny import LOOP, random_bundle, random_evaluator, vqvae_training

GOLDEN = Path(__file__).parents[1] / "golden"
GLB_ARM = {"Root": (None, (0.0, 100.0, 0.0)), "Arm": ("Root", (50.0, 0.0, 0.0)), "Hand": ("Arm", (0.0, 0.0, 20.0))}
HEADER = {"protocol": "strict", "data": "d_1", "split": "test", "evaluator": "ab%c", "weights": "ab", "contents": "cd"}
HEADER |= {"num_samples": 64, "seed": 0, "unit": 4, "batch": 32}
METRIC = {"mean": 1.5, "interval": 0.5, "repeats": [1.0, 2.0]}
WALK = Motion(positions=make_motion("walk", seed=1, num_frames=8), fps=20.0)
CAPTIONS = "a man waves.#a/DET man/NOUN wave/VERB#0.0#0.0\nhe turns left#he/PRON turn/VERB left/ADV#0.5#2.5\n"


def make_files(root: Path) -> None:
    """Writes one intact file or folder for each target."""
    save_bundle(root / "bundle", random_bundle(), card="# tiny\n")
    save_evaluator(root / "evaluator", random_evaluator())
    write_synthetic_dataset(root / "data", num_clips=20, seed=3)
    audit_dataset(root / "data")
    train(vqvae_training(root / "data", root / "run", loop=LOOP))
    shutil.copytree(root / "run", root / "checkpoint", ignore=shutil.ignore_patterns("best", "best.yaml", "4"))
    _make_motions(root)
    _make_texts(root)
    for name in ("full", "text_only"):
        shutil.copytree(GOLDEN / "clip" / name, root / "clip" / name)
    shutil.copytree(GOLDEN / "sentence" / "bert", root / "sentence")
    for path in (GOLDEN / "torch").iterdir():
        shutil.copy(path, root / path.name)


def _make_motions(root: Path) -> None:
    write_bvh(root / "motion.bvh", num_frames=4)
    write_person(root / "motion.glb", GLB_ARM, {"quarter": 90.0})
    for folder in ("amc", "asf"):
        (root / folder).mkdir()
        write_acclaim(root / folder)
    parts = {"part_starts": (0, 4), "part_captions": ("a person walks", "somebody waves")}
    walk = dataclasses.replace(WALK, **parts)
    walk.save(root / "motion.npz")
    walk.save(root / "amass.npz", names="smpl")
    walk.save(root / "own.glb")
    walk.save(root / "own.bvh")
    # Joints that no table knows, and an animation without a skin.
    (root / "foreign.bvh").write_text(
        (root / "own.bvh").read_text().replace("Left", "char_L_").replace("Right", "char_R_")
    )
    vrm = write_person(root / "vrm.glb", BANDAI, {"quarter": 90.0})
    edited(vrm, lambda tree: (tree.pop("skins"), name_bones(tree, "VRMC_vrm_animation")))
    write_character(root / "hero.glb", BANDAI)
    np.save(root / "joints.npy", make_motion("walk", seed=1, num_frames=4).astype(np.float32))


def _make_texts(root: Path) -> None:
    (root / "captions.txt").write_text(CAPTIONS)
    (root / "table.txt").write_text("walk: a person walks\nwave\ta man waves twice\n")
    with (root / "table.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["file", "caption", "start", "end"], ["walk.bvh", "a person walks", "0", "1.5"]])
    save_index(root, [IndexEntry("a", "one, two.bvh", "turn-left, happy"), IndexEntry("b", "b.bvh", "")])
    (root / "rig.yaml").write_text("".join(f"{joint}: [{joint}, a {joint}]\n" for joint in HUMANML3D.joint_names))
    (root / "glove.txt").write_text("walk 0.1 0.2 -0.3\nman 1e-3 0 4\n")
    rows = {"real": {"fid": METRIC}, "generated": {"fid": METRIC}}
    (root / "report.json").write_text(json.dumps(HEADER | {"rows": rows}))
    save_bench_report(root / "bench.json", bench_report())
    (root / "partial.json").write_text(
        json.dumps({"header": dataclasses.asdict(Header(**HEADER)), "repeats": [[{"fid": 1.0}, {"fid": 2.0}]] * 2})
    )


def read_partial(path: Path) -> object:
    return load_partial(path, Header(**HEADER))


def read_character(path: Path) -> object:
    return load_character(path).save(path.with_name("moved.glb"), [WALK])


def read_sentence_tokens(folder: Path) -> object:
    return load_sentence_tokenizer(folder, read_sentence_config(folder)).encode("a man waves").ids


FILES: Mapping[str, Callable[[Path], object]] = {
    "motion.bvh": lambda root: load_motion(root / "motion.bvh"),
    "motion.glb": lambda root: load_gltf(root / "motion.glb"),
    "amc/02_01.amc": lambda root: load_amc(root / "amc" / "02_01.amc"),
    "asf/02.asf": lambda root: load_amc(root / "asf" / "02_01.amc"),
    "own.glb": lambda root: load_motion(root / "own.glb"),
    "foreign.bvh": lambda root: load_motion(root / "foreign.bvh"),
    "vrm.glb": lambda root: load_motion(root / "vrm.glb"),
    "hero.glb": lambda root: read_character(root / "hero.glb"),
    "own.bvh": lambda root: load_motion(root / "own.bvh"),
    "motion.npz": lambda root: load_motion(root / "motion.npz"),
    "amass.npz": lambda root: load_motion(root / "amass.npz"),
    "joints.npy": lambda root: load_motion(root / "joints.npy"),
    "captions.txt": lambda root: load_captions(root / "captions.txt"),
    "table.txt": lambda root: load_caption_table(root / "table.txt"),
    "table.csv": lambda root: load_caption_table(root / "table.csv"),
    "index.csv": load_index,
    "rig.yaml": lambda root: load_rig(root / "rig.yaml"),
    "glove.txt": lambda root: load_word_vectors(root / "glove.txt", ("walk", "man", "she")),
    "report.json": lambda root: load_report(root / "report.json"),
    "partial.json": lambda root: read_partial(root / "partial.json"),
    "bench.json": lambda root: load_bench_report(root / "bench.json"),
    "zip.pth": lambda root: load_torch_file(root / "zip.pth"),
    "legacy.tar": lambda root: load_torch_file(root / "legacy.tar"),
    "protocol4.pth": lambda root: load_torch_file(root / "protocol4.pth"),
    "bundle/bundle.yaml": lambda root: load_bundle_config(root / "bundle"),
    "bundle/Mean.npy": lambda root: load_normalizer(root / "bundle"),
    "bundle/tokenizer.json": lambda root: load_bpe(root / "bundle"),
    "bundle/weights.safetensors": lambda root: read_arrays(root / "bundle" / "weights.safetensors"),
    "bundle/manifest.txt": lambda root: read_manifest(root / "bundle"),
    "evaluator/words.txt": lambda root: load_vocabulary(root / "evaluator" / "words.txt"),
    "data/train.txt": lambda root: read_names(root / "data" / "train.txt"),
    "data/dataset.yaml": lambda root: open_dataset(root / "data"),
    "run/config.yaml": lambda root: load_config(root / "run" / "config.yaml", TrainVqVaeConfig),
    "run/run.yaml": lambda root: run_info(root / "run"),
    "run/train.csv": lambda root: _keep_rows(root / "run" / "train.csv", 4),
    "clip/full/config.json": lambda root: read_clip_config(root / "clip" / "full"),
    "clip/full/tokenizer.json": lambda root: load_clip_bpe(root / "clip" / "full"),
    "sentence/config.json": lambda root: read_sentence_config(root / "sentence"),
    "sentence/modules.json": lambda root: read_sentence_config(root / "sentence"),
    "sentence/1_Pooling/config.json": lambda root: read_sentence_config(root / "sentence"),
    "sentence/tokenizer.json": lambda root: read_sentence_tokens(root / "sentence"),
}
"""Files that are read into memory, below the folder that `make_files` fills -> what reads them."""


def read_bundle(root: Path) -> dict[str, Any]:
    bundle = load_bundle(root / "bundle")
    return dict(bundle.variables) | bundle.normalizer._asdict()


def read_evaluator(root: Path) -> dict[str, Any]:
    evaluator = load_trained_evaluator(root / "evaluator")
    return evaluator.variables | evaluator.normalizer._asdict()


def read_clips(root: Path) -> dict[str, Any]:
    return {clip.name: clip.features for clip in open_dataset(root / "data").clips("train")}


FOLDERS: Mapping[str, Callable[[Path], dict[str, Any]]] = {
    "bundle": read_bundle,
    "evaluator": read_evaluator,
    "run/best/8": lambda root: load_tokenizer(root / "run").variables,
    "checkpoint/checkpoints/8": lambda root: load_tokenizer(root / "checkpoint").variables,
    "data/.t2m-cache": read_clips,
}
"""Folders of several files -> what returns the arrays in them."""
