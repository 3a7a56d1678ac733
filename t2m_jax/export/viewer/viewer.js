// The page: clock, controls, captions, keys, and `window.t2mViewer` for scripts.

const linear = (hex) => [1, 3, 5].map((i) => Math.pow(parseInt(hex.slice(i, i + 2), 16) / 255, 2.2));
// The ground is written to the page as it is, so its colors stay sRGB in WebGL.
const plain = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);

const THEMES = {
  light: {
    tints: ["#e4ddd2", "#8dbfd2", "#eeb08d", "#27303c"].map(linear),
    accents: ["#1f7f9c", "#c0622f", "#5b7f2b", "#7a4fa3"].map(plain),
    uniforms: {
      ground: plain("#f4f6f9"), lines: plain("#c3ccd7"), shadowStrength: 0.36,
      keyLight: 0.78, fillLight: 0.16, skyLight: [0.42, 0.46, 0.53], groundLight: [0.24, 0.225, 0.21],
    },
  },
  dark: {
    tints: ["#ddd6ca", "#7fb6cc", "#eba37c", "#11161d"].map(linear),
    accents: ["#6cc3df", "#f0a070", "#a6d267", "#c39be8"].map(plain),
    uniforms: {
      ground: plain("#1f2731"), lines: plain("#3a4654"), shadowStrength: 0.62,
      keyLight: 0.85, fillLight: 0.14, skyLight: [0.24, 0.28, 0.34], groundLight: [0.08, 0.085, 0.095],
    },
  },
};

const find = (selector) => document.querySelector(selector);
const stage = find(".stage");
const controls = find(".controls");
const scrub = find(".scrub");
const speedSelect = find(".speed");
const darkness = window.matchMedia("(prefers-color-scheme: dark)");

function fail(text) {
  const message = find(".stage > .message");
  message.textContent = text;
  message.hidden = false;
}

function makeCaptions(figures) {
  const list = find(".captions");
  list.classList.add(figures.length > 1 ? "several" : "alone");
  return figures.map((figure, number) => {
    const caption = document.createElement("p");
    caption.className = "caption";
    caption.dir = "auto";
    caption.textContent = figure.caption;
    caption.title = figure.caption;
    caption.hidden = !figure.caption.trim();
    // A caption has the color of its figure's trail, which shows that they belong together.
    const accent = THEMES.light.accents[number % THEMES.light.accents.length];
    if (figures.length > 1) caption.style.boxShadow = `inset 0 -3px 0 ${css(accent, 1)}`;
    list.append(caption);
    return caption;
  });
}

// A canvas supports only one kind of context in its life, so each attempt needs a new element.
function makeRenderer(figures) {
  let canvas = find(".picture");
  for (const Renderer of [WebGLRenderer, CanvasRenderer]) {
    try {
      return { renderer: new Renderer(canvas, figures), canvas };
    } catch (error) {
      const fresh = canvas.cloneNode();
      canvas.replaceWith(fresh);
      canvas = fresh;
    }
  }
  return null;
}

class Viewer {
  constructor(document_) {
    this.figures = document_.figures.map(unpackFigure);
    this.seconds = document_.seconds;
    const longest = this.figures.reduce((a, b) => (b.frames / b.fps > a.frames / a.fps ? b : a));
    this.fps = longest.fps;
    this.numFrames = longest.frames;
    this.time = 0;
    this.rate = 1;
    this.dirty = true;
    this.running = false;
    this.captionElements = makeCaptions(this.figures);
    this.cameraState = new Camera(this.figures, this.seconds);
    const made = makeRenderer(this.figures);
    if (!made) {
      fail("This browser offers neither WebGL nor a 2D canvas, so the figure cannot be drawn.");
      return;
    }
    Object.assign(this, made);
    this.canvas.setAttribute("aria-label", `Animated figure: ${this.captions.join("; ")}`);
    this.listen();
    this.resize();
    this.playing = this.numFrames > 1 && !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.tick = this.tick.bind(this);
    requestAnimationFrame(this.tick);
  }

  get frame() { return this.time * this.fps; }
  set frame(value) {
    this.time = clamp(Number(value) || 0, 0, this.numFrames - 1) / this.fps;
    this.dirty = true;
  }

  get playing() { return this.running; }
  set playing(value) {
    this.running = Boolean(value) && this.numFrames > 1;
    document.body.classList.toggle("playing", this.running);
    document.body.classList.toggle("paused", !this.running);
    find(".play").setAttribute("aria-label", this.running ? "Pause" : "Play");
    this.last = null;
    this.dirty = true;
  }

  get speed() { return this.rate; }
  set speed(value) {
    this.rate = clamp(Number(value) || 1, 0.05, 10);
    speedSelect.value = String(this.rate);
  }

  get follow() { return this.cameraState.follow; }
  set follow(value) {
    this.cameraState.follow = Boolean(value);
    find(".follow").setAttribute("aria-pressed", String(this.cameraState.follow));
    this.dirty = true;
  }

  get captions() { return this.figures.map((figure) => figure.caption); }
  get camera() {
    const { yaw, pitch, zoom, offset } = this.cameraState;
    return { yaw, pitch, zoom, offset: [...offset] };
  }

