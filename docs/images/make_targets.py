"""Makes targets.png in the folder of this file: a person who walks and has the left hand up at one moment."""

from pathlib import Path

from PIL import Image

from t2m_jax.sampling import TextToMotion

TARGETS = ["2 root=0.3,2", "3 left_wrist+=0.2,1.5,0.3"]

if __name__ == "__main__":
    (motion,) = TextToMotion.load("demo").direct("a person walks forward", TARGETS)
    path = Path(__file__).with_name("targets.png")
    motion.save(path)
    Image.open(path).convert("RGB").resize((1100, 440)).quantize(128).save(path, optimize=True)
