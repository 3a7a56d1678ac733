// The scene in which all figures are drawn, one after the other, with its light. What the graphics card needs of it is thus
// made once, not for each figure.

class Scenery {
  constructor() {
    this.bodies = new Map(); // by the colors of their limbs
    this.ground = new GroundMesh();
    this.sky = new THREE.HemisphereLight();
    this.sun = new THREE.DirectionalLight();
    this.sun.shadow.radius = 5;
    this.sun.shadow.bias = -0.002;
    this.sun.shadow.normalBias = 0.02;
    Object.assign(this.sun.shadow.camera, { left: -1.8, right: 1.8, top: 2.2, bottom: -1.8, near: 1, far: 12 });
    this.scene = new THREE.Scene();
    this.scene.add(this.sky, this.sun, this.sun.target, ...this.ground.layers);
  }

  // Size of the picture of the shadow; 0 is none.
  castShadow(size) {
    const { shadow } = this.sun;
    if (this.sun.castShadow === size > 0 && shadow.mapSize.x === size) return;
    this.sun.castShadow = size > 0;
    shadow.dispose();
    shadow.map = null;
    shadow.mapSize.set(size, size);
  }

  // Draws the figure of a cell at a time.
  draw(renderer, camera, { cell, theme, seconds }) {
    const { figure, number, isTinted } = cell;
    const accent = (place) => theme.accents[place % theme.accents.length];
    const tints = isTinted ? [accent(number), ...theme.tints.slice(1)] : theme.tints;
    poseAt(figure, seconds);
    const body = cell.character ?? this.bodyOf(figure.parts.map(([, , , , tint]) => tints[tint]));
    body.pose(figure, seconds);
    this.scene.add(body.mesh);
    this.ground.paint(theme, accent(number), accent(number + 1));
    this.ground.pose(cell, seconds);
    this.sky.color.set(theme.sky);
    this.sky.groundColor.set(theme.floor);
    this.sky.intensity = theme.ambient;
    this.sun.intensity = theme.sun;
    const [x, , z] = figure.current;
    this.sun.position.set(x + 1.6, 5, z + 2.4);
    this.sun.target.position.set(x, 0.6, z);
    renderer.render(this.scene, camera);
    body.mesh.removeFromParent();
  }

  bodyOf(colors) {
    const name = colors.join();
    if (!this.bodies.has(name)) this.bodies.set(name, new BodyMesh(colors));
    return this.bodies.get(name);
  }

  dispose() {
    for (const part of [this.ground, this.sun, ...this.bodies.values()]) part.dispose();
  }
}
