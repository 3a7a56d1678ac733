// The stage: figures in the cells of a grid, which play in sync. `window.T2M.Stage` is its public face.

const THEMES = {
  light: {
    tints: ["#e9e1d5", "#7fb9d0", "#eda47c", "#27303c"], accents: ["#1f7f9c", "#c0622f", "#5b7f2b", "#7a4fa3"],
    page: "#f1f4f7", lines: "#ccd4dd", shadow: 0.3, sky: "#ffffff", floor: "#c9c2b8", ambient: 1.5, sun: 1.9,
  },
  dark: {
    tints: ["#e2dacd", "#6fb0c8", "#e2905f", "#11161d"], accents: ["#6cc3df", "#f0a070", "#a6d267", "#c39be8"],
    page: "#171d25", lines: "#36414e", shadow: 0.5, sky: "#aebfd2", floor: "#2a2d31", ambient: 1.1, sun: 1.7,
  },
};
const MAX_PIXEL_RATIO = 2;
const DETAILS = [
  { ratio: MAX_PIXEL_RATIO, shadow: 1024 },
  { ratio: 1, shadow: 512 },
  { ratio: 0.75, shadow: 256 },
  { ratio: 0.5, shadow: 0 },
];                          // from full to light drawing
const SLOW_FRAME = 0.05;    // seconds between frames; if most take longer, less is drawn
const WATCHED_FRAMES = 8;
const SMALLEST_CELL = 150;  // pixels; a grid with smaller cells scrolls
const PORTRAIT = 0.8;       // ratio of width to height at which a standing figure fills a cell
const CAPTION_HEIGHT = 44;  // pixels

const darkness = window.matchMedia("(prefers-color-scheme: dark)");
const themeNow = () => {
  const chosen = document.documentElement.dataset.theme;
  return THEMES[chosen === "dark" || (chosen !== "light" && darkness.matches) ? "dark" : "light"];
};

// Returns how many columns make the pictures of a grid largest; of similar sizes, those with fewer rows, to scroll less.
function columnsFor(count, width, height) {
  const rows = (columns) => Math.ceil(count / columns);
  const size = (columns) =>
    Math.min(width / columns / PORTRAIT, Math.max(height / rows(columns), SMALLEST_CELL + CAPTION_HEIGHT) - CAPTION_HEIGHT);
  let best = 1;
  for (let columns = 2; columns <= count; columns++) {
    const larger = size(columns) / size(best);
    if (larger > 1.01 || (larger > 0.95 && rows(columns) < rows(best))) best = columns;
  }
  return best;
}

class Stage {
  constructor(container) {
    this.container = container;
    container.classList.add("stage-box");
    this.canvas = addElement(container, "canvas", "stage-canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "No figure");
    this.grid = addElement(container, "div", "stage-grid");
    Object.assign(this, { cells: [], seconds: 0, onchange: () => {}, onselect: () => {} });
    Object.assign(this, { detail: 0, intervals: [], scenery: new Scenery() });
    Object.assign(this, { moment: 0, rate: 1, running: false, span: null, dirty: true, last: null, ended: false });
    this.view = new OrbitView();
    this.cleanups = [];
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    } catch {
      const message = addElement(container, "p", "stage-message");
      message.setAttribute("role", "alert");
      message.textContent = "This browser does not offer WebGL 2, so the figure cannot be drawn.";
      this.canvas.hidden = true;
      return;
    }
    this.renderer.shadowMap.enabled = true;
    this.renderer.setScissorTest(true);
    this.listen();
    this.tick = this.tick.bind(this);
    requestAnimationFrame(this.tick);
  }

  // Replaces all figures. Direction and zoom of the camera stay.
  show(scene) {
    // Fewer figures may be drawn in full again.
    if (scene.figures.length < this.cells.length) this.detail = 0;
    this.intervals = [];
    this.clear();
    this.seconds = scene.seconds;
    if (this.renderer) this.cells = scene.figures.map((record, k) => new FigureCell(this.grid, unpackFigure(record), k));
    this.grid.classList.toggle("alone", this.cells.length === 1);
    this.grid.classList.remove("together");
    const captions = scene.figures.map((record) => record.caption).filter(Boolean);
    const label = `Animated figure: ${captions.join("; ") || "no caption"}`;
    this.canvas.setAttribute("aria-label", scene.figures.length ? label : "No figure");
    this.time = this.moment;
    this.resize();
  }

