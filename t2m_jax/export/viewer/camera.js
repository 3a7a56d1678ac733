// The camera that all cells share: its direction and zoom, and what each cell looks at; and the gestures that move it.

const FIELD_OF_VIEW = 34;  // degrees

class OrbitView {
  constructor() {
    this.follow = true;
    this.reset();
  }

  reset() {
    this.yaw = 0.55;
    this.pitch = 0.2;
    this.zoom = 1;
    this.offset = new THREE.Vector3();
  }

  orbit(dx, dy) {
    this.yaw -= dx * 0.008;
    this.pitch = clamp(this.pitch + dy * 0.006, -0.1, 1.5);
  }

  pan(dx, dy, height) {
    const meters = (2 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360) * (this.distance || 4)) / height;
    this.offset.x -= meters * dx * Math.cos(this.yaw) + meters * dy * Math.sin(this.yaw) * Math.sin(this.pitch);
    this.offset.z += meters * dx * Math.sin(this.yaw) - meters * dy * Math.cos(this.yaw) * Math.sin(this.pitch);
    this.offset.y += meters * dy * Math.cos(this.pitch);
  }

  zoomBy(factor) {
    this.zoom = clamp(this.zoom * factor, 0.15, 8);
  }
}

// What the camera of one figure needs: the smoothed path of the root, how far the root strays from it, and the bounds.
class Framing {
  constructor(figure) {
    const path = rootPath(figure);
    const reach = Math.max(1, Math.round(0.5 * figure.fps));
    this.fps = figure.fps;
    this.path = smoothPath(smoothPath(path, reach), reach);
    this.strays = path.reduce((most, place, i) => Math.max(most, Math.hypot(place[0] - this.path[i][0], place[2] - this.path[i][2])), 0);
    this.box = boundsOf(figure);
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 200);
  }

  // The point on the path at a time, interpolated between frames.
  onPath(seconds) {
    const moment = clamp(seconds * this.fps, 0, this.path.length - 1);
    const before = Math.floor(moment);
    const after = this.path[Math.min(before + 1, this.path.length - 1)];
    return this.path[before].map((value, axis) => value + (moment - before) * (after[axis] - value));
  }

  // Puts the camera where the view says, so that what matters is visible at this ratio of width to height.
  update(view, seconds, aspect) {
    const { low, high } = this.box;
    const middle = view.follow ? this.onPath(seconds) : low.map((value, axis) => (value + high[axis]) / 2);
    const top = Math.max(high[1], 1.2);
    const across = view.follow ? this.strays + 0.75 : Math.max(Math.hypot(high[0] - low[0], high[2] - low[2]) / 2 + 0.4, 0.75);
    const up = 0.5 * top + 0.2 + (view.follow ? 0.3 * this.strays : 0.12 * across);
    const half = Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
    const distance = (Math.max(up / half, across / (half * aspect)) + 0.4) / view.zoom;
    view.distance = distance;
    const target = new THREE.Vector3(middle[0], 0.5 * top - 0.04, middle[2]).add(view.offset);
    const flat = Math.cos(view.pitch) * distance;
    const { camera } = this;
    camera.position.set(Math.sin(view.yaw) * flat, Math.sin(view.pitch) * distance, Math.cos(view.yaw) * flat).add(target);
    camera.position.y = Math.max(camera.position.y, 0.05);
    camera.lookAt(target);
    camera.aspect = aspect;
    camera.near = 0.05 * distance;
    camera.far = distance + 80;
    camera.updateProjectionMatrix();
  }
}

// The framing of two figures in one picture: it follows the point between them.
function sharedFraming([first, second]) {
  const framing = new Framing(first.frames / first.fps >= second.frames / second.fps ? first : second);
  const others = [first, second].map((figure) => new Framing(figure));
  framing.path = framing.path.map((_, frame) => {
    const [a, b] = others.map((other) => other.onPath(frame / framing.fps));
    framing.strays = Math.max(framing.strays, Math.hypot(a[0] - b[0], a[2] - b[2]) / 2 + others[0].strays);
    return a.map((value, axis) => (value + b[axis]) / 2);
  });
  const sides = (side, pick) => others[0].box[side].map((value, axis) => pick(value, others[1].box[side][axis]));
  framing.box = { low: sides("low", Math.min), high: sides("high", Math.max) };
  return framing;
}

// Mouse: drag orbits, shift or another button pans, the wheel zooms. Touch: one finger orbits, two pan and pinch.
// `onTap` gets the element that was pressed without a movement.
function listenForGestures(element, view, { changed, onTap }) {
  const pointers = new Map();
  let moved = 0;
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.max(Math.hypot(a.x - b.x, a.y - b.y), 1) };
  };
  element.addEventListener("pointerdown", (event) => {
    if (!pointers.size) moved = 0;
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, target: event.target });
  });
  element.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer || pointers.size > 2) return;
    const two = pointers.size === 2 ? spread() : null;
    const [dx, dy] = [event.clientX - pointer.x, event.clientY - pointer.y];
    moved += Math.abs(dx) + Math.abs(dy);
    pointers.set(event.pointerId, { ...pointer, x: event.clientX, y: event.clientY });
    if (two) {
      const now = spread();
      view.zoomBy(now.size / two.size);
      view.pan(now.x - two.x, now.y - two.y, element.clientHeight);
    } else if (event.shiftKey || event.buttons > 1) {
      view.pan(dx, dy, element.clientHeight);
    } else {
      view.orbit(dx, dy);
    }
    changed();
  });
  element.addEventListener("pointerup", (event) => {
    if (moved < 6 && pointers.has(event.pointerId)) onTap(pointers.get(event.pointerId).target);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    element.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("dblclick", () => {
    view.reset();
    changed();
  });
  element.addEventListener("wheel", (event) => {
    // In an iframe, the wheel scrolls the outer page until the figure is clicked; a grid that is too high scrolls, too.
    const scrolls = element.scrollHeight > element.clientHeight + 1;
    if (!event.ctrlKey && (scrolls || (window.self !== window.top && !document.hasFocus()))) return;
    event.preventDefault();
    const pixels = event.deltaMode === 1 ? 16 * event.deltaY : event.deltaY;
    view.zoomBy(Math.exp(clamp(-pixels, -240, 240) * (event.ctrlKey ? 0.008 : 0.0015)));
    changed();
  }, { passive: false });
}
