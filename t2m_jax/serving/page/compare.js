// Two motions side by side: the first one that is chosen waits for the second one.

import { find } from "./dom.js";
import { makeTake } from "./session.js";

export class Comparison {
  #first = null;

  constructor(session) {
    this.session = session;
    find("compare-sample").addEventListener("click", () => this.toggleSelected());
    session.onChange(["take", "select"], () => this.#update());
  }

  // Chooses the selected motion, or takes it back.
  toggleSelected() {
    const { take, selected } = this.session;
    if (take === null || take.kind === "comparison") return;
    this.choose(take, selected);
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
    find("compare-sample").hidden = take?.kind === "comparison";
    const hint = find("compare-hint");
    hint.hidden = first === null;
    hint.textContent = first === null ? "" : `Choose a second motion to compare with “${first.motion.caption}”.`;
  }
}
