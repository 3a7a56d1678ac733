// An orbiting camera and the gestures that move it.

const FIELD_OF_VIEW = 0.6;

class Camera {
  constructor(figures, seconds) {
    this.rate = 20;
    this.path = followPath(figures, seconds, this.rate);
    this.figures = figures;
    this.box = bounds(figures);
    this.follow = true;
    // Largest distance of the roots from the followed path along x, y and z, and half of the visible height.
    this.strays = [0, 0, 0];
    this.path.forEach((spot, i) => {
      for (const figure of figures) {
        const away = subtract(rootAt(figure, Math.round((i / this.rate) * figure.fps)), spot);
        this.strays = this.strays.map((stray, axis) => Math.max(stray, Math.abs(away[axis])));
      }
    });
    this.standing = Math.max(0.5 * this.box.high[1] + 0.33, 1.0);
    this.reset();
  }

  reset() {
    this.yaw = this.figures.length > 1 ? 0.25 : 0.55;
    this.pitch = 0.24;
    this.zoom = 1;
    this.offset = [0, 0, 0];
  }

  // The point on the path at a time, interpolated between samples.
  onPath(seconds) {
    const moment = clamp(seconds * this.rate, 0, this.path.length - 1);
    const before = Math.floor(moment);
    const after = Math.min(before + 1, this.path.length - 1);
    return add(scale(this.path[before], 1 - (moment - before)), scale(this.path[after], moment - before));
  }

  // Horizontal and vertical radius of what must be visible.
  extent() {
    if (!this.follow) {
      const size = subtract(this.box.high, this.box.low);
      return { across: Math.max(Math.hypot(size[0], size[2]) / 2, 0.7), up: Math.max(size[1] / 2 + 0.35, 0.95) };
    }
    return { across: Math.hypot(this.strays[0], 0.5 * this.strays[2]) + 0.8, up: this.standing + 0.12 * this.strays[2] };
  }

  update(seconds, aspect) {
    const middle = scale(add(this.box.low, this.box.high), 0.5);
    const target = this.follow ? this.onPath(seconds) : middle;
    const height = 0.5 * Math.max(this.box.high[1], 1.2) - 0.02;
    this.target = add([target[0], height, target[2]], this.offset);
    const { across, up } = this.extent();
    const half = Math.tan(FIELD_OF_VIEW / 2);
    this.distance = (Math.max(up / half, across / (half * aspect)) + 0.4) / this.zoom;
    const flat = Math.cos(this.pitch) * this.distance;
    this.eye = add(this.target, [
      Math.sin(this.yaw) * flat, Math.sin(this.pitch) * this.distance, Math.cos(this.yaw) * flat,
    ]);
    this.eye[1] = Math.max(this.eye[1], 0.05);
    const view = lookAt(this.eye, this.target, [0, 1, 0]);
    this.matrix = multiply(perspective(FIELD_OF_VIEW, aspect, 0.05 * this.distance, this.distance + 80), view);
    this.right = [view[0], view[4], view[8]];
    this.up = [view[1], view[5], view[9]];
  }

  orbit(dx, dy) {
    this.yaw -= dx * 0.008;
    this.pitch = clamp(this.pitch + dy * 0.006, -0.1, 1.5);
  }

  pan(dx, dy, height) {
    const metres = (2 * Math.tan(FIELD_OF_VIEW / 2) * this.distance) / height;
    this.offset = add(this.offset, add(scale(this.right, -dx * metres), scale(this.up, dy * metres)));
  }

  zoomBy(factor) {
    this.zoom = clamp(this.zoom * factor, 0.15, 8);
  }
}

// Mouse: drag orbits, shift or another button pans, the wheel zooms. Touch: one finger orbits, two pan and pinch.
function listenForGestures(canvas, camera, changed) {
  const pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, size: Math.max(Math.hypot(a.x - b.x, a.y - b.y), 1) };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer || pointers.size > 2) return;
    const two = pointers.size === 2 ? spread() : null;
    const [dx, dy] = [event.clientX - pointer.x, event.clientY - pointer.y];
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (two) {
      const now = spread();
      camera.zoomBy(now.size / two.size);
      camera.pan(now.x - two.x, now.y - two.y, canvas.clientHeight);
    } else if (event.shiftKey || event.buttons > 1) {
      camera.pan(dx, dy, canvas.clientHeight);
    } else {
      camera.orbit(dx, dy);
    }
    changed();
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => {
    camera.reset();
    changed();
  });
  const wheel = (event) => {
    // In an iframe, the wheel scrolls the outer page until the figure is clicked.
    if (window.self !== window.top && document.activeElement !== canvas) return;
    event.preventDefault();
    const pixels = event.deltaMode === 1 ? 16 * event.deltaY : event.deltaY;
    camera.zoomBy(Math.exp(clamp(-pixels, -240, 240) * (event.ctrlKey ? 0.008 : 0.0015)));
    changed();
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
}
