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

class GroundMesh {
  constructor(figure) {
    this.figure = figure;
    const plane = () => new THREE.PlaneGeometry(14, 14).rotateX(-Math.PI / 2);
    this.grid = new THREE.Mesh(plane(), new THREE.ShaderMaterial({
      vertexShader: GRID_VERTEX, fragmentShader: GRID_FRAGMENT, transparent: true, depthWrite: false,
      uniforms: { color: { value: new THREE.Color() }, center: { value: this.center = new THREE.Vector3() } },
    }));
    this.shadow = new THREE.Mesh(plane(), new THREE.ShadowMaterial());
    this.shadow.receiveShadow = true;
    const ribbon = ribbonGeometry(smoothPath(rootPath(figure), 4));
    const flat = (opacity) => new THREE.MeshBasicMaterial({ transparent: true, opacity, depthWrite: false, side: 2 });
    this.path = new THREE.Mesh(ribbon, flat(0.3));
    this.played = new THREE.Mesh(ribbon.clone(), flat(0.95));
    const ring = new THREE.RingGeometry(0.045, 0.085, 24).rotateX(-Math.PI / 2);
    this.marks = new THREE.InstancedMesh(ring, flat(0.9), Math.max(figure.contacts.length, 1));
    this.marks.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
    this.drawn = new THREE.Mesh(ribbonGeometry([]), flat(0.95));
    this.layers = [this.shadow, this.grid, this.path, this.played, this.drawn, this.marks];
    this.layers.forEach((layer, place) => {
      layer.position.y = LIFT * (place - 1);
      layer.renderOrder = place - this.layers.length;
      layer.frustumCulled = false;
    });
  }

  paint(theme, accent, other) {
    const color = new THREE.Color(accent);
    for (const layer of [this.path, this.played, this.marks]) layer.material.color.copy(color);
    this.drawn.material.color.set(other);
    this.shadow.material.opacity = theme.shadow;
    this.grid.material.uniforms.color.value.set(theme.lines);
  }

  // Shows a line through points on the ground, [x, z].
  draw(points) {
    this.drawn.geometry.dispose();
    this.drawn.geometry = ribbonGeometry(points.map(([x, z]) => [x, 0, z]));
  }

  // Shows what a time has reached. Marks are large while a foot stands, and small afterwards.
  pose(seconds) {
    const { figure } = this;
    const frame = seconds * figure.fps;
    this.played.geometry.setDrawRange(0, 6 * Math.floor(clamp(frame, 0, figure.frames - 1)));
    const matrix = new THREE.Matrix4();
    this.marks.count = figure.contacts.length;
    figure.contacts.forEach(([first, last, x, z], i) => {
      const size = frame < first ? 0 : frame <= last + 1 ? 1 : 0.4;
      this.marks.setMatrixAt(i, matrix.makeScale(size, size, size).setPosition(x, 0, z));
    });
    this.marks.instanceMatrix.needsUpdate = true;
    const [x, , z] = figure.current;
    this.center.set(x, 0, z);
    for (const layer of [this.grid, this.shadow]) layer.position.set(x, layer.position.y, z);
  }

  dispose() {
    for (const layer of this.layers) {
      layer.geometry.dispose();
      layer.material.dispose();
    }
    this.marks.dispose();
  }
}
