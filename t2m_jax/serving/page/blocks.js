// The sentences of a motion as blocks of the timeline. A click chooses one, and its end makes it longer or shorter.

import { clamp, create, find, seconds, showMessage } from "./dom.js";
import { complaint } from "./fields.js";
import { partsOf } from "./session.js";

const KEYS = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -5, PageUp: 5 }; // steps of a length

const lengthOf = ({ span }) => span[1] - span[0];

export class Blocks {
  #motion = null;
  #take = null;
  #parts = [];
  #lengths = []; // as they are shown; while an end is dragged, one is not that of the motion

  // `step` and `longest` are seconds; `onResize` gets a part (see `partsOf`) and its new length, and may return a promise
  // for the end of its work.
  constructor(timeline, { step, longest, onResize }) {
    Object.assign(this, { timeline, step, longest, onResize, list: find("blocks"), number: find("sentence-length") });
    Object.assign(this.number, { min: step, max: longest, step });
    this.number.addEventListener("change", () => this.#read());
    this.list.addEventListener("focusout", () => this.#restore());
  }

  draw() {
    const { motion, take } = this.timeline.session;
    // While frames of another motion come, the timeline is drawn often: meanwhile, blocks stay under the pointer.
    if (motion !== this.#motion || take !== this.#take) this.#makeParts(motion, take);
    this.#lengths = this.#parts.map(lengthOf);
    this.#show();
  }

  #makeParts(motion, take) {
    this.#motion = motion;
    this.#take = take;
    const focused = this.#handles.indexOf(document.activeElement);
    this.#parts = motion ? partsOf(motion) : [];
    this.list.replaceChildren(...this.#parts.map((part, place) => {
      const hasEnd = part.caption && take.kind !== "comparison";
      return create("div", { className: "part" }, this.#makeBlock(part), ...(hasEnd ? [this.#makeHandle(place)] : []));
    }));
    this.#handles[focused]?.focus(); // its motion has become another one
  }

  get #handles() {
    return [...this.list.querySelectorAll(".block-end")];
  }

  // The place of the sentence whose part is the span, or -1. A motion of one sentence has no other.
  get #chosen() {
    const { motion, span, take } = this.timeline.session;
    if (!motion || take.kind === "comparison") return -1;
    if (this.#parts.length === 1) return 0;
    const frames = (times) => `${times.map((time) => Math.round(time * motion.fps))}`;
    return this.#parts.findIndex((part) => span && frames(part.span) === frames(span));
  }

  showChosen() {
    const place = this.#chosen;
    // Disabled and not hidden, so that the stage keeps its size.
    const isPart = place >= 0 && this.#parts.length > 1;
    find("replace-sentence").disabled = !isPart;
    find("replace-sentence").textContent = `Replace sentence${isPart ? ` ${place + 1}` : ""}`;
    this.number.disabled = !this.#parts[place]?.caption;
    if (document.activeElement !== this.number) this.#showLength();
  }

  #showLength() {
    this.number.value = this.number.disabled ? "" : this.#lengths[this.#chosen].toFixed(1);
  }

  // Takes the length that was typed. An empty field changes nothing.
  async #read() {
    const { validity, valueAsNumber } = this.number;
    const isOutside = validity.rangeUnderflow || validity.rangeOverflow;
    if (isOutside) showMessage(complaint(this.number));
    else this.#try(this.#chosen, valueAsNumber);
    this.#showLength();
    await this.#resize(this.#chosen);
    this.#showLength();
  }

  #makeBlock({ caption, span }) {
    const { session, player } = this.timeline;
    const choose = () => {
      session.setSpan(this.#parts.length > 1 ? span : null);
      player.seek(Math.round(span[0] * player.fps));
    };
    const block = create("button", { type: "button", className: "block", textContent: caption || "Motion", dir: "auto", onclick: choose });
    block.title = `${caption} (${seconds(span[0])} to ${seconds(span[1])})`;
    return block;
  }

  #makeHandle(place) {
    const handle = create("div", { className: "block-end", role: "slider", tabIndex: 0, title: "Drag to change the length; or arrow keys and Enter" });
    handle.setAttribute("aria-label", `Length of sentence ${place + 1}`);
    handle.setAttribute("aria-valuemin", this.step);
    handle.setAttribute("aria-valuemax", this.longest);
    this.#listenToPointer(handle, place);
    handle.addEventListener("keydown", (event) => {
      const steps = KEYS[event.key];
      if (steps) this.#try(place, this.#lengths[place] + steps * this.step);
      else if (event.key === "Enter") this.#resize(place);
      else if (event.key === "Escape" && this.#isChanged(place)) this.#restore();
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    return handle;
  }

  #listenToPointer(handle, place) {
    let begin = null;
    handle.addEventListener("pointerdown", (event) => {
      handle.setPointerCapture(event.pointerId);
      event.preventDefault();
      handle.focus();
      begin = { x: event.clientX, length: this.#lengths[place], scale: this.timeline.extent / this.list.clientWidth };
    });
    handle.addEventListener("pointermove", (event) => {
      if (handle.hasPointerCapture(event.pointerId)) this.#try(place, begin.length + (event.clientX - begin.x) * begin.scale);
    });
    handle.addEventListener("pointerup", () => this.#resize(place));
    handle.addEventListener("pointercancel", () => this.#restore());
  }

  #isChanged(place) {
    return Math.abs(this.#lengths[place] - lengthOf(this.#parts[place])) > this.step / 2;
  }

  // Shows a sentence with another length.
  #try(place, length) {
    if (!Number.isFinite(length)) return;
    this.#lengths[place] = clamp(Math.round(length / this.step) * this.step, this.step, this.longest);
    this.timeline.stretch(this.#lengths.reduce((sum, one) => sum + one, 0));
    this.#show();
  }

  async #resize(place) {
    if (this.#isChanged(place)) await this.onResize(this.#parts[place], this.#lengths[place]);
    this.#restore(); // also if it was refused or canceled
  }

  #restore() {
    if (!this.#parts.some((_, place) => this.#isChanged(place))) return;
    this.#lengths = this.#parts.map(lengthOf);
    this.timeline.stretch(0);
    this.#show();
  }

  #show() {
    let begin = 0;
    for (const [place, row] of [...this.list.children].entries()) {
      const length = this.#lengths[place];
      row.style.setProperty("--from", this.timeline.fraction(begin));
      row.style.setProperty("--to", this.timeline.fraction(begin + length));
      if (this.#isChanged(place)) row.dataset.length = seconds(length);
      else delete row.dataset.length;
      const handle = row.querySelector(".block-end");
      handle?.setAttribute("aria-valuenow", length.toFixed(2));
      handle?.setAttribute("aria-valuetext", this.#isChanged(place) ? `${seconds(length)}; Enter makes it` : seconds(length));
      begin += length;
    }
    this.showChosen();
  }
}