  // Adds frames to a figure that is still generated.
  extend(k, record) {
    const cell = this.cells[k];
    if (!cell) return;
    const figure = joinFigures(cell.figure, unpackFigure(record));
    cell.dispose();
    cell.build(figure);
    this.seconds = Math.max(this.seconds, figure.frames / figure.fps);
    this.changed();
  }

  // Shows a character in place of a figure; without one, the figure.
  dress(k, character) {
    this.cells[k]?.dress(character);
    this.changed();
  }

  get time() { return this.moment; }
  set time(value) {
    this.moment = clamp(Number(value) || 0, 0, Math.max(this.seconds - 1 / this.fps, 0));
    this.changed();
  }

  // Frames per second of the longest figure.
  get fps() {
    const figures = this.cells.map((cell) => cell.figure);
    return figures.reduce((a, b) => (b.frames / b.fps > a.frames / a.fps ? b : a), { frames: 0, fps: 20 }).fps;
  }

  get playing() { return this.running; }
  set playing(value) {
    this.running = Boolean(value) && this.seconds > 1 / this.fps;
    this.last = null;
    this.changed();
  }

  get speed() { return this.rate; }
  set speed(value) {
    this.rate = clamp(Number(value) || 1, 0.05, 10);
    this.changed();
  }

  get follow() { return this.view.follow; }
  set follow(value) {
    this.view.follow = Boolean(value);
    this.changed();
  }

  // The part in seconds that is played, [begin, end], or null for all.
  get range() { return this.span; }
  set range(value) {
    this.span = value;
    this.changed();
  }

  resetView() {
    this.view.reset();
    this.changed();
  }

  turn(pixels) {
    this.view.orbit(pixels, 0);
    this.changed();
  }

  zoom(factor) {
    this.view.zoomBy(factor);
    this.changed();
  }

  select(chosen) {
    for (const cell of this.cells) cell.element.classList.toggle("selected", cell.number === chosen);
  }

  // Whether two figures stand on one ground, in one picture.
  get together() { return this.grid.classList.contains("together"); }
  set together(value) {
    const [first, second] = this.cells;
    if (this.cells.length !== 2 || Boolean(value) === this.together) return;
    this.grid.classList.toggle("together", value);
    first.framing = value ? sharedFraming([first.figure, second.figure]) : new Framing(first.figure);
    second.isTinted = Boolean(value);
    this.resize();
  }

  // Returns the point [x, z] on the ground of a figure that is seen at a place of the window, or null.
  groundAt(number, clientX, clientY) {
    const point = this.cells[number]?.pointAt(clientX, clientY, [0, 0, 0], [0, 1, 0]);
    return point ? [point[0], point[2]] : null;
  }

  // How much higher a figure is drawn than its motion is: soles have a thickness. What follows is in meters of the motion.
  liftOf(number) { return this.cells[number].figure.lift ?? 0; }

  // Returns the point that is seen at a place of the window and is as far away as another point, or null.
  pointBeside(number, clientX, clientY, [x, y, z]) {
    const cell = this.cells[number];
    const lift = this.liftOf(number);
    const point = cell.pointAt(clientX, clientY, [x, y + lift, z], cell.ahead);
    return point && [point[0], point[1] - lift, point[2]];
  }

  // Returns where a point is seen: x and y in pixels of the window, or null if it is not in the picture.
  placeOf(number, [x, y, z]) { return this.cells[number].placeOf([x, y + this.liftOf(number), z]); }

  // Returns a point of a figure at the present time, [x, y, z]; its joints come first.
  pointOf(number, index) {
    const { figure } = this.cells[number];
    poseAt(figure, this.moment); // which may not have been drawn yet
    const [x, y, z] = figure.current.subarray(3 * index, 3 * index + 3);
    return [x, y - this.liftOf(number), z];
  }

  // Draws a line through points [x, z] on the ground of a figure.
  drawOnGround(number, points) {
    this.cells[number]?.draw(points);
    this.changed();
  }

  changed() { this.dirty = true; }

