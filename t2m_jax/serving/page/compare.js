// Two motions in step, side by side or in one view: the first one that is chosen waits for the second one.

import { find } from "./dom.js";
import { recall, remember } from "./memory.js";
import { makeTake } from "./session.js";

export class Comparison {
  #first = null;

  constructor(session, stage) {
    Object.assign(this, { session, stage });
    find("one-view").addEventListener("click", () => this.toggleView());
    find("compare-sample").addEventListener("click", () => this.toggleSelected());
    session.onChange(["take", "select"], () => this.#update());
  }

  // Chooses the selected motion, or takes it back.
  toggleSelected() {
    const { take, selected } = this.session;
    if (take === null || take.kind === "comparison") return;
    this.choose(take, selected);
  }

  // Shows both on one ground, or side by side again.
  toggleView() {
    if (this.session.take?.kind !== "comparison") return;
    remember("one-view", !this.stage.together);
    this.#update();
  }

  choose(take, number = 0) {
    const choice = { take, number, motion: take.motions[number], figure: take.scene.figures[number] };
    const first = this.#first;
    if (first === null) this.#first = choice;
    else {
      this.#first = null;
      if (first.figure !== choice.figure && !this.#isSame(first, choice)) this.#show([first, choice]);
    }
    this.#update();
  }

  #isSame(a, b) {
    return a.take.id === b.take.id && a.number === b.number;
  }

  #show(choices) {
    const figures = choices.map(({ figure, motion }, index) => {
      const seed = motion.seed === null ? "" : ` (seed ${motion.seed})`;
      const named = (text) => `${"AB"[index]}: ${text}${seed}`;
      const sentences = (figure.sentences ?? []).map(([first, text]) => [first, named(text)]);
      return { ...figure, caption: named(figure.caption), sentences };
    });
    const motions = choices.map(({ motion }) => motion);
    const seconds = Math.max(...motions.map((motion) => motion.seconds));
    this.session.show(makeTake({ kind: "comparison", request: {}, scene: { seconds, figures }, motions }));
  }

  #update() {
    const { take, selected } = this.session;
    const first = this.#first;
    const isFirst = first !== null && take !== null && this.#isSame(first, { take, number: selected });
    find("compare-sample").setAttribute("aria-pressed", String(isFirst));
    const isShown = take?.kind === "comparison";
    find("compare-sample").hidden = isShown;
    find("one-view").hidden = !isShown;
    if (isShown) this.stage.together = recall("one-view") === true;
    find("one-view").setAttribute("aria-pressed", String(this.stage.together));
    const hint = find("compare-hint");
    hint.hidden = first === null;
    hint.textContent = first === null ? "" : `Choose a second motion to compare with “${first.motion.caption}”.`;
  }
}
