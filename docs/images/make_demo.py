"""Writes demo.gif beside this file: four sentences, one figure each, from the bundled model."""

from pathlib import Path

from t2m_jax.export.gif import save_gif
from t2m_jax.sampling import TextToMotion

SENTENCES = (
    "a person waves with the left hand",
    "somebody raises both hands",
    "a person waves with both hands",
    "someone raises the right hand",
)

if __name__ == "__main__":
    motions = TextToMotion.load("demo").generate(SENTENCES, seed=1)
    save_gif(Path(__file__).with_name("demo.gif"), motions, height=300)
