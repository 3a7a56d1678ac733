"""Plants faults in copies of the package, one at a time, and checks that fast tests find each (`make faults`).

python -m tests.faults          # all
python -m tests.faults mirror   # those whose name contains the word
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).parents[1]
COPIED = ("t2m_jax", "tests", "configs", "pyproject.toml")


class Fault(NamedTuple):
    """A mistake that somebody could make."""

    name: str
    file: str
    """In `t2m_jax`."""
    right: str
    """What the file has once."""
    wrong: str
    test: str
    """The fast test that finds it; names of pytest, relative to `tests`."""


FAULTS = (
    Fault(
        "a causal mask sees one token ahead",
        "models/transformer.py",
        "jnp.tril(jnp.ones((1, 1, hidden.shape[1], hidden.shape[1]), bool))",
        "jnp.tril(jnp.ones((1, 1, hidden.shape[1], hidden.shape[1]), bool), 1)",
        "sampling/test_loop.py::test_cached_equals_uncached",
    ),
    Fault(
        "a softmax over the queries",
        "models/transformer.py",
        "nn.softmax(jnp.where(mask, scores, -jnp.inf))",
        "nn.softmax(jnp.where(mask, scores, -jnp.inf), axis=-2)",
        "models/test_golden_gpt.py",
    ),
    Fault(
        "a mirror keeps left joints left",
        "motion/mirroring.py",
        "order[list(pair)] = pair[::-1]",
        "order[list(pair)] = pair",
        "motion/test_mirroring.py",
    ),
    Fault(
        "a lock that excludes nobody",
        "files/locks.py",
        "        holder.acquire(timeout=seconds)\n",
        "        pass\n",
        "test_files.py",
    ),
    Fault(
        "one key for all samples of a caption",
        "sampling/prompts.py",
        "return jax.random.fold_in(key, sample)",
        "return jax.random.fold_in(key, 0)",
        "sampling/test_pipeline.py::test_sample_keys_are_distinct",
    ),
    Fault(
        "a stop rule that keeps one row too many",
        "sampling/stopping.py",
        "jnp.argmax(ends, axis=1) + self.keeps_last",
        "jnp.argmax(ends, axis=1) + 1",
        "sampling/test_stopping.py",
    ),
    Fault(
        "an inverted decay of the codebook's averages",
        "models/codebook.py",
        "kept = decay if rule.averages else 0.0",
        "kept = 1.0 - decay if rule.averages else 0.0",
        "models/test_golden_rvq.py::test_codebook_updates",
    ),
    Fault(
        "a covariance that is not centered",
        "metrics/frechet.py",
        "(embeddings - jnp.mean(embeddings, axis=0, keepdims=True))",
        "embeddings",
        "metrics/test_frechet.py",
    ),
    Fault(
        "a code that is one too large",
        "sampling/model.py",
        "codes.max() >= config.num_codes",
        "codes.max() > config.num_codes",
        "sampling/test_pipeline.py::test_codes_out_of_range_are_refused",
    ),
    Fault(
        "files with Z up turned upside down",
        "motion/rig/orientation.py",
        "positions[..., [0, 2, 1]] * np.array([1, 1, -1], positions.dtype)",
        "positions[..., [0, 2, 1]] * np.array([1, -1, 1], positions.dtype)",
        "motion/rig/test_orientation.py",
    ),
    Fault(
        "a mean over padding, too",
        "masks.py",
        "total / jnp.maximum(count, 1)",
        "total / values.size",
        "test_masks.py",
    ),
    Fault(
        "a cross-fade that runs backwards",
        "motion/inertialization.py",
        "    return time**2 * (3 - 2 * time)\n",
        "    return 1 - time**2 * (3 - 2 * time)\n",
        "motion/test_joining.py",
    ),
)


def is_found(fault: Fault, tree: Path) -> tuple[bool, str]:
    """Returns whether the test, which passes in the suite, fails with the fault, and what pytest said last."""
    path = tree / "t2m_jax" / fault.file
    text = path.read_text(encoding="utf-8")
    assert text.count(fault.right) == 1, f"{fault.file} does not have this once: {fault.right}"
    path.write_text(text.replace(fault.right, fault.wrong), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n0", "-m", "not slow", f"{tree / 'tests' / fault.test}"]
    # The copy comes before the package that is installed.
    run = subprocess.run(
        command, cwd=tree, env=os.environ | {"PYTHONPATH": f"{tree}"}, capture_output=True, text=True, check=False
    )
    path.write_text(text, encoding="utf-8")
    failed = [line.split(" - ")[0] for line in run.stdout.splitlines() if line.startswith("FAILED ")]
    return run.returncode == 1 and bool(failed), (failed or run.stdout.splitlines() or [run.stderr])[-1]


def main(words: list[str]) -> int:
    """Prints a line for each fault, and returns how many were not found."""
    chosen = [fault for fault in FAULTS if all(word in fault.name for word in words)]
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in COPIED:
            source = REPOSITORY / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, tree / name)
        for fault in chosen:
            found, said = is_found(fault, tree)
            missed += not found
            print(f"{'found ' if found else 'MISSED'}  {fault.name}: {said}", flush=True)
    return missed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
