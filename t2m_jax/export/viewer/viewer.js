// The exported page: a stage, and controls below it. Scripts can use `window.t2mViewer`.

const find = (selector) => document.querySelector(selector);
const scrub = find(".scrub");
const speedSelect = find(".speed");

class Viewer {
  constructor(scene) {
    this.stage = new Stage(find(".stage"));
    this.captions = scene.figures.map((figure) => figure.caption);
    this.stage.onchange = () => this.showState();
    this.stage.show(scene);
    this.fps = this.stage.fps;
    this.seconds = scene.seconds;
    this.numFrames = Math.max(...scene.figures.map((figure) => figure.frames));
    scrub.max = String(this.numFrames - 1);
    this.listen();
    this.playing = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  }

  get frame() { return this.stage.time * this.fps; }
  set frame(value) { this.stage.time = clamp(Number(value) || 0, 0, this.numFrames - 1) / this.fps; }
  get playing() { return this.stage.playing; }
  set playing(value) { this.stage.playing = value; }
  get speed() { return this.stage.speed; }
  set speed(value) { this.stage.speed = value; }
  get follow() { return this.stage.follow; }
  set follow(value) { this.stage.follow = value; }
  get camera() {
    const { yaw, pitch, zoom, offset } = this.stage.view;
    return { yaw, pitch, zoom, offset: offset.toArray() };
  }

  play() { this.playing = true; }
  pause() { this.playing = false; }
  seek(frame) { this.frame = frame; }
  resetView() { this.stage.resetView(); }
  step(frames) {
    this.pause();
    this.frame = Math.round(this.frame) + frames;
  }

  showState() {
    const { stage } = this;
    document.body.classList.toggle("playing", stage.playing);
    document.body.classList.toggle("paused", !stage.playing);
    find(".play").setAttribute("aria-label", stage.playing ? "Pause" : "Play");
    find(".follow").setAttribute("aria-pressed", String(stage.follow));
    speedSelect.value = String(stage.speed);
    scrub.value = String(Math.min(Math.round(this.frame), this.numFrames - 1));
    find(".clock").textContent = `${stage.time.toFixed(1)} / ${this.seconds.toFixed(1)} s`;
    scrub.setAttribute("aria-valuetext", `frame ${scrub.value} of ${this.numFrames - 1}, ${stage.time.toFixed(1)} seconds`);
  }

  listen() {
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
    const now = options.reduce((best, value, i) => (Math.abs(value - this.speed) < Math.abs(options[best] - this.speed) ? i : best), 0);
    this.speed = options[clamp(now + places, 0, options.length - 1)];
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target === speedSelect) return;
    if (event.key === " " && event.target.tagName === "BUTTON") return;
    const stride = event.shiftKey ? 10 : 1;
    const actions = {
      " ": () => { this.playing = !this.playing; },
      ArrowRight: () => this.step(stride),
      ArrowLeft: () => this.step(-stride),
      ArrowUp: () => this.changeSpeed(1),
      ArrowDown: () => this.changeSpeed(-1),
      Home: () => this.step(-this.numFrames),
      End: () => this.step(this.numFrames),
      "+": () => this.stage.zoom(1.2),
      "-": () => this.stage.zoom(1 / 1.2),
      ",": () => this.stage.turn(-25),
      ".": () => this.stage.turn(25),
      f: () => { this.follow = !this.follow; },
      r: () => this.resetView(),
    };
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

const viewer = new Viewer(window.t2mScene);
Object.defineProperty(window, "t2mViewer", { value: viewer });
