"""Attacks all readers with many inputs, then kills commands, races them and fills their disk: `make soak`.

Prints a line for each target. Exits with 1 if an input was neither read nor refused in one line, or took too long or
too much memory, or if a command that was interrupted left something that is not whole. Such inputs are kept in the
folder `soak`, and their bugs get a regression test by a file in `corpus`.
"""

import argparse
import logging
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

CORPUS, KEPT = Path(__file__).parent / "corpus", Path("soak")
SLICE = 2000
"""Inputs of one task, after which it is somebody else's turn."""
BATCH = 40
"""Tasks of one set of processes."""


def run(kind: str, name: str, seed: int, count: int, intact: Path) -> tuple[str, str, int, int, str]:
    """Returns kind, target, inputs, refusals and what is broken, if anything is, of one task."""
    from tests.fuzz.attack import Broken, attack_file, attack_folder, flip_bits, limit_memory
    from tests.fuzz.targets import FILES, FOLDERS

    root = Path(tempfile.mkdtemp()) / "files"
    shutil.copytree(intact, root)
    attacks = {"file": (attack_file, FILES), "folder": (attack_folder, FOLDERS), "bits": (flip_bits, FOLDERS)}
    attack, targets = attacks[kind]
    targets[name](root)  # what is imported and compiled first is not counted
    limit_memory()
    try:
        return kind, name, count, attack(root, name, targets[name], seed=seed, count=count), ""
    except Broken as error:
        kept = next(iter(root.rglob("*.broken")), None)
        if kept is not None:
            KEPT.mkdir(exist_ok=True)
            shutil.move(kept, KEPT / f"{kind}-{name.replace('/', '_')}-{seed}")
        return kind, name, count, 0, str(error)
    finally:
        shutil.rmtree(root.parent)


def start_worker() -> None:
    """Makes a process quiet: only what is broken counts."""
    logging.disable(logging.CRITICAL)
    sys.unraisablehook = lambda _: None
    os.environ["TQDM_DISABLE"] = "1"


def tasks(options: argparse.Namespace, files: list[str], folders: list[str]) -> list[tuple[str, str, int, int]]:
    """Returns kind, target, seed and number of inputs of all tasks, the targets in turn."""
    plan = [("file", name, -(-options.inputs // len(files)), SLICE) for name in files]
    plan += [("folder", name, -(-options.folder_inputs // len(folders)), SLICE // 10) for name in folders]
    plan += [("bits", name, options.flips, SLICE // 10) for name in folders]
    found = []
    for kind, name, total, size in plan:
        starts = range(0, total, size)
        found += [(kind, name, options.seed + start, min(size, total - start)) for start in starts]
    return sorted(found, key=lambda task: task[2])


def results(plan: list[tuple[str, str, int, int]], intact: Path) -> Iterator[tuple[str, str, int, int, str]]:
    """Yields what `run` returns of each task. Processes are new after some tasks, since what fails may leak memory."""
    for first in range(0, len(plan), BATCH):
        print(f"{first} of {len(plan)} tasks", file=sys.stderr, flush=True)
        # Not `max_tasks_per_child`, with which the executor of Python 3.11 may wait forever.
        with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"), initializer=start_worker) as pool:
            running = [pool.submit(run, *task, intact) for task in plan[first : first + BATCH]]
            yield from (done.result() for done in as_completed(running))


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="mutated files, over all readers of files")
    parser.add_argument("--folder-inputs", type=int, default=20_000, help="mutated folders, over all of their readers")
    parser.add_argument("--flips", type=int, default=2000, help="flipped bits of each folder")
    parser.add_argument("--kills", type=int, default=100, help="signals to each group of commands")
    parser.add_argument("--races", type=int, default=100, help="pairs of processes with one destination")
    parser.add_argument("--full-disks", type=int, default=50, help="commands whose disk becomes full")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="start of all random choices")
    parser.add_argument("--only", nargs="*", help="names of targets")
    options = parser.parse_args()

    from tests.fuzz.targets import FILES, FOLDERS, make_files

    start_worker()
    files, folders = ([name for name in names if name in (options.only or names)] for names in (FILES, FOLDERS))
    totals: dict[tuple[str, str], list[int]] = {}
    broken: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as intact:
        make_files(Path(intact))
        for kind, name, count, refused, problem in results(tasks(options, files, folders), Path(intact)):
            row = totals.setdefault((kind, name), [0, 0])
            row[:] = row[0] + count, row[1] + refused
            if problem and problem[:80] not in broken:
                broken[problem[:80]] = problem
                print(f"broken: {kind} {name}: {problem}", flush=True)
    for (kind, name), (count, refused) in sorted(totals.items()):
        print(f"{kind:6} {name:32} {count:8} inputs, {refused:8} refused")
    print(f"{sum(count for count, _ in totals.values())} inputs, seed {options.seed}: {len(broken)} kinds of problems")
    return bool(broken) | (0 if options.only else interrupt(options))


def interrupt(options: argparse.Namespace) -> bool:
    """Kills commands, races them and fills their disk; returns whether anything was broken."""
    from tests.fuzz.attack import Broken
    from tests.fuzz.full_disk import fill_often
    from tests.fuzz.processes import COMMANDS, kill_often, prepare, race_often

    broken = False
    with tempfile.TemporaryDirectory() as folder:
        prepare(Path(folder))
        root, seed = Path(folder), options.seed
        attacks = {group: kill_often(root, group, seed=seed, count=options.kills) for group in COMMANDS}
        attacks["races"] = race_often(root, count=options.races)
        attacks["full disks"] = fill_often(root, seed=seed, count=options.full_disks)
        for name, attack in attacks.items():
            seen: Counter[str] = Counter()
            try:
                seen.update(attack)
            except Broken as error:
                broken = True
                print(f"broken: {name}: {error}", flush=True)
            print(f"{name}: {dict(sorted(seen.items()))}", flush=True)
    return broken


if __name__ == "__main__":
    sys.exit(main())
