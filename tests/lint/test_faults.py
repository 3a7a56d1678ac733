"""The faults of `make faults` can still be planted."""

from tests.conftest import REPOSITORY
from tests.faults import FAULTS


def test_each_fault_has_its_place_and_its_test():
    for fault in FAULTS:
        text = (REPOSITORY / "t2m_jax" / fault.file).read_text(encoding="utf-8")
        assert text.count(fault.right) == 1, f"{fault.name}: change tests/faults.py with the code"
        assert (REPOSITORY / "tests" / fault.test.partition("::")[0]).is_file(), fault.name
