"""Motion files whose numbers or compression no list of a library's errors foresees."""

import io
import zipfile

import numpy as np

from tests.motion.glb_files import glb_with


def npz_with(**entries) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **{"positions": np.zeros((40, 22, 3), "f4"), "fps": 20.0} | entries)
    return file.getvalue()


def damaged_lzma() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in (("positions", np.zeros((40, 22, 3), "f4")), ("fps", np.float64(20))):
            part = io.BytesIO()
            np.save(part, array)
            archive.writestr(f"{name}.npy", part.getvalue())
    data = bytearray(file.getvalue())
    place = data.index(b"positions.npy") + len("positions.npy")
    data[place + 12 : place + 40] = b"\xff" * 28
    return bytes(data)


HOSTILE_FILES = {
    "npz": [
        damaged_lzma(),
        npz_with(fps=1e6, positions=np.zeros((72_000, 22, 3), "f4")),
        npz_with(fps=1e-9),
        npz_with(positions=np.full((40, 22, 3), 1e30, "f4")),
    ],
    "glb": [
        glb_with(node={"translation": [10**400, 0, 0]}),
        glb_with(node={"scale": [1, 10**400, 1]}),
        glb_with(accessor={"count": 10**400}),
        glb_with(accessor={"byteOffset": 2**63}),
    ],
}
