"""The parts of `sh docs/measure/accelerator.sh` that are not commands of `t2m`.

python docs/measure/accelerator.py PART FOLDER [--small]
"""

import argparse
import csv
import dataclasses
import datetime
import functools
import itertools
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from t2m_jax.bench import benchmark_sampling, benchmark_training, load_report, report_text, save_report
from t2m_jax.bench.probes import describe_machine, first_devices, measure_peaks
from t2m_jax.bench.record import BenchReport, BenchResult, Peaks
from t2m_jax.bench.sample import MeasuredSystem, full_size_systems
from t2m_jax.bench.timing import peak_memory
from t2m_jax.bench.train import make_training
from t2m_jax.config import config_to_dict
from t2m_jax.evaluation import action_tests
from t2m_jax.files.markdown import markdown_table
from t2m_jax.sampling import TextToMotion

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("gpt", "vqvae", "hifigpt", "rvqvae")
"""The most important ones first, because time may run out. This also holds for `steps`."""
PRODUCTS = {"default": "default products of the device", "highest": "full float32 products"}
PLACES = ("device", "cpu")
SMALL_TOKENIZER = {"width": 32, "depth": 1, "code_dim": 32, "num_codes": 64}
SMALL_GENERATOR = {"embed_dim": 32, "num_layers": 1, "num_heads": 2}
SMALL = {
    "gpt": SMALL_GENERATOR,
    "vqvae": SMALL_TOKENIZER,
    "hifigpt": SMALL_GENERATOR | {"num_residual_layers": 1},
    "rvqvae": SMALL_TOKENIZER,
}
"""Sizes with --small."""


class Step(NamedTuple):
    """A row of a table, which is kept in a file of its own, so that what follows cannot take it away."""

    part: str
    products: str
    option: Any
    """Precision of a training, or batch of a sampling."""
    subject: str
    """Kind of a training, or name of a system."""

    @property
    def name(self) -> str:
        """What it is called in files and reports."""
        return "-".join(self).replace(", ", "-").replace(" ", "-")


def steps(part: str, *, small: bool) -> list[Step]:
    """Returns what a part measures."""
    if part == "train":
        modes = (("default", "float32"), ("default", "bfloat16"), ("highest", "float32"))
        first = [Step(part, *modes[0], kind) for kind in KINDS]
        # On a CPU, most of the time is needed to compile.
        return first + [Step(part, *mode, kind) for mode in modes[1:] for kind in (("vqvae",) if small else KINDS)]
    systems = ("demo",) if small else ("gpt full", "hifigpt full", "hifigpt full, guided")
    batches = ("1", "4") if small else ("1", "32", "512")
    return [Step(part, *row) for row in itertools.product(PRODUCTS, batches, systems)] if part == "sample" else []


@functools.cache
def find_peaks(products: str) -> Peaks:
    """Returns the peaks of the device. `products`, the precision in use, has its own."""
    return measure_peaks(first_devices(1))


@functools.cache
def find_systems(small: bool) -> dict[str, MeasuredSystem]:
    """Returns the systems that are sampled, by name."""
    if not small:
        return {system.name: system for system in full_size_systems()}
    model = TextToMotion.load("demo")
    return {"demo": MeasuredSystem("demo", model.config.generator, model.config.tokenizer, model.variables)}


def measure_step(step: Step, *, small: bool) -> BenchResult:
    """Returns the figures of a step."""
    peaks = find_peaks(step.products)
    if step.part == "sample":
        return benchmark_sampling(find_systems(small)[step.subject], batch=int(step.option), peaks=peaks)
    config: Any = make_training(step.subject, batch=4 if small else None, precision=step.option)
    if small:
        config = dataclasses.replace(config, model=dataclasses.replace(config.model, **SMALL[step.subject]))
    return benchmark_training(config, size="small" if small else "full", peaks=peaks)


def measure(part: str, folder: Path, *, small: bool) -> None:
    """Measures what is missing of a part."""
    (folder / "steps").mkdir(exist_ok=True)
    jax.config.update("jax_enable_compilation_cache", False)  # so that compile times are real
    for step in steps(part, small=small):
        path = folder / "steps" / f"{step.name}.json"
        if path.exists():
            continue
        jax.config.update("jax_default_matmul_precision", None if step.products == "default" else step.products)
        try:
            row = measure_step(step, small=small)
        except Exception as error:  # noqa: BLE001 - too little memory for one step must not end the others
            path.with_suffix(".error").write_text(f"{type(error).__name__}: {error}".partition("\n")[0][:300])
            continue
        machine = describe_machine([find_peaks(step.products)])
        save_report(path, BenchReport(machine=machine, rows=(row,), peak_memory=peak_memory()))
        print(step.name, flush=True)  # noqa: T201


def sample_codes(path: Path, *, small: bool) -> None:
    """Samples motions of `demo` with full products. On the CPU, this needs JAX_PLATFORMS=cpu."""
    jax.config.update("jax_default_matmul_precision", "highest")
    sentences = [test.sentences[0] for test in action_tests()][:10]
    # Samples of a sentence have their own keys.
    motions = TextToMotion.load("demo").generate(sentences, num_samples=1 if small else 10, raw=True, whole=True)
    np.savez(path, *[np.asarray(motion.codes) for motion in motions])


