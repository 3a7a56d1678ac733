"""Makes `python -m t2m_jax` the same as `t2m`."""

import sys

from t2m_jax.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
