// A cell of the stage: one figure with its ground, light, camera and caption.

// Returns an element of a class inside another.
function addElement(parent, tag, className) {
  const element = document.createElement(tag);
  element.className = className;
  parent.append(element);
  return element;
}

// One figure with its ground, light and camera, in an element of the page.
class FigureCell {
  constructor(parent, figure, number) {
    this.element = addElement(parent, "div", "stage-cell");
    this.element.dataset.number = number;
    this.picture = addElement(this.element, "div", "stage-picture");
    this.caption = addElement(this.element, "p", "stage-caption");
    this.caption.dir = "auto";
    this.caption.title = figure.caption;
    this.caption.hidden = !figure.caption.trim();
    this.number = number;
    this.build(figure);
  }

  build(figure) {
    this.figure = figure;
    this.scene = new THREE.Scene();
    this.body = new BodyMesh(figure);
    this.ground = new GroundMesh(figure);
    this.framing = new Framing(figure);
    this.sky = new THREE.HemisphereLight();
    this.sun = new THREE.DirectionalLight();
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.radius = 5;
    this.sun.shadow.bias = -0.002;
    this.sun.shadow.normalBias = 0.02;
    Object.assign(this.sun.shadow.camera, { left: -1.8, right: 1.8, top: 2.2, bottom: -1.8, near: 1, far: 12 });
    this.scene.add(this.sky, this.sun, this.sun.target, this.body.mesh, ...this.ground.layers);
    this.theme = null;
    this.caption.classList.toggle("changing", this.figure.sentences?.length > 1);
    this.say(0);
  }

  // Shows another body in place of the present one.
  dress(body) {
    this.scene.remove(this.body.mesh);
    this.body.dispose();
    this.body = body;
    this.scene.add(body.mesh);
    this.theme = null;
  }

  // Shows the sentence that is played, which is a part of the caption.
  say(seconds) {
    const begun = (this.figure.sentences ?? []).filter(([first]) => first <= seconds * this.figure.fps + 1e-6);
    const text = begun.length ? begun.at(-1)[1] : this.figure.caption;
    if (this.caption.textContent !== text) this.caption.textContent = text;
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

  paint(theme) {
    if (this.theme === theme) return;
    this.theme = theme;
    const accent = (place) => theme.accents[place % theme.accents.length];
    this.body.paint(this.isTinted ? [accent(this.number), ...theme.tints.slice(1)] : theme.tints);
    this.ground.paint(theme, accent(this.number), accent(this.number + 1));
    this.sky.color.set(theme.sky);
    this.sky.groundColor.set(theme.floor);
    this.sky.intensity = theme.ambient;
    this.sun.intensity = theme.sun;
  }

  pose(seconds, view, aspect) {
    this.say(seconds);
    this.body.pose(seconds);
    this.ground.pose(seconds);
    this.framing.update(view, seconds, aspect);
    const [x, , z] = this.figure.current;
    this.sun.position.set(x + 1.6, 5, z + 2.4);
    this.sun.target.position.set(x, 0.6, z);
  }

  // Where the camera looks.
  get ahead() { return this.framing.camera.getWorldDirection(new THREE.Vector3()).toArray(); }

  // Returns the point of a plane that is seen at a place of the window, or null. The plane has a point and a normal.
  pointAt(clientX, clientY, point, normal) {
    const box = this.picture.getBoundingClientRect();
    if (clientX < box.left || clientX > box.right || clientY < box.top || clientY > box.bottom) return null;
    const { camera } = this.framing;
    const [x, y] = [(2 * (clientX - box.left)) / box.width - 1, 1 - (2 * (clientY - box.top)) / box.height];
    const ray = new THREE.Vector3(x, y, 0.5).unproject(camera).sub(camera.position);
    const across = new THREE.Vector3(...normal);
    const share = new THREE.Vector3(...point).sub(camera.position).dot(across) / ray.dot(across);
    return share > 0 && Number.isFinite(share) ? ray.multiplyScalar(share).add(camera.position).toArray() : null;
  }

  // Returns where in the window a point is seen, or null.
  placeOf(point) {
    const box = this.picture.getBoundingClientRect();
    const { x, y, z } = new THREE.Vector3(...point).project(this.framing.camera);
    if (Math.abs(x) > 1 || Math.abs(y) > 1 || Math.abs(z) > 1) return null;
    return { x: box.left + ((x + 1) / 2) * box.width, y: box.top + ((1 - y) / 2) * box.height };
  }

  // What must be disposed of.
  get parts() {
    return [this.body, this.ground, this.sun];
  }
}
