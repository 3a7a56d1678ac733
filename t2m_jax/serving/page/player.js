// The buttons that play the stage, and its clock.

import { clamp, find, setIcon, wantsMotion } from "./dom.js";
import { recall, remember } from "./memory.js";

export class Player {
  constructor(stage, session) {
    Object.assign(this, { stage, session });
    find("play").addEventListener("click", () => this.toggle());
    find("step-back").addEventListener("click", () => this.step(-1));
    find("step-forward").addEventListener("click", () => this.step(1));
    find("speed").addEventListener("change", () => this.#setSpeed(find("speed").value));
    this.#setSpeed(recall("speed") ?? 1);
    stage.follow = recall("follow") ?? true;
    find("follow").addEventListener("click", () => this.toggleFollow());
    find("reset-view").addEventListener("click", () => stage.resetView());
    find("scrub").addEventListener("input", (event) => this.seek(Number(event.target.value)));
    stage.onselect = (number) => session.select(number);
    session.onChange(["take"], () => this.#showTake());
    session.onChange(["select"], () => stage.select(session.selected));
    session.onChange(["span"], () => { stage.range = session.span; });
    this.update();
  }

  get fps() {
    return this.session.motion?.fps ?? 20;
  }

  get lastFrame() {
    return Math.max(Math.round(this.stage.seconds * this.fps) - 1, 0);
  }

  get frame() {
    return clamp(Math.round(this.stage.time * this.fps), 0, this.lastFrame);
  }

  // The time of the frame that is shown, in seconds.
  get time() {
    return this.frame / this.fps;
  }

  toggle() {
    if (this.session.take) this.stage.playing = !this.stage.playing;
    this.update();
  }

  #setSpeed(speed) {
    find("speed").value = speed;
    this.stage.speed = Number(speed);
    remember("speed", speed);
  }

  toggleFollow() {
    this.stage.follow = !this.stage.follow;
    remember("follow", this.stage.follow);
    this.update();
  }

  step(frames) {
    this.seek(this.frame + frames);
  }

  seek(frame) {
    this.stage.playing = false;
    this.stage.time = clamp(frame, 0, this.lastFrame) / this.fps;
    this.update();
  }

  #showTake() {
    const { stage, session } = this;
    if (session.take === null) {
      stage.show({ seconds: 0, figures: [] });
      return;
    }
    stage.range = null;
    stage.show(session.take.scene);
    stage.select(session.take.motions.length > 1 ? session.selected : null);
    stage.time = 0;
    stage.playing = stage.seconds > 0 && wantsMotion();
    this.update();
  }

  update() {
    const { stage } = this;
    const play = find("play");
    const label = stage.playing ? "Pause" : "Play";
    if (play.getAttribute("aria-label") !== label) {
      play.setAttribute("aria-label", label);
      setIcon(play, label.toLowerCase());
    }
    find("follow").setAttribute("aria-pressed", String(stage.follow));
    find("clock").textContent = `${stage.time.toFixed(2)} / ${stage.seconds.toFixed(2)} s · frame ${this.frame}`;
  }
}
