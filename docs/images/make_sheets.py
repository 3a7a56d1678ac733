"""Makes sheet-1.png and sheet-2.png in the folder of this file: 24 motions by the model that comes with the package.

Every sentence is generated once, with its number as the seed. None was chosen by how it looks.
"""

from pathlib import Path

from PIL import Image

from t2m_jax.export.render.rendering import render_poster
from t2m_jax.sampling import TextToMotion

SENTENCES = (
    "a person walks forward",
    "a man walks very slowly",
    "someone walks fast",
    "a person runs forward",
    "a woman jogs slowly",
    "a person walks forward and turns left",
    "he walks around a corner to the right",
    "a person stands still",
    "a person waves with the right hand",
    "she waves with both hands",
    "someone raises the left hand",
    "a person raises both arms above the head",
    "an old man walks forward",
    "a tired person waves with the left hand",
    "a person runs like a child",
    "a person walks proudly",
    "a person bows",
    "a person walks backwards",
    "walks forward, then stops and waves with the right hand",
    "a person waves with the left hand and then walks forward",
    "a man runs, then walks",
    "first she raises both hands, then she walks forward",
    "someone walks ahead, turns left and waves with both hands",
    "a person walks forward, stands still and raises the right hand",
)
LINES = 12

if __name__ == "__main__":
    model = TextToMotion.load("demo")
    motions = [model.generate(text, seed=seed)[0] for seed, text in enumerate(SENTENCES)]
    for page in range(len(motions) // LINES):
        picture = render_poster(motions[page * LINES : (page + 1) * LINES], num_poses=8, height=128)
        Image.fromarray(picture).quantize(128).save(Path(__file__).with_name(f"sheet-{page + 1}.png"), optimize=True)
