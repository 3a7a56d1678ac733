// The figure: one skinned mesh of rounded limbs. Each limb has a bone, which is placed by the two points that it joins.

const SIDES = 20;
const CAP_RINGS = 6;

// Returns positions and normals of a limb from the origin along y: rings around it, with half spheres at both ends.
function limbRings(length, startRadius, endRadius) {
  const rings = [];
  for (let k = 0; k < 2 * CAP_RINGS; k++) {
    const lower = k < CAP_RINGS;
    const angle = ((lower ? k - CAP_RINGS + 1 : k - CAP_RINGS) / (CAP_RINGS - 1)) * (Math.PI / 2);
    const radius = lower ? startRadius : endRadius;
    rings.push({ radius: radius * Math.cos(angle), y: (lower ? 0 : length) + radius * Math.sin(angle), up: Math.sin(angle) });
  }
  return rings;
}

// Returns the geometry of all limbs, in the frames of their bones.
function bodyGeometry(parts, lengths) {
  const [positions, normals, tints, bones, indices] = [[], [], [], [], []];
  parts.forEach(([, , startRadius, endRadius, tint], bone) => {
    const first = positions.length / 3;
    const rings = limbRings(lengths[bone], startRadius, endRadius);
    rings.forEach(({ radius, y, up }, ring) => {
      for (let side = 0; side < SIDES; side++) {
        const around = (2 * Math.PI * side) / SIDES;
        const flat = Math.sqrt(1 - up * up);
        positions.push(radius * Math.cos(around), y, radius * Math.sin(around));
        normals.push(flat * Math.cos(around), up, flat * Math.sin(around));
        tints.push(tint);
        bones.push(bone, 0, 0, 0);
        if (ring === rings.length - 1) continue;
        const [here, beside] = [first + ring * SIDES + side, first + ring * SIDES + ((side + 1) % SIDES)];
        indices.push(here, here + SIDES, beside, beside, here + SIDES, beside + SIDES);
      }
    });
  });
  const geometry = new THREE.BufferGeometry();
  const add = (name, values, size) => geometry.setAttribute(name, new THREE.BufferAttribute(values, size));
  add("position", new Float32Array(positions), 3);
  add("normal", new Float32Array(normals), 3);
  add("color", new Float32Array(positions.length), 3);
  add("skinIndex", new Uint16Array(bones), 4);
  add("skinWeight", new Float32Array(bones.length).map((_, i) => (i % 4 === 0 ? 1 : 0)), 4);
  geometry.setIndex(indices);
  geometry.userData.tints = tints;
  return geometry;
}

class BodyMesh {
  constructor(figure) {
    this.figure = figure;
    poseAt(figure, 0);
    this.bones = figure.parts.map(() => {
      const bone = new THREE.Bone();
      bone.matrixAutoUpdate = bone.matrixWorldAutoUpdate = false;
      return bone;
    });
    const lengths = figure.parts.map(([start, end]) => this.point(start).distanceTo(this.point(end)));
    this.material = new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.72, metalness: 0 });
    this.mesh = new THREE.SkinnedMesh(bodyGeometry(figure.parts, lengths), this.material);
    this.mesh.bind(new THREE.Skeleton(this.bones, this.bones.map(() => new THREE.Matrix4())), new THREE.Matrix4());
    this.mesh.castShadow = true;
    this.mesh.frustumCulled = false;
  }

  point(index) {
    return new THREE.Vector3().fromArray(this.figure.current, 3 * index);
  }

  // Colors of the four tints, in their order.
  paint(tints) {
    const colors = tints.map((tint) => new THREE.Color(tint).toArray());
    const { color } = this.mesh.geometry.attributes;
    this.mesh.geometry.userData.tints.forEach((tint, i) => color.set(colors[tint], 3 * i));
    color.needsUpdate = true;
  }

  // Places the bones at a time.
  pose(seconds) {
    poseAt(this.figure, seconds);
    const up = new THREE.Vector3(0, 1, 0);
    const turn = new THREE.Quaternion();
    const one = new THREE.Vector3(1, 1, 1);
    this.figure.parts.forEach(([start, end], bone) => {
      const from = this.point(start);
      const along = this.point(end).sub(from);
      if (along.lengthSq() > 1e-12) turn.setFromUnitVectors(up, along.normalize());
      this.bones[bone].matrixWorld.compose(from, turn, one);
    });
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.skeleton.dispose();
    this.material.dispose();
  }
}
