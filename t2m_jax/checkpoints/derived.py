"""Arrays that small bundles leave out.

A generator may read a copy of the tokenizer's codebook. The running sums of a codebook are only needed to train it
further; they become its codes times their counts, so that such a training starts from the codes as they are.
"""

from collections.abc import Mapping, Set

import numpy as np

CODEBOOK = "quantizer/codebook"
SUMS = "quantizer/ema_sum"
COUNTS = "quantizer/ema_count"
COPY = "codebook/codebook"


def drop_derived(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns arrays by name without those that `add_derived` adds: running sums, and copies of the codebook."""
    codebook = next((array for name, array in arrays.items() if name.endswith(CODEBOOK)), np.zeros(0))
    return {
        name: array
        for name, array in arrays.items()
        # A copy that differs from the codebook cannot be made from it, so it stays.
        if not (name.endswith(SUMS) or (name.endswith(COPY) and np.array_equal(array, codebook)))
    }


def add_derived(arrays: Mapping[str, np.ndarray], expected: Set[str]) -> dict[str, np.ndarray]:
    """Returns arrays by name with those that are expected, missing and known from others."""
    result = dict(arrays)
    codebook = next((name for name in arrays if name.endswith(CODEBOOK)), "")
    counts = codebook.removesuffix(CODEBOOK) + COUNTS
    for name in expected - arrays.keys():
        if name.endswith(SUMS) and counts in arrays and arrays[counts].shape == arrays[codebook].shape[:-1]:
            with np.errstate(all="ignore"):  # what is not finite is refused by `fit_arrays`
                result[name] = arrays[codebook].astype(np.float32) * arrays[counts].astype(np.float32)[..., None]
        elif name.endswith(COPY) and codebook:
            result[name] = arrays[codebook]
    return result