  play() { this.playing = true; }
  pause() { this.playing = false; }
  seek(frame) { this.frame = frame; }
  step(frames) {
    this.pause();
    this.frame = Math.round(this.frame) + frames;
  }
  resetView() {
    this.cameraState.reset();
    this.dirty = true;
  }

  tick(now) {
    requestAnimationFrame(this.tick);
    if (this.running) {
      // A tab that was suspended continues at the same frame.
      const passed = this.last === null ? 0 : Math.min((now - this.last) / 1000, 0.25);
      this.last = now;
      this.time = (this.time + passed * this.rate) % this.seconds;
      this.dirty = true;
    }
    if (!this.dirty) return;
    this.dirty = false;
    this.draw();
  }

  draw() {
    const { canvas, cameraState } = this;
    for (const figure of this.figures) poseAt(figure, this.time);
    cameraState.update(this.time, canvas.width / Math.max(canvas.height, 1));
    this.renderer.draw(cameraState, this.time, darkness.matches ? THEMES.dark : THEMES.light);
    if (this.figures.length > 1) this.placeCaptions();
    scrub.value = String(Math.min(Math.round(this.frame), this.numFrames - 1));
    const text = `${this.time.toFixed(1)} / ${this.seconds.toFixed(1)} s`;
    find(".clock").textContent = text;
    scrub.setAttribute("aria-valuetext", `frame ${scrub.value} of ${this.numFrames - 1}, ${this.time.toFixed(1)} seconds`);
  }

  // Several captions are above their figures. If two overlap, the right one moves further right.
  placeCaptions() {
    const { clientWidth, clientHeight } = this.canvas;
    const room = clamp((0.9 * clientWidth) / Math.min(this.figures.length, 6), 90, 240);
    const places = this.figures.map((figure, number) => {
      const caption = this.captionElements[number];
      caption.style.maxWidth = `${room}px`;
      const [x, y, z] = figure.current.subarray(3 * figure.head, 3 * figure.head + 3);
      const p = project(this.cameraState.matrix, x, y + 0.24, z);
      const [width, height] = [caption.offsetWidth, caption.offsetHeight];
      const left = (0.5 + 0.5 * p.x) * clientWidth - width / 2;
      const top = clamp((0.5 - 0.5 * p.y) * clientHeight - height, 4, clientHeight - height - 4);
      caption.style.visibility = p.w > 0 ? "visible" : "hidden";
      return { caption, left, top, width, height };
    });
    const placed = [];
    for (const place of places.sort((a, b) => a.left - b.left)) {
      const beside = placed.filter(({ top, height }) => top < place.top + place.height && place.top < top + height);
      const edge = Math.max(4, ...beside.map(({ left, width }) => left + width + 4));
      place.left = clamp(Math.max(place.left, edge), 4, Math.max(clientWidth - place.width - 4, 4));
      place.caption.style.transform = `translate(${place.left.toFixed(1)}px, ${place.top.toFixed(1)}px)`;
      placed.push(place);
    }
  }

  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(Math.round(this.canvas.clientWidth * ratio), 1);
    const height = Math.max(Math.round(this.canvas.clientHeight * ratio), 1);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.dirty = true;
  }

  listen() {
    const changed = () => { this.dirty = true; };
    listenForGestures(this.canvas, this.cameraState, changed);
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    window.addEventListener("resize", () => this.resize());
    darkness.addEventListener("change", changed);
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.renderer.build();
      changed();
    });
    scrub.max = String(this.numFrames - 1);
    scrub.addEventListener("input", () => {
      this.pause();
      this.frame = Number(scrub.value);
    });
    find(".play").addEventListener("click", () => { this.playing = !this.playing; });
    find(".follow").addEventListener("click", () => { this.follow = !this.follow; });
    find(".reset").addEventListener("click", () => this.resetView());
    speedSelect.addEventListener("change", () => { this.speed = speedSelect.value; });
    document.addEventListener("keydown", (event) => this.key(event));
  }

  changeSpeed(places) {
    const options = [...speedSelect.options].map((option) => Number(option.value));
    const now = options.reduce((best, value, i) => (Math.abs(value - this.rate) < Math.abs(options[best] - this.rate) ? i : best), 0);
    this.speed = options[clamp(now + places, 0, options.length - 1)];
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target;
    if (target === speedSelect) return;
    if (event.key === " " && target.tagName === "BUTTON") return;
    const stride = event.shiftKey ? 10 : 1;
    const actions = {
      " ": () => { this.playing = !this.playing; },
      ArrowRight: () => this.step(stride),
      ArrowLeft: () => this.step(-stride),
      ArrowUp: () => this.changeSpeed(1),
      ArrowDown: () => this.changeSpeed(-1),
      Home: () => this.step(-this.numFrames),
      End: () => this.step(this.numFrames),
      f: () => { this.follow = !this.follow; },
      r: () => this.resetView(),
    };
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

const viewer = new Viewer(JSON.parse(find("#motion-data").textContent));
Object.defineProperty(window, "t2mViewer", { value: viewer });
