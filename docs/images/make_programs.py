"""Makes programs.png in the folder of this file: a motion on characters, as three.js and as Blender draw them.

    PYTHONPATH=. python docs/images/make_programs.py DATA PYTHON

DATA is the folder of the archives `cc0-glb` and `foreign-files`, and PYTHON a program that can import `bpy`. The first
line is by three.js in Chromium, the second by Blender. Prints how far the bones of five characters are from where the
package reads them; two of these files have no mesh, so they are not in the picture.
"""

import base64
import io
import json
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import numpy as np
from make_studio import ARGUMENTS
from PIL import Image
from playwright.sync_api import Page, sync_playwright

import t2m_jax.export
from t2m_jax import Motion, load
from t2m_jax.motion import load_character
from tests.motion.character_files import places, read_parts
from tests.motion.test_character import MADE, REAL

SENTENCE = "a person waves with the left hand"
FRAME = 44
SIZE = 300
FPS = 20

PAGE = """async ([bytes, frames, shown, view]) => {
  const data = Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0)).buffer;
  const file = await new THREE.GLTFLoader().parseAsync(data, "");
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xe8e8e8);
  scene.add(file.scene, new THREE.HemisphereLight(0xffffff, 0x888888, 3));
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(SIZE, SIZE);
  const camera = new THREE.PerspectiveCamera(30, 1, 0.01, 1000);
  camera.position.set(view.x, view.y, view.z + view.far);
  camera.lookAt(view.x, view.y, view.z);
  const mixer = new THREE.AnimationMixer(file.scene);
  const action = mixer.clipAction(file.animations.at(-1)).setLoop(THREE.LoopOnce);
  action.clampWhenFinished = true;
  action.play();
  const found = [];
  let picture;
  for (let frame = 0; frame < frames; frame += 1) {
    mixer.setTime(frame / FPS);
    file.scene.updateMatrixWorld(true);
    const places = {};
    file.scene.traverse((node) => {
      const place = new THREE.Vector3().setFromMatrixPosition(node.matrixWorld);
      if (node.isBone) places[node.userData.name ?? node.name] = place.toArray();
    });
    found.push(places);
    if (frame === shown) {
      renderer.render(scene, camera);
      picture = renderer.domElement.toDataURL();
    }
  }
  return [found, picture];
}""".replace("SIZE", str(SIZE)).replace("FPS", str(FPS))

BLENDER = """
import json, math, os, sys
import bpy
path, name, frames, shown, view, size, fps, picture, table = json.loads(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = fps
bpy.ops.import_scene.gltf(filepath=path, disable_bone_shape=True)
rig = next(one for one in scene.objects if one.type == "ARMATURE")
strips = {track.name: track.strips[0] for track in rig.animation_data.nla_tracks}
for track in rig.animation_data.nla_tracks:
    track.mute = True  # their strips begin at frame 1, and the keys of actions at frame 0
rig.animation_data.action = strips[name].action
for bone in rig.pose.bones:  # those that the animation does not move keep the pose of the one that was shown before
    bone.matrix_basis.identity()
found = []
for frame in range(frames):
    scene.frame_set(frame)
    found.append({bone.name: list((rig.matrix_world @ bone.matrix).translation) for bone in rig.pose.bones})
json.dump(found, open(table, "w"))
scene.frame_set(shown)
camera = bpy.data.cameras.new("camera")
camera.angle = math.radians(30)
seen = bpy.data.objects.new("camera", camera)
seen.location = (view["x"], -view["z"] - view["far"], view["y"])
seen.rotation_euler = (math.pi / 2, 0, 0)
scene.collection.objects.link(seen)
scene.camera = seen
scene.world = bpy.data.worlds.new("world")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs[0].default_value = (0.8, 0.8, 0.8, 1)
scene.render.engine = "CYCLES"
scene.cycles.samples = 8
scene.render.resolution_x = scene.render.resolution_y = size
scene.view_settings.view_transform = "Standard"
scene.render.filepath = picture
bpy.ops.render.render(write_still=True)
os._exit(0)  # bpy may crash when it ends
"""


def character_files(data: Path, folder: Path) -> dict[str, Path]:
    """Returns the files of five characters."""
    files = {}
    for name, (archive, member) in REAL.items():
        with tarfile.open(data / f"{archive}.tar.xz") as archived:
            member = next(one for one in archived.getnames() if one.removeprefix("./") == member)
            (folder / f"{name}.glb").write_bytes(archived.extractfile(member).read())
        files[name] = folder / f"{name}.glb"
    for name in ("VRM 0", "scaled and turned"):
        files[name] = MADE[name](folder / f"{name}.glb")
    return files


def compare(name: str, path: Path, motion: Motion, page: Page, python: str) -> list[Image.Image]:
    """Returns the pictures of both programs, and prints how far their bones are from where the package reads them."""
    expected = places(path)
    points = np.stack([place for place in expected.values() if place.ndim == 2], axis=1)
    low, high = points[FRAME].min(axis=0), points[FRAME].max(axis=0)
    x, y, z = ((low + high) / 2).tolist()
    view = {"x": x, "y": y, "z": z, "far": 2.6 * float((high - low).max())}
    given = [base64.b64encode(path.read_bytes()).decode(), motion.num_frames, FRAME, view]
    by_three, picture = page.evaluate(PAGE, given)
    drawn, table = path.with_suffix(".png"), path.with_suffix(".json")
    animation = read_parts(path).tree["animations"][-1]["name"]
    request = [f"{path}", animation, motion.num_frames, FRAME, view, SIZE, FPS, f"{drawn}", f"{table}"]
    subprocess.run([python, "-c", BLENDER, json.dumps(request)], check=True, stdout=subprocess.DEVNULL)
    by_blender = [{bone: (x, z, -y) for bone, (x, y, z) in frame.items()} for frame in json.loads(table.read_text())]
    for program, found in (("three.js", by_three), ("Blender", by_blender)):
        known = [bone for bone in found[0] if bone in expected]
        read = np.array([[frame[bone] for bone in known] for frame in found])
        apart = np.linalg.norm(
            read - np.stack([np.broadcast_to(expected[bone], read[:, 0].shape) for bone in known], axis=1), axis=-1
        )
        sys.stdout.write(f"{name}, {program}: {len(known)} of {len(found[0])} bones, {1000 * apart.max():.4f} mm\n")
    first = Image.open(io.BytesIO(base64.b64decode(picture.split(",")[1])))
    return [first.convert("RGB"), Image.open(drawn).convert("RGB")]


def main(data: Path, python: str) -> None:
    """Writes the picture, and prints distances."""
    (motion,) = load("demo").generate(SENTENCE, seed=7)
    columns = []
    with tempfile.TemporaryDirectory() as made, sync_playwright() as running:
        folder = Path(made)
        page = running.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS).new_page()
        page.add_script_tag(path=Path(t2m_jax.export.__path__[0]) / "viewer" / "vendor" / "three-character.min.js")
        for name, path in character_files(data, folder).items():
            moved = folder / "moved.glb"
            load_character(path).save(moved, [motion])
            pictures = compare(name, moved, motion, page, python)
            if read_parts(path).tree.get("meshes"):
                columns.append(pictures)
    sheet = Image.new("RGB", (SIZE * len(columns), SIZE * 2))
    for number, pictures in enumerate(columns):
        for line, picture in enumerate(pictures):
            sheet.paste(picture, (SIZE * number, SIZE * line))
    sheet.quantize(128).save(Path(__file__).with_name("programs.png"), optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
