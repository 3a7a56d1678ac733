// The track under the stage: scrub bar, handles of the span, and the blocks of the sentences.

import { Blocks } from "./blocks.js";
import { clamp, create, find, seconds } from "./dom.js";

const RULER_STEPS = [0.5, 1, 2, 5, 10, 30, 60];
const MOST_TICKS = 12;

export class Timeline {
  constructor(stage, session, player, options) {
    Object.assign(this, { stage, session, player, track: find("track"), scrub: find("scrub") });
    this.blocks = new Blocks(this, options);
    this.handles = [find("begin-handle"), find("end-handle")];
    this.numbers = [find("begin"), find("end")];
    this.handles.forEach((handle, side) => this.#listenToHandle(handle, side));
    this.numbers.forEach((input, side) => {
      input.addEventListener("change", () => {
        this.setSide(side, input.valueAsNumber); // an empty field changes nothing
        input.value = this.#shownSpan[side].toFixed(2);
      });
    });
    find("whole").addEventListener("click", () => session.setSpan(null));
    session.onChange(["take", "select"], () => this.#draw());
    session.onChange(["select"], () => this.#limitSpan());
    session.onChange(["span"], () => this.#drawSpan());
    this.#draw();
  }

  // What changes with each frame.
  update() {
    const { stage, player, scrub } = this;
    if (this.whole !== stage.seconds) this.#draw(); // frames are still coming
    scrub.value = player.frame;
    scrub.setAttribute("aria-valuetext", `Frame ${player.frame} of ${player.lastFrame}, ${seconds(stage.time)}`);
    this.track.style.setProperty("--now", this.fraction(player.frame / player.fps));
  }

  get #shownSpan() {
    return this.session.span ?? [0, this.length];
  }

  // Where a time is on the track, from 0 to 1.
  fraction(time) {
    return this.extent ? clamp(time / this.extent, 0, 1) : 0;
  }

  // Makes room for a motion of so many seconds, if it is longer than the one that is shown.
  stretch(length) {
    this.extent = Math.max(length, this.whole);
    this.scrub.max = Math.round(this.extent * this.player.fps);
    this.#drawRuler();
    this.#drawSpan();
    this.update();
  }

  // Moves the begin (0) or the end (1) of the span to a time; both are at frames.
  setSide(side, time) {
    const { fps } = this.player;
    if (!this.session.motion || !Number.isFinite(time)) return;
    const span = [...this.#shownSpan];
    const frame = 1 / fps;
    const [low, high] = side === 0 ? [0, span[1] - frame] : [span[0] + frame, this.length];
    span[side] = clamp(Math.round(time * fps) / fps, low, high);
    const whole = span[0] < frame / 2 && span[1] > this.length - frame / 2;
    this.session.setSpan(whole ? null : span);
  }

  #listenToHandle(handle, side) {
    const timeAt = (event) => {
      const { left, width } = this.scrub.getBoundingClientRect();
      const thumb = parseFloat(getComputedStyle(this.track).getPropertyValue("--thumb"));
      return ((event.clientX - left - thumb / 2) / (width - thumb)) * this.extent;
    };
    handle.addEventListener("pointerdown", (event) => {
      handle.setPointerCapture(event.pointerId);
      event.preventDefault();
      handle.focus();
    });
    handle.addEventListener("pointermove", (event) => {
      if (handle.hasPointerCapture(event.pointerId)) this.setSide(side, timeAt(event));
    });
    handle.addEventListener("keydown", (event) => {
      const frames = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
      const ends = { Home: 0, End: this.length }[event.key];
      if (frames === undefined && ends === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      this.setSide(side, ends ?? this.#shownSpan[side] + (frames * (event.shiftKey ? 10 : 1)) / this.player.fps);
    });
  }

  #draw() {
    this.whole = this.extent = this.stage.seconds; // of the longest sample
    this.length = this.#selectedLength();
    find("timeline").classList.toggle("idle", !this.session.motion);
    for (const element of find("timeline").querySelectorAll("button, input, select")) element.disabled = !this.session.motion;
    this.scrub.max = this.player.lastFrame + 1; // the end of the last frame, so that the thumb agrees with the ruler
    this.#drawRuler();
    this.blocks.draw();
    this.#drawSpan();
  }

  // Seconds of the selected one of several samples, where all of it is shown.
  #selectedLength() {
    const { take, motion } = this.session;
    const longest = Math.max(0, ...(take?.motions ?? []).map((one) => one.seconds));
    return motion && Math.abs(longest - this.whole) < 1 / this.player.fps ? motion.seconds : this.whole;
  }

  // A shorter sample ends before the span of a longer one.
  #limitSpan() {
    const { span } = this.session;
    if (!span || span[1] <= this.length) return;
    this.session.setSpan(span[0] < this.length - 1 / this.player.fps ? [span[0], this.length] : null);
  }

  #drawRuler() {
    const step = RULER_STEPS.find((one) => this.extent / one <= MOST_TICKS) ?? this.extent;
    const count = this.extent ? Math.floor(this.extent / step) + 1 : 0;
    find("ruler").replaceChildren(...Array.from({ length: count }, (_, index) => {
      const tick = create("span", { className: "tick", textContent: `${index * step}` });
      tick.style.setProperty("--at", this.fraction(index * step));
      return tick;
    }));
  }

  #drawSpan() {
    const span = this.#shownSpan;
    this.track.classList.toggle("trimmed", this.session.span !== null);
    find("whole").disabled = this.session.span === null;
    this.blocks.showChosen();
    this.track.style.setProperty("--begin", this.fraction(span[0]));
    this.track.style.setProperty("--end", this.fraction(span[1]));
    this.handles.forEach((handle, side) => {
      handle.setAttribute("aria-valuemin", "0");
      handle.setAttribute("aria-valuemax", this.length.toFixed(2));
      handle.setAttribute("aria-valuenow", span[side].toFixed(2));
      handle.setAttribute("aria-valuetext", seconds(span[side]));
      handle.setAttribute("aria-disabled", String(!this.session.motion));
    });
    this.numbers.forEach((input, side) => {
      input.max = this.length.toFixed(2);
      if (document.activeElement !== input) input.value = this.session.motion ? span[side].toFixed(2) : "";
    });
  }
}
