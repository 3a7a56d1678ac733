// Targets in the picture: points of the figure that can be dragged, and a handle for each target that has a place.

import { create, find } from "./dom.js";
import { FACING, nameOf, POSE, ROOT, rounded } from "./targets.js";

const STEP = 0.02; // meters of an arrow key; with Shift, five times as many
const KEYS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };

// Where a target is in the picture, or null: what is seen from the root has no fixed place.
function pointOf({ joint, sign, place }) {
  if (!place || joint === FACING || joint === POSE || sign === "+=") return null;
  return joint === ROOT ? [place[0], 0, place[1]] : place;
}

export class Handles {
  constructor(targets, panel, { stage, player, session }) {
    Object.assign(this, { targets, panel, stage, player, session, layer: find("handles") });
    this.joints = [ROOT, ...panel.model.joints].map((joint) => this.#makeJoint(joint));
    this.handles = [];
    this.layer.append(...this.joints.map(({ element }) => element));
    targets.addEventListener("change", () => this.#makeHandles());
    this.#makeHandles();
  }

  // What changes with each frame that is drawn.
  update() {
    this.layer.hidden = !this.panel.isOpen;
    if (this.layer.hidden) return;
    const { selected } = this.session;
    for (const { joint, element } of this.joints) {
      const index = Math.max(this.panel.model.joints.indexOf(joint), 0);
      const [x, y, z] = this.stage.pointOf(selected, index);
      this.#place(element, this.player.stage.playing ? null : [x, joint === ROOT ? 0 : y, z]);
    }
    this.handles.forEach((element, number) => this.#place(element, pointOf(this.targets.items[number])));
  }

  #place(element, point) {
    const place = point && this.stage.placeOf(this.session.selected, point);
    const box = this.layer.getBoundingClientRect();
    element.hidden = !place;
    if (place) element.style.transform = `translate(${place.x - box.left}px, ${place.y - box.top}px)`;
  }

  #makeJoint(joint) {
    // The list of joints is their equivalent for keys.
    const element = create("div", { className: joint === ROOT ? "joint-point ground" : "joint-point", title: nameOf({ joint }) });
    element.setAttribute("aria-hidden", "true");
    element.dataset.joint = joint;
    this.#listen(element, () => {
      find("target-joint").value = joint;
      const { seconds, number } = this.#now(joint);
      return { number, item: { ...this.targets.items[number], seconds, joint, sign: "=", place: this.panel.placeOf(joint) } };
    });
    return { joint, element };
  }

  // A joint has one target at a time.
  #now(joint) {
    const seconds = rounded(this.player.time);
    const found = this.targets.find(joint, seconds);
    return { seconds, number: found < 0 ? this.targets.items.length : found };
  }

  // Elements that stay, so that one that is dragged is not replaced.
  #makeHandles() {
    const { items, selected } = this.targets;
    while (this.handles.length > items.length) this.handles.pop().remove();
    while (this.handles.length < items.length) this.handles.push(this.#makeHandle(this.handles.length));
    this.handles.forEach((element, number) => {
      const item = items[number];
      const numbers = (item.place ?? []).map((meters) => meters.toFixed(2)).join(", ");
      element.className = ["target-point", item.joint === ROOT && "ground", number === selected && "selected", this.targets.resultOf(item)?.met === false && "missed"].filter(Boolean).join(" ");
      element.title = [`${nameOf(item)} at ${item.seconds?.toFixed(2)} s`, this.targets.verdictOf(item)].filter(Boolean).join(", ");
      element.setAttribute("aria-label", `${element.title}: ${item.joint === POSE ? "" : numbers}`);
    });
    this.stage.changed();
  }

  #makeHandle(number) {
    const element = create("button", { type: "button", onclick: () => this.panel.choose(number) });
    this.#listen(element, () => ({ number, item: this.targets.items[number] }));
    element.addEventListener("keydown", (event) => this.#key(event, number));
    this.layer.append(element);
    return element;
  }

  // `begin` returns the target that is dragged, {number, item}, as it was before.
  #listen(element, begin) {
    let dragged = null;
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      event.preventDefault();
      this.player.seek(this.player.frame);
      dragged = begin();
    });
    element.addEventListener("pointermove", ({ clientX, clientY }) => {
      const place = dragged && this.#placeAt(dragged.item, clientX, clientY);
      if (place) this.targets.put({ ...dragged.item, place: place.map(rounded) }, dragged.number);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      element.addEventListener(name, () => {
        this.targets.keep();
        if (dragged) this.handles[dragged.number]?.focus({ preventScroll: true }); // for arrow keys
        dragged = null;
      });
    }
  }

  // Returns the numbers of a target that is dragged to a place of the window, or null.
  #placeAt(item, clientX, clientY) {
    const { selected } = this.session;
    if (item.joint === ROOT) return this.stage.groundAt(selected, clientX, clientY);
    const point = this.stage.pointBeside(selected, clientX, clientY, item.place);
    return point && [point[0], Math.max(point[1], 0), point[2]];
  }

  // Arrow keys move a handle as the camera sees it: to the sides, and up or down; page keys and those of the root away or near.
  #key(event, number) {
    const item = this.targets.items[number];
    const move = KEYS[event.key];
    if (event.key === "Delete") {
      this.targets.remove(number);
      this.handles[Math.min(number, this.handles.length - 1)]?.focus();
    } else if (move) this.#move(item, number, move.map((one) => one * STEP * (event.shiftKey ? 5 : 1)));
    else return;
    event.preventDefault();
  }

  #move(item, number, [right, up, away]) {
    const { yaw } = this.stage.view;
    const [x, y, z] = pointOf(item);
    const ahead = item.joint === ROOT ? up + away : away;
    const moved = [x + right * Math.cos(yaw) - ahead * Math.sin(yaw), Math.max(y + up, 0), z - right * Math.sin(yaw) - ahead * Math.cos(yaw)];
    const place = (item.joint === ROOT ? [moved[0], moved[2]] : moved).map(rounded);
    this.targets.put({ ...item, place }, number);
    this.targets.keep(`target ${number}`);
  }
}
