"""Reading the golden arrays."""

import numpy as np


def state_dict(arrays, prefix: str = "sd/") -> dict[str, np.ndarray]:
    """Returns the arrays whose key starts with `prefix`, that prefix cut off."""
    return {key.removeprefix(prefix): arrays[key] for key in arrays if key.startswith(prefix)}
