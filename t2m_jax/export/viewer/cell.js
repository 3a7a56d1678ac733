// A cell of the stage: one figure with its path, camera and caption.

// Returns an element of a class inside another.
function addElement(parent, tag, className) {
  const element = document.createElement(tag);
  element.className = className;
  parent.append(element);
  return element;
}

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
    this.path = ribbonGeometry(smoothPath(rootPath(figure), 4));
    this.drawn = ribbonGeometry([]);
    this.framing = new Framing(figure);
    this.caption.classList.toggle("changing", figure.sentences?.length > 1);
    this.say(0);
  }

  // Shows a character in place of the figure, or the figure again.
  dress(character = null) {
    this.character?.dispose();
    this.character = character;
  }

  // Shows a line through points on the ground, [x, z].
  draw(points) {
    this.drawn.dispose();
    this.drawn = ribbonGeometry(points.map(([x, z]) => [x, 0, z]));
  }

  // Shows the sentence that is played, which is a part of the caption.
  say(seconds) {
    const begun = (this.figure.sentences ?? []).filter(([first]) => first <= seconds * this.figure.fps + 1e-6);
    const text = begun.length ? begun.at(-1)[1] : this.figure.caption;
    if (this.caption.textContent !== text) this.caption.textContent = text;
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

  dispose() {
    this.dress();
    this.path.dispose();
    this.drawn.dispose();
  }
}
