// Targets as keys on the timeline, at their times. A key can be dragged, and arrow keys move it by frames.

import { clamp, create, find, seconds } from "./dom.js";
import { nameOf, rounded } from "./targets.js";

const FRAMES = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 };

export class TargetKeys {
  constructor(targets, panel, timeline) {
    Object.assign(this, { targets, panel, timeline, row: find("target-keys"), keys: [] });
    targets.addEventListener("change", () => this.draw());
    timeline.session.onChange(["take", "select"], () => this.draw());
    panel.part.addEventListener("toggle", () => this.draw());
    this.draw();
  }

  draw() {
    const { targets, timeline } = this;
    const items = this.panel.part.hidden || !timeline.session.motion ? [] : targets.items;
    while (this.keys.length > items.length) this.keys.pop().remove();
    while (this.keys.length < items.length) this.keys.push(this.#makeKey(this.keys.length));
    this.row.hidden = items.length === 0;
    this.keys.forEach((key, number) => {
      const item = items[number];
      const time = item.seconds ?? 0;
      key.hidden = item.seconds === undefined;
      key.className = ["target-key", number === targets.selected && "selected", targets.resultOf(item)?.met === false && "missed"].filter(Boolean).join(" ");
      key.title = `${nameOf(item)} at ${time.toFixed(2)} s`;
      key.style.setProperty("--at", timeline.fraction(time));
      key.setAttribute("aria-label", `Time of target ${number + 1}: ${nameOf(item)}`);
      key.setAttribute("aria-valuemax", Math.max(timeline.extent, time).toFixed(2));
      key.setAttribute("aria-valuenow", time.toFixed(2));
      key.setAttribute("aria-valuetext", seconds(time));
    });
  }

  #makeKey(number) {
    const key = create("div", { role: "slider", tabIndex: 0 });
    key.setAttribute("aria-valuemin", "0");
    key.addEventListener("pointerdown", (event) => {
      key.setPointerCapture(event.pointerId);
      event.preventDefault();
      key.focus();
      this.panel.choose(number);
    });
    key.addEventListener("pointermove", ({ pointerId, clientX, movementX }) => {
      if (!key.hasPointerCapture(pointerId) || !movementX) return;
      const { left, width } = this.row.getBoundingClientRect();
      this.#move(number, clamp((clientX - left) / width, 0, 1) * this.timeline.extent);
    });
    key.addEventListener("pointerup", () => this.targets.keep());
    key.addEventListener("keydown", (event) => {
      const frames = FRAMES[event.key];
      if (event.key === "Delete") this.targets.remove(number);
      else if (event.key === "Enter") this.panel.choose(number);
      else if (frames) {
        this.#move(number, this.targets.items[number].seconds + (frames * (event.shiftKey ? 10 : 1)) / this.timeline.player.fps);
        this.targets.keep(`time ${number}`);
      } else return;
      event.preventDefault();
    });
    this.row.append(key);
    return key;
  }

  // Moves a target to the frame at a time; one that holds for some time stays as long.
  #move(number, time) {
    const { fps } = this.timeline.player;
    const item = this.targets.items[number];
    const begin = rounded(Math.max(Math.round(time * fps), 0) / fps);
    const until = item.until && String(rounded(begin + Number(item.until) - item.seconds));
    this.targets.put({ ...item, seconds: begin, until }, number);
  }
}
