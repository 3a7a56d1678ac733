// The ground of a figure: grid, shadow, the path of the root, and marks where feet stand.

const PATH_WIDTH = 0.035;
const LIFT = 0.004;  // meters between the layers on the ground, so that they do not flicker

// Lines half a meter apart, about a pixel wide at any distance, which fade away from the figure.
const GRID_VERTEX = `
  varying vec2 place;
  void main() {
    vec4 world = modelMatrix * vec4(position, 1.0);
    place = world.xz;
    gl_Position = projectionMatrix * viewMatrix * world;
  }`;
const GRID_FRAGMENT = `
  varying vec2 place;
  uniform vec3 color;
  uniform vec3 center;
  void main() {
    vec2 squares = place / 0.5;
    vec2 pixels = abs(fract(squares - 0.5) - 0.5) / fwidth(squares);
    float line = 1.0 - min(min(pixels.x, pixels.y), 1.0);
    float fade = 1.0 - smoothstep(1.5, 6.5, distance(place, center.xz));
    gl_FragColor = vec4(color, line * fade);
    #include <colorspace_fragment>
  }`;

// Returns a flat ribbon along a path.
function ribbonGeometry(path) {
  const positions = new Float32Array(6 * path.length);
  const indices = [];
  path.forEach((place, i) => {
    const [before, after] = [path[Math.max(i - 1, 0)], path[Math.min(i + 1, path.length - 1)]];
    const [dx, dz] = [after[0] - before[0], after[2] - before[2]];
    const length = Math.hypot(dx, dz) || 1;
    const [sx, sz] = [(-dz / length) * (PATH_WIDTH / 2), (dx / length) * (PATH_WIDTH / 2)];
    positions.set([place[0] + sx, 0, place[2] + sz, place[0] - sx, 0, place[2] - sz], 6 * i);
    if (i) indices.push(2 * i - 2, 2 * i - 1, 2 * i, 2 * i, 2 * i - 1, 2 * i + 1);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  geometry.setIndex(indices);
  return geometry;
}

// The ground of one figure after the other.
class GroundMesh {
  constructor() {
    const plane = new THREE.PlaneGeometry(14, 14).rotateX(-Math.PI / 2);
    this.grid = new THREE.Mesh(plane, new THREE.ShaderMaterial({
      vertexShader: GRID_VERTEX, fragmentShader: GRID_FRAGMENT, transparent: true, depthWrite: false,
      uniforms: { color: { value: new THREE.Color() }, center: { value: this.center = new THREE.Vector3() } },
    }));
    this.shadow = new THREE.Mesh(plane, new THREE.ShadowMaterial());
    this.shadow.receiveShadow = true;
    const flat = (opacity) => new THREE.MeshBasicMaterial({ transparent: true, opacity, depthWrite: false, side: 2 });
    this.path = new THREE.Mesh(plane, [flat(0.965), flat(0.3)]); // what was played, and the rest
    this.drawn = new THREE.Mesh(plane, flat(0.95));
    this.marks = new THREE.InstancedMesh(new THREE.RingGeometry(0.045, 0.085, 24).rotateX(-Math.PI / 2), flat(0.9), 1);
    this.layers = [this.shadow, this.grid, this.path, this.drawn, this.marks];
    this.layers.forEach((layer, place) => {
      layer.position.y = LIFT * (place - 1);
      layer.renderOrder = place - this.layers.length;
      layer.frustumCulled = false;
    });
  }

  paint(theme, accent, other) {
    for (const material of [...this.path.material, this.marks.material]) material.color.set(accent);
    this.drawn.material.color.set(other);
    this.shadow.material.opacity = theme.shadow;
    this.grid.material.uniforms.color.value.set(theme.lines);
  }

  // Shows what a figure has reached at a time.
  pose({ figure, path, drawn }, seconds) {
    const frame = seconds * figure.fps;
    const played = 6 * Math.floor(clamp(frame, 0, figure.frames - 1));
    path.clearGroups();
    path.addGroup(0, played, 0);
    path.addGroup(played, path.index.count - played, 1);
    this.path.geometry = path;
    this.drawn.geometry = drawn;
    this.mark(figure.contacts, frame);
    const [x, , z] = figure.current;
    this.center.set(x, 0, z);
    for (const layer of [this.grid, this.shadow]) layer.position.set(x, layer.position.y, z);
  }

  // Marks are large while a foot stands, and small afterwards.
  mark(contacts, frame) {
    const { marks } = this;
    if (contacts.length > marks.instanceMatrix.count) {
      marks.dispose();
      marks.instanceMatrix = new THREE.InstancedMesh(marks.geometry, marks.material, contacts.length).instanceMatrix;
      marks.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
    }
    const matrix = new THREE.Matrix4();
    marks.count = contacts.length;
    contacts.forEach(([first, last, x, z], i) => {
      const size = frame < first ? 0 : frame <= last + 1 ? 1 : 0.4;
      marks.setMatrixAt(i, matrix.makeScale(size, size, size).setPosition(x, 0, z));
    });
    marks.instanceMatrix.needsUpdate = true;
  }

  dispose() {
    for (const { geometry, material } of this.layers) {
      geometry.dispose();
      for (const one of [material].flat()) one.dispose();
    }
    this.marks.dispose();
  }
}
