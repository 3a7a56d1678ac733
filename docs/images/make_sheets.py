"""Makes sheet-1.png to sheet-5.png in the folder of this file: 60 motions by the model that comes with the package.

    python docs/images/make_sheets.py [MODEL]

First each action in plain words, then 20 sentences in free words. Every sentence is generated once, with its number as
the seed. None was chosen by how it looks.
"""

import sys
from pathlib import Path

from PIL import Image

from t2m_jax.export.render.rendering import render_poster
from t2m_jax.sampling import TextToMotion

SENTENCES = (
    "a person walks forward",
    "a person walks backwards",
    "a person steps sideways to the left",
    "a person steps sideways to the right",
    "a person walks and turns left",
    "a person walks and turns right",
    "a person stands still",
    "a person runs",
    "a person runs backwards",
    "a person skips",
    "a person hops",
    "a person jumps",
    "a person jumps forward",
    "a person leaps",
    "a person waves with the left hand",
    "a person waves with the right hand",
    "a person waves with both hands",
    "a person raises the left hand",
    "a person raises the right hand",
    "a person raises both hands",
    "a person claps",
    "a person punches",
    "a person kicks",
    "a person throws something",
    "a person sits down",
    "a person stands up",
    "a person squats",
    "a person crouches",
    "a person crawls",
    "a person climbs",
    "a person bows",
    "a person dances",
    "a person does jumping jacks",
    "a person does a cartwheel",
    "a person stretches",
    "a person washes a window",
    "a person mops the floor",
    "a person directs the traffic",
    "a person laughs",
    "a person walks like a zombie",
    "my grandfather strolls to the bakery",
    "jog along the beach",
    "the knight marches ahead and bears left at the gate",
    "a nurse says hello with her right hand",
    "both arms go up above the head",
    "lift your left arm, please",
    "an old lady walks very slowly",
    "the tired hiker drags his feet",
    "sprint!",
    "a boy walks forward, then waves",
    "before she walks away, she bows",
    "first he jumps, then he claps",
    "walk while waving with the left hand",
    "she claps while standing",
    "he jumps three times",
    "kick twice",
    "a goalkeeper throws the ball",
    "take a seat",
    "the boxer throws some punches",
    "a dancer moves to the music",
)
LINES = 12

if __name__ == "__main__":
    model = TextToMotion.load(sys.argv[1] if len(sys.argv) > 1 else "demo")
    motions = [model.generate(text, seed=seed)[0] for seed, text in enumerate(SENTENCES)]
    for page in range(len(motions) // LINES):
        picture = render_poster(motions[page * LINES : (page + 1) * LINES], num_poses=8, height=128)
        Image.fromarray(picture).quantize(128).save(Path(__file__).with_name(f"sheet-{page + 1}.png"), optimize=True)