  tick(now) {
    if (this.ended) return;
    requestAnimationFrame(this.tick);
    if (this.running) {
      // A tab that was suspended continues at the same frame.
      const passed = this.last === null ? 0 : Math.min((now - this.last) / 1000, 0.25);
      if (this.last !== null) this.watch(passed);
      this.last = now;
      const [begin, end] = this.span || [0, this.seconds];
      const next = this.moment + passed * this.rate;
      this.moment = next >= end || next < begin ? begin : next;
      this.dirty = true;
    }
    if (!this.dirty) return;
    this.dirty = false;
    this.draw();
    this.onchange();
  }

  // Draws less if most of the last frames took too long, as without a graphics card.
  watch(interval) {
    this.intervals.push(interval);
    if (this.intervals.length < WATCHED_FRAMES) return;
    const slow = this.intervals.sort((a, b) => a - b)[WATCHED_FRAMES / 2] > SLOW_FRAME;
    this.intervals = [];
    if (!slow || this.detail === DETAILS.length - 1) return;
    this.detail += 1;
    this.resize();
  }

  draw() {
    const theme = themeNow();
    const { renderer } = this;
    const frame = this.canvas.getBoundingClientRect();
    renderer.setScissor(0, 0, frame.width, frame.height);
    renderer.setViewport(0, 0, frame.width, frame.height);
    renderer.setClearColor(theme.page, 1);
    renderer.clear();
    this.scenery.castShadow(DETAILS[this.detail].shadow);
    for (const cell of this.cells) {
      const seen = this.together ? this.cells[0] : cell; // two on one ground are in one picture
      const box = seen.picture.getBoundingClientRect();
      if (box.bottom < frame.top || box.top > frame.bottom || box.width < 2 || box.height < 2) continue;
      cell.say(this.moment);
      cell.framing.update(this.view, this.moment, box.width / box.height);
      const place = [box.left - frame.left, frame.bottom - box.bottom, box.width, box.height];
      renderer.setViewport(...place);
      renderer.setScissor(...place);
      renderer.autoClear = !this.together || cell === this.cells[0]; // the second figure comes into the same picture
      this.scenery.draw(renderer, seen.framing.camera, { cell, theme, seconds: this.moment });
    }
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.container;
    if (!this.renderer || !width || !height) return;
    const columns = columnsFor(this.cells.length, width, height);
    this.grid.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
    this.canvas.style.height = `${height}px`;
    // In a grid that is too high, a finger that moves up or down scrolls; without figures, it scrolls the page.
    const scrolls = this.cells.length === 0 || this.container.scrollHeight > height + 1;
    this.container.style.touchAction = scrolls ? "pan-y" : "none";
    const ratio = Math.min(DETAILS[this.detail].ratio, this.cells.length > 6 ? 1 : MAX_PIXEL_RATIO);
    const pixels = Math.min(window.devicePixelRatio || 1, ratio);
    const size = `${width} ${height} ${pixels}`;
    if (size !== this.size) {  // a new canvas takes long, also one of the same size
      this.size = size;
      this.renderer.setPixelRatio(pixels);
      this.renderer.setSize(width, height, false);
    }
    this.changed();
  }

  listen() {
    const on = (target, name, action) => {
      target.addEventListener(name, action);
      this.cleanups.push(() => target.removeEventListener(name, action));
    };
    const changed = () => this.changed();
    listenForGestures(this.container, this.view, {
      changed,
      onTap: (target) => {
        const cell = target.closest(".stage-cell");
        if (cell) this.onselect(Number(cell.dataset.number));
      },
    });
    const sizes = new ResizeObserver(() => this.resize());
    sizes.observe(this.container);
    const themes = new MutationObserver(changed);
    themes.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    this.cleanups.push(() => sizes.disconnect(), () => themes.disconnect());
    on(darkness, "change", changed);
    on(this.container, "scroll", changed);
    on(this.canvas, "webglcontextrestored", changed);
  }

  clear() {
    for (const cell of this.cells) cell.dispose();
    this.cells = [];
    this.grid.replaceChildren();
  }

  dispose() {
    this.ended = true;
    this.clear();
    this.scenery.dispose();
    for (const cleanup of this.cleanups) cleanup();
    if (this.renderer) this.renderer.dispose();
    this.container.replaceChildren();
  }
}

window.T2M = { Stage };
