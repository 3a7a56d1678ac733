// A path that is drawn on the ground with a mouse, a pen or a finger. It comes into the field that can also be typed.

import { find, showMessage, showNotice } from "./dom.js";
import { findField } from "./fields.js";

const APART = 0.3; // meters between points, so that the path does not tremble
const FARTHEST = 30; // meters from the first point; near the horizon, pixels are far apart
const ABOVE = { pitch: 0.9, zoom: 0.5 }; // so that a large part of the ground fills the picture

const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

export class PathDrawing {
  #points = null; // while a line is drawn

  constructor({ stage, player, session, onDrawn }) {
    Object.assign(this, { stage, player, session, onDrawn, sheet: find("sheet"), field: findField("path") });
    find("draw-path").addEventListener("click", () => this.toggle());
    this.field.addEventListener("input", () => this.#show());
    session.onChange(["take", "select"], () => {
      this.stop();
      this.#show();
    });
    this.sheet.addEventListener("pointerdown", (event) => this.#begin(event));
    this.sheet.addEventListener("pointermove", (event) => this.#points && this.#add(event));
    this.sheet.addEventListener("pointerup", () => this.#points && this.#end());
    this.sheet.addEventListener("pointercancel", () => { this.#points = null; });
  }

  get isOn() {
    return !this.sheet.hidden;
  }

  toggle() {
    if (this.isOn) this.stop();
    else if (this.session.motion) this.#start();
  }

  #start() {
    const { pitch, zoom } = this.stage.view;
    this.former = { pitch, zoom };
    Object.assign(this.stage.view, ABOVE);
    this.player.seek(this.player.frame);
    this.#setOn(true);
    find("stage-frame").scrollIntoView({ block: "nearest" });
  }

  stop() {
    if (!this.isOn) return;
    Object.assign(this.stage.view, this.former);
    this.#points = null;
    this.#setOn(false);
    this.stage.changed();
  }

  #setOn(isOn) {
    this.sheet.hidden = !isOn;
    find("draw-path").setAttribute("aria-pressed", String(isOn));
  }

  #begin(event) {
    this.sheet.setPointerCapture(event.pointerId);
    this.#points = [];
    this.#add(event);
  }

  #add({ clientX, clientY }) {
    const point = this.stage.groundAt(this.session.selected, clientX, clientY);
    const [first, last] = [this.#points[0], this.#points.at(-1)];
    if (!point || (last && (distance(point, last) < APART || distance(point, first) > FARTHEST))) return;
    this.#points.push(point);
    this.stage.drawOnGround(this.session.selected, this.#points);
  }

  #end() {
    const points = this.#points;
    this.#points = null;
    if (points.length < 2) {
      showMessage("This is too short for a path. Draw a line over the ground.");
      return;
    }
    this.field.value = points.map((point) => point.map((meters) => Number(meters.toFixed(2))).join(",")).join(" ");
    this.field.dispatchEvent(new Event("input", { bubbles: true }));
    this.stop();
    find("apply-changes").focus({ preventScroll: true });
    showNotice(`The path has ${points.length} points.`, "Show the motion on it", this.onDrawn);
  }

  // Shows the path of the field on the ground.
  #show() {
    const points = this.field.value.trim().split(/\s+/).map((text) => text.split(",").map(Number));
    const isPath = points.length > 1 && points.every((point) => point.length === 2 && point.every(Number.isFinite));
    this.stage.drawOnGround(this.session.selected, isPath ? points : []);
  }
}
