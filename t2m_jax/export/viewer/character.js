// A character of a GLB file in place of the figure: `window.T2M.loadCharacter`. Only the studio has it.

// What a file refers to elsewhere is not loaded: an address in a stranger's file would say who opens it.
const NOWHERE = "data:,";
const ownParts = new THREE.LoadingManager();
ownParts.setURLModifier((address) => (/^(blob|data):/.test(address) ? address : NOWHERE));

// A body for `FigureCell.dress` that is moved by the animation of a file.
class CharacterBody {
  constructor(file, animation, scale) {
    // Paths and marks on the ground are those of the motion, so the character is shown as large as its person.
    this.mesh = new THREE.Group();
    this.mesh.add(file.scene);
    this.mesh.scale.setScalar(1 / scale);
    this.mesh.traverse((part) => {
      if (!part.isMesh) return;
      part.castShadow = true;
      part.frustumCulled = false; // its box is that of the rest pose
    });
    this.mixer = new THREE.AnimationMixer(file.scene);
    const action = this.mixer.clipAction(animation);
    action.clampWhenFinished = true;
    action.setLoop(THREE.LoopOnce, 1);
    action.play();
  }

  pose({ frames, fps }, seconds) {
    this.mixer.setTime(clamp(seconds, 0, (frames - 1) / fps));
  }

  dispose() {
    this.mixer.stopAllAction();
    this.mesh.traverse((part) => {
      if (!part.isMesh) return;
      part.geometry.dispose();
      part.skeleton?.dispose();
      for (const material of [part.material].flat()) {
        for (const value of Object.values(material)) if (value?.isTexture) value.dispose();
        material.dispose();
      }
    });
  }
}

// Returns a body for the animation with this place from the end (1 is the last one).
async function loadCharacter(bytes, fromEnd) {
  const file = await new THREE.GLTFLoader(ownParts).parseAsync(bytes, "");
  const meshes = file.parser.json.nodes.filter((node) => node.mesh !== undefined);
  if (!meshes.length) throw new Error("it has no mesh");
  const animation = file.animations.at(-fromEnd);
  const scale = file.parser.json.animations.at(-fromEnd).extras.scale;
  return new CharacterBody(file, animation, scale);
}

window.T2M.loadCharacter = loadCharacter;
