"""Writes demo.gif beside this file: one sentence, by the bundled model."""

from pathlib import Path

from t2m_jax.export.gif import save_gif
from t2m_jax.sampling import TextToMotion

if __name__ == "__main__":
    motions = TextToMotion.load("demo").generate("a person walks forward and turns left", seed=3)
    save_gif(Path(__file__).with_name("demo.gif"), motions, height=320)
