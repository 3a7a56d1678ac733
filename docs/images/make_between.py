"""Makes between.png in the folder of this file: ten motions between two poses of test clips.

    python -m docs.images.make_between data/bandai-namco [MODEL]

The poses are one to three seconds apart, those of the first ten requests of `docs/measure/targets.py --between`. None
was chosen by how it looks.
"""

import sys
from pathlib import Path

from PIL import Image

from docs.measure.targets import fill_gap, trials
from t2m_jax.export.render.rendering import render_poster
from t2m_jax.sampling import TextToMotion

if __name__ == "__main__":
    model = TextToMotion.load(sys.argv[2] if len(sys.argv) > 2 else "demo")
    gaps = [fill_gap(model, trial, number) for number, trial in enumerate(trials(sys.argv[1], 10))]
    picture = render_poster([gap.filled[: gap.size + 1] for gap in gaps], num_poses=8, height=128)
    Image.fromarray(picture).quantize(128).save(Path(__file__).with_name("between.png"), optimize=True)
