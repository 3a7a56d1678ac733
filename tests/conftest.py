"""Settings and fixtures of all tests: CPU, quick compilation, strict broadcasting, reference data, bounded memory."""

import ctypes
import functools
import gc
import os
import sys
import tarfile
from importlib.metadata import version
from pathlib import Path

# Set before the first import of jax, and inherited by the programs that tests start.
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Tiny models run for milliseconds and compile for seconds, so the suite takes a quarter of the time without XLA's
# optimizations. The tests in user_settings/ turn them on again.
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
if tuple(map(int, version("jaxlib").split(".")[:2])) < (0, 11):
    # The older of two ways to compile, with which it takes less than half of the time, and one part for each program in
    # place of 32, of which each would begin anew. JAX 0.12 does not have the first and gains nothing from the second.
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1")
# Programs need not know which line of Python each of their operations comes from.
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
# A path that does not exist may look like a name on the hub. No test asks the real one.
os.environ["HF_HUB_OFFLINE"] = "1"

import jax
import pytest
from hypothesis import settings

from tests.hub_server import running_hub

jax.config.update("jax_numpy_rank_promotion", "raise")

# Compilation makes single examples slow, and each run of the suite should try the same examples.
settings.register_profile("suite", deadline=None, derandomize=True)
settings.load_profile("suite")

REPOSITORY = Path(__file__).parents[1]
PROGRAMS = "T2M_JAX_TEST_PROGRAMS"
"""The environment variable that says where compiled programs are; by default in the cache of pytest."""
LONGEST = (
    *("test_wheel", "test_processes", "test_viewer", "test_server", "test_evaluation", "test_repeats", "test_hifigpt"),
    *("test_warm_start", "test_fuzz", "test_steps", "test_resume", "test_pipeline", "test_generate", "test_compiled"),
    *("test_notebooks", "test_page", "test_stranger", "test_inbetween", "test_timeline", "test_third_system"),
    *("test_many_devices", "test_site", "test_thirty_steps", "test_returning", "test_distributed", "test_evaluator"),
    *("test_kill", "test_sentence_states", "test_placement", "test_presets", "test_directing", "test_exported"),
)
"""Files of tests that take longest."""
PROGRAMS_LIMIT = 5_000_000_000
"""Bytes of compiled programs after which the next test run begins with none."""
MEMORY_LIMIT = 1_500_000_000
"""Bytes of a test process after which compiled programs are dropped; single tests need up to 0.5 GB more."""


def pytest_configure(config):
    """Lets all processes of this test run and of later ones share compiled programs, which saves most of the time.

    The programs that tests start do not share them: some are killed, and could leave half of a file.
    """
    if not hasattr(config, "workerinput"):
        os.environ.setdefault(PROGRAMS, str(config.cache.mkdir("programs")))
        drop_old_programs(Path(os.environ[PROGRAMS]))
    jax.config.update("jax_compilation_cache_dir", os.environ[PROGRAMS])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # JAX reads and writes these files without a lock; with one, processes wait for each other, some for too long. So it
    # may find half of a file, of which it warns before it compiles the program.
    config.addinivalue_line("filterwarnings", "ignore:Error (reading|writing) persistent compilation cache:UserWarning")


def drop_old_programs(folder: Path) -> None:
    """Empties the folder of compiled programs if it has grown too large: old ones are of code that has changed."""
    files = [path for path in folder.glob("*") if path.is_file()]
    if sum(path.stat().st_size for path in files) > PROGRAMS_LIMIT:
        for path in files:
            path.unlink(missing_ok=True)


def pytest_collection_modifyitems(items):
    """Begins with what takes longest, so that no process has to wait for another at the end."""
    items.sort(key=lambda item: item.path.stem not in LONGEST)


def pytest_collection_finish():
    """Lets the garbage collector search less: what was imported stays, and tracing makes many objects that do, too."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


def resident_memory() -> int:
    """Returns the memory of this process in bytes, 0 where the system has no /proc."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") if statm.exists() else 0


@pytest.fixture(autouse=True)
def bounded_memory():
    """Drops compiled programs when the process has grown large.

    JAX keeps every program that it compiled. Over the whole suite these are more than 4 GB per process.
    """
    yield
    if resident_memory() > MEMORY_LIMIT:
        return_memory()
    if resident_memory() > MEMORY_LIMIT:
        jax.clear_caches()
        return_memory()


def return_memory() -> None:
    """Gives memory that is not used back to the system; compilation leaves hundreds of megabytes of it."""
    gc.collect()
    if sys.platform == "linux":
        # glibc would keep the freed memory for later use.
        ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture
def hub(monkeypatch, tmp_path):
    """Yields an empty stand-in for the Hugging Face hub, to which the hub's client is connected."""
    with running_hub(monkeypatch, tmp_path / "home") as hub:
        yield hub


@pytest.fixture(scope="session")
def repository() -> Path:
    """Returns the root of the repository."""
    return REPOSITORY


@pytest.fixture(scope="session")
def golden_dir() -> Path:
    """Returns the folder of reference arrays that are part of the repository."""
    return REPOSITORY / "tests" / "golden"


@pytest.fixture(scope="session")
def shared_dir() -> Path:
    """Returns the folder of reference data that may not be redistributed; tests that need it are skipped without it."""
    path = REPOSITORY.parent / "shared"
    if not path.is_dir():
        pytest.skip(f"{path} with reference data that may not be in the repository does not exist")
    return path


@pytest.fixture(scope="session")
def shared_data(shared_dir, tmp_path_factory):
    """Returns a function that unpacks an archive of recordings once and returns its folder."""

    @functools.cache
    def unpack(name: str) -> Path:
        folder = tmp_path_factory.mktemp(name)
        with tarfile.open(shared_dir / "data" / f"{name}.tar.xz") as archive:
            archive.extraction_filter = getattr(tarfile, "data_filter", None)  # not in Python before 3.11.4
            archive.extractall(folder)
        return folder

    return unpack