def compare_codes(folder: Path) -> dict[str, int] | None:
    """Returns in how many motions, rows and codes the device differs from the CPU; None without both."""
    paths = [folder / f"codes-{place}.npz" for place in PLACES]
    if not all(path.exists() for path in paths):
        return None
    device, cpu = ([found[name].tolist() for name in found.files] for found in map(np.load, paths))
    motions = list(zip(device, cpu, strict=True))
    # A row that only one of both has differs, with all of its codes.
    rows = [pair for motion in motions for pair in itertools.zip_longest(*motion, fillvalue=())]
    codes = [pair for row in rows for pair in itertools.zip_longest(*row)]
    found = {"motions": motions, "rows": rows, "codes": codes}
    counts = {name: len(pairs) for name, pairs in found.items()}
    return counts | {f"other_{name}": sum(ours != theirs for ours, theirs in pairs) for name, pairs in found.items()}


def load_losses(folder: Path) -> dict[str, dict[int, float]]:
    """Returns the training losses of each run by update."""
    losses = {}
    for path in sorted(folder.glob("runs/*/train.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            losses[path.parent.name] = {int(row["step"]): float(row["loss"]) for row in csv.DictReader(file)}
    return losses


def find_missing(folder: Path, parts: list[str], *, small: bool) -> Iterator[str]:
    """Yields what some parts did not measure, and why."""
    for step in itertools.chain.from_iterable(steps(part, small=small) for part in parts):
        path = folder / "steps" / f"{step.name}.json"
        if not path.exists():
            error = path.with_suffix(".error")
            reason = error.read_text() if error.exists() else "its time was over, or its process ended"
            yield f"{step.name}: {reason}"
    if "parity" in parts and compare_codes(folder) is None:
        yield "parity: codes were not sampled on both"
    if "updates" in parts:
        losses, count = load_losses(folder), 20 if small else 1000
        for kind in KINDS:
            reached = max(losses.get(kind, ()), default=0)
            if reached < count:
                yield f"updates-{kind}: ended after {reached} of {count}"


def merged_reports(folder: Path, *, small: bool) -> dict[str, BenchReport]:
    """Returns a report for each kind of products."""
    found: dict[str, list[BenchReport]] = {}
    for step in steps("train", small=small) + steps("sample", small=small):
        path = folder / "steps" / f"{step.name}.json"
        if path.exists():
            found.setdefault(step.products, []).append(load_report(path))
    return {
        products: dataclasses.replace(
            reports[-1],
            rows=tuple(row for report in reports for row in report.rows),
            peak_memory=max(report.peak_memory or 0 for report in reports) or None,
        )
        for products, reports in found.items()
    }


def report(folder: Path, parts: list[str], *, small: bool) -> bool:
    """Writes both files, prints the Markdown, and returns whether nothing is missing."""
    device = jax.devices()[0].device_kind
    git = ["git", "-C", f"{ROOT}", "describe", "--always", "--dirty"]
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip() or "unknown"
    command = "sh docs/measure/accelerator.sh" + (" --small" if small else "")
    reports, parity, losses = merged_reports(folder, small=small), compare_codes(folder), load_losses(folder)
    missing = list(find_missing(folder, parts, small=small))
    date = datetime.date.today().isoformat()
    head: dict[str, Any] = {"date": date, "commit": commit, "device": device, "jax": jax.__version__}
    head |= {"command": command, "missing": missing, "parity": parity, "losses": losses}
    data = head | {"reports": {products: config_to_dict(one) for products, one in reports.items()}}
    (folder / "accelerator.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    text = [f"### {device}", f"`{command}`: JAX {jax.__version__}, {date}, commit {commit}."]
    for products, one in reports.items():
        text += [f"#### With {PRODUCTS[products]}", report_text(one).replace("\n## ", "\n##### ")]
    if parity:
        text += [
            "#### The same codes as on a CPU",
            "Of {motions} motions of `demo` ({rows} rows, {codes} codes) that were sampled with full float32 products, "
            "{other_motions} motions, {other_rows} rows and {other_codes} codes differ.".format(**parity),
        ]
    if losses:
        updates = sorted(set().union(*losses.values()))
        cells = [[f"{n:,}", *(f"{loss[n]:.4g}" if n in loss else "-" for loss in losses.values())] for n in updates]
        text += ["#### Losses of the recipes", markdown_table(["update", *losses], cells, aligned=True)]
    if missing:
        text += ["#### Missing", "\n".join(f"- {line}" for line in missing)]
    (folder / "accelerator.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")
    print("\n\n".join(text))  # noqa: T201
    return not missing


def main() -> None:
    """Runs a part. The report ends with 1 if something is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("train", "sample", *PLACES, "report"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--parts", nargs="+", default=[], help="of the report")
    options = parser.parse_args()
    folder, small = options.folder, options.small
    if options.part in PLACES:
        path = folder / f"codes-{options.part}.npz"
        if not path.exists():
            sample_codes(path, small=small)
    elif options.part != "report":
        measure(options.part, folder, small=small)
    elif not report(folder, options.parts, small=small):
        sys.exit(1)


if __name__ == "__main__":
    main()
