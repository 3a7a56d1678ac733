// The figure: one skinned mesh of rounded limbs. Each end of a limb has a bone as large as the radius there, so one mesh
// is that of all figures with limbs of these colors.

const SIDES = 20;
const CAP_RINGS = 6;
const UP = new THREE.Vector3(0, 1, 0);

// Returns the geometry of all limbs, in the frames of their bones: rings of half spheres with radius 1.
function bodyGeometry(colors) {
  const [points, tints, bones, indices] = [[], [], [], []];
  colors.forEach((color, limb) => {
    const tint = new THREE.Color(color).toArray();
    for (let ring = 0; ring < 2 * CAP_RINGS; ring++) {
      const end = Math.floor(ring / CAP_RINGS);
      const angle = ((ring - CAP_RINGS + 1 - end) / (CAP_RINGS - 1)) * (Math.PI / 2);
      const first = points.length / 3;
      for (let side = 0; side < SIDES; side++) {
        const around = (2 * Math.PI * side) / SIDES;
        points.push(Math.cos(angle) * Math.cos(around), Math.sin(angle), Math.cos(angle) * Math.sin(around));
        tints.push(...tint);
        bones.push(2 * limb + end, 0, 0, 0);
        if (ring === 2 * CAP_RINGS - 1) continue;
        const [here, beside] = [first + side, first + ((side + 1) % SIDES)];
        indices.push(here, here + SIDES, beside, beside, here + SIDES, beside + SIDES);
      }
    }
  });
  const geometry = new THREE.BufferGeometry();
  const add = (name, values, size) => geometry.setAttribute(name, new THREE.BufferAttribute(values, size));
  add("position", new Float32Array(points), 3);
  geometry.setAttribute("normal", geometry.attributes.position); // on spheres around the origin, they are the same
  add("color", new Float32Array(tints), 3);
  add("skinIndex", new Uint16Array(bones), 4);
  add("skinWeight", new Float32Array(bones.length).map((_, i) => (i % 4 === 0 ? 1 : 0)), 4);
  geometry.setIndex(indices);
  return geometry;
}

class BodyMesh {
  // `colors` are those of the limbs.
  constructor(colors) {
    this.bones = Array.from({ length: 2 * colors.length }, () => new THREE.Bone());
    const material = new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.72, metalness: 0 });
    this.mesh = new THREE.SkinnedMesh(bodyGeometry(colors), material);
    this.mesh.bind(new THREE.Skeleton(this.bones, this.bones.map(() => new THREE.Matrix4())), new THREE.Matrix4());
    this.mesh.castShadow = true;
    this.mesh.frustumCulled = false;
  }

  // Places the bones as a figure is now.
  pose({ parts, current }) {
    const turn = new THREE.Quaternion();
    parts.forEach(([start, end, ...radii], limb) => {
      const ends = [start, end].map((point) => new THREE.Vector3().fromArray(current, 3 * point));
      const along = ends[1].clone().sub(ends[0]);
      if (along.lengthSq() > 1e-12) turn.setFromUnitVectors(UP, along.normalize());
      ends.forEach((place, k) => this.bones[2 * limb + k].matrixWorld.compose(place, turn, new THREE.Vector3().setScalar(radii[k])));
    });
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.skeleton.dispose();
    this.mesh.material.dispose();
  }
}
