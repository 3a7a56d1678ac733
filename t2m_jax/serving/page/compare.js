// Two motions in step, side by side or in one view: the first one that is chosen waits for the second one.

import { find } from "./dom.js";
import { recall, recallInTab, remember, rememberInTab } from "./memory.js";
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
    const choice = { take, number };
    const first = this.#first;
    this.#keepFirst(first === null ? choice : null);
    if (first !== null && figureOf(first) !== figureOf(choice) && !isSame(first, choice)) this.session.show(compare([first, choice]));
    this.#update();
  }

  // Waits for the second motion again, if the page was left meanwhile.
  async resume(history) {
    const former = recallInTab("compare-first");
    if (history.find(former?.id)) this.choose(await history.take(former.id), former.number);
  }

  #keepFirst(choice) {
    this.#first = choice;
    rememberInTab("compare-first", choice && { id: choice.take.id, number: choice.number });
  }

  #update() {
    const { take, selected } = this.session;
    const first = this.#first;
    const isFirst = first !== null && take !== null && isSame(first, { take, number: selected });
    find("compare-sample").setAttribute("aria-pressed", String(isFirst));
    const isShown = take?.kind === "comparison";
    find("compare-sample").hidden = isShown;
    find("one-view").hidden = !isShown;
    if (isShown) this.stage.together = recall("one-view") === true;
    find("one-view").setAttribute("aria-pressed", String(this.stage.together));
    const hint = find("compare-hint");
    hint.hidden = first === null;
    hint.textContent = first === null ? "" : `Choose a second motion to compare with “${motionOf(first).caption}”.`;
  }
}

const motionOf = ({ take, number }) => take.motions[number];
const figureOf = ({ take, number }) => take.scene.figures[number];
const isSame = (a, b) => a.take.id === b.take.id && a.number === b.number;

// Two samples {take, number} as one take, which names them as `compared`.
export function compare(choices) {
  const figures = choices.map((choice, index) => {
    const { seed } = motionOf(choice);
    const named = (text) => `${"AB"[index]}: ${text}${seed === null ? "" : ` (seed ${seed})`}`;
    const figure = figureOf(choice);
    const sentences = (figure.sentences ?? []).map(([first, text]) => [first, named(text)]);
    return { ...figure, caption: named(figure.caption), sentences };
  });
  const motions = choices.map(motionOf);
  const seconds = Math.max(...motions.map((motion) => motion.seconds));
  const compared = choices.map(({ take, number }) => ({ id: take.id, number }));
  return { ...makeTake({ kind: "comparison", request: {}, scene: { seconds, figures }, motions }), compared };
}
