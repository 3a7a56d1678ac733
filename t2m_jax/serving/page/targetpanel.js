// The list of targets, the numbers of the selected one, and the buttons that add one.

import { create, fillSelect, find, iconButton, once } from "./dom.js";
import { FACING, nameOf, placesOf, POSE, ROOT, rounded } from "./targets.js";

export class TargetPanel {
  constructor(targets, model, { stage, player, session }) {
    Object.assign(this, { targets, model, stage, player, session, part: find("targets"), list: find("target-list") });
    fillSelect(find("target-joint"), [ROOT, FACING, ...model.joints].map((joint) => [joint, nameOf({ joint })]));
    find("target-joint").value = "right_wrist";
    find("add-target").addEventListener("click", once(() => this.#add(find("target-joint").value)));
    find("add-pose").addEventListener("click", once(() => this.#add(POSE)));
    for (const input of this.#numbers) input.addEventListener("change", () => this.#edit(input));
    find("target-exact").addEventListener("change", (event) => this.#set({ exact: event.target.checked }));
    this.part.addEventListener("toggle", () => stage.changed());
    targets.addEventListener("change", () => this.#draw());
    this.#draw();
  }

  // Whether targets can be seen and dragged in the picture.
  get isOpen() {
    const { take, motion } = this.session;
    return this.part.open && !this.part.hidden && motion !== null && take.kind !== "comparison" && this.#isDrawn;
  }

  // While a motion is generated, the stage may show fewer figures; without WebGL, it shows none.
  get #isDrawn() {
    return this.session.selected < this.stage.cells.length;
  }

  get #numbers() {
    return [...find("target-numbers").querySelectorAll("input[type=number]")];
  }

  // Returns where something of the figure is now, as the numbers of a target.
  placeOf(joint) {
    const { stage, session, model } = this;
    const point = (index) => stage.pointOf(session.selected, index);
    const root = point(0);
    if (joint === FACING) return [0];
    if (joint === ROOT) return [root[0], root[2]].map(rounded);
    if (joint !== POSE) return point(model.joints.indexOf(joint)).map(rounded);
    // Seen from the ground under the root, so that the numbers are small.
    return model.joints.flatMap((_, index) => point(index).map((meters, axis) => Number((axis === 1 ? meters : meters - root[axis]).toFixed(3)) + 0));
  }

  #add(joint) {
    const { targets, player } = this;
    const number = targets.find(joint, player.time);
    targets.put({ ...targets.items[number], seconds: rounded(player.time), joint, sign: "=", place: this.placeOf(joint) }, number < 0 ? undefined : number);
    targets.keep();
    (this.#numbers.find((input) => input.dataset.place === placesOf({ joint })[0]) ?? this.#numbers[0]).focus();
  }

  #edit(input) {
    const item = this.targets.items[this.targets.selected];
    const value = input.valueAsNumber;
    if (item && Number.isFinite(value)) {
      const place = placesOf(item).map((name, index) => (name === input.dataset.place ? value : item.place[index]));
      const seconds = Math.max(value, 0);
      // A target that holds for a while moves as a whole.
      const until = item.until && rounded(Number(item.until) + seconds - item.seconds);
      this.#set(input.dataset.place ? { place } : { seconds, until });
    }
    this.#showNumbers(this.targets.items[this.targets.selected], null);
  }

  #set(fields) {
    const { targets } = this;
    targets.put({ ...targets.items[targets.selected], ...fields }, targets.selected);
    targets.keep();
  }

  choose(number) {
    this.targets.select(number);
    const { seconds } = this.targets.items[number];
    if (seconds !== undefined && this.session.motion) this.player.seek(Math.round(seconds * this.player.fps));
  }

  #draw() {
    const { targets, list } = this;
    const { children } = list;
    const focused = [...children].findIndex((row) => row.contains(document.activeElement));
    const isOneLess = children.length > targets.items.length;
    // Rows stay: a click on one ends what is typed in a number, which changes them.
    while (children.length > targets.items.length) list.lastElementChild.remove();
    while (children.length < targets.items.length) list.append(this.#makeRow(children.length));
    targets.items.forEach((item, number) => this.#showRow(children[number], item, number));
    if (focused >= 0 && isOneLess) (children[Math.min(focused, children.length - 1)]?.firstElementChild ?? find("add-target")).focus();
    find("target-count").textContent = targets.items.length ? `(${targets.items.length})` : "";
    for (const id of ["add-target", "add-pose"]) find(id).disabled = !this.session.motion || !this.#isDrawn;
    this.#showNumbers(targets.items[targets.selected]);
    this.stage.changed();
  }

  #makeRow(number) {
    const open = create(
      "button",
      { type: "button", className: "target-open", onclick: () => this.choose(number) },
      create("span", { className: "take-caption" }),
      create("span", { className: "target-state" }),
    );
    const remove = iconButton("remove", "", once(() => this.targets.remove(number)));
    const onkeydown = (event) => {
      if (event.key !== "Delete") return;
      event.preventDefault(); // or the motion is deleted
      this.targets.remove(number);
    };
    return create("li", { onkeydown }, open, remove);
  }

  #showRow(row, item, number) {
    const [open, remove] = row.children;
    const [name, state] = open.children;
    const when = item.text ? "cannot be read" : `${item.seconds.toFixed(2)} s${item.until ? ` to ${item.until} s` : ""}`;
    name.textContent = nameOf(item);
    state.textContent = [when, this.targets.verdictOf(item)].filter(Boolean).join(" · ");
    open.ariaCurrent = number === this.targets.selected ? "true" : null;
    remove.title = remove.ariaLabel = `Delete the target ${number + 1}: ${nameOf(item)}`;
    const isMissed = item.text !== undefined || this.targets.resultOf(item)?.met === false;
    row.className = isMissed ? "target missed" : "target";
  }

  // Shows the numbers of a target, but for one that is being typed.
  #showNumbers(item, typed = document.activeElement) {
    const isRead = item !== undefined && item.text === undefined;
    find("target-numbers").hidden = !isRead;
    if (!isRead) return;
    find("target-exact").checked = item.exact;
    find("target-exact").closest("label").hidden = !this.model.exact_joints.includes(item.joint);
    for (const input of this.#numbers) {
      const name = input.dataset.place;
      const index = placesOf(item).indexOf(name);
      input.closest("label").hidden = name !== undefined && index < 0;
      if (input !== typed) input.value = name === undefined ? item.seconds : (item.place[index] ?? "");
    }
  }
}
